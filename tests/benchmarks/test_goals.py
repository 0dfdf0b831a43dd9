"""Goals: what reaches them, and what is said of them."""

from typing import Any

import pytest

from benchmarks import goals
from benchmarks.goals import Goal
from moc_opt.study.statistics import Change, Interval


def change(one: tuple[float, float], two: tuple[float, float], trials: int = 9) -> Change:
    return Change(*(Interval(sum(ends) / 2, *ends, trials) for ends in (one, two)))


@pytest.mark.parametrize(
    ("measured", "most", "least"),
    [
        (4.0, "yes", "no"), (5.0, "yes", "yes"), (6.0, "no", "yes"), (Interval(4.0, 3.0, 4.9, 9), "yes", "no"),
        (Interval(4.0, 3.0, 5.1, 9), "open", "open"), (Interval(7.0, 6.0, 8.0, 9), "no", "yes"),
        (Interval(4.0, 3.0, 4.9, 7), "open", "open"), (Interval(4.0, 4.0, 4.0, 2), "open", "open"),
        (Interval(4.0, float("nan"), float("nan"), 1), "open", "open"),
        (change((3, 4), (2, 4)), "yes", "no"), (change((3, 4), (2, 6)), "open", "open"),
        (change((3, 4), (6, 7)), "open", "open"), (change((3, 4), (2, 4), 7), "open", "open"),
        (None, "not measured", "not measured"),
    ],
)  # fmt: skip
def test_a_goal_is_judged_by_the_worse_end_of_every_interval(measured: Any, most: str, least: str) -> None:
    summary = {} if measured is None else {"x": measured}
    asked = {str(m): Goal("x", "us", 5.0, lambda s: s["x"], most=m, made_of=lambda s: "all") for m in (True, False)}
    found = goals.judge(summary, asked)
    assert [found[str(m)]["reached"] for m in (True, False)] == [most, least]
    assert found["True"]["kind"] == "at most"
    assert found["True"]["made_of"] == ("" if measured is None else "all")


def test_goals_are_shown_missed_ones_first() -> None:
    values = {"a": 1.0, "b": Interval(7.0, 6.0, 8.0, 9), "c": Interval(5.0, 4.0, 6.0, 9)}
    asked = {key: Goal(f"goal {key}", "us", 5.0, lambda s, key=key: s[key], section="All") for key in "acbd"}
    found = goals.judge(values, asked)
    rows = [(row["what"][-1], row["reached"].symbol, row["measured"]) for row in goals.goals_table(found).rows]
    assert rows == [("b", "✘", "7 [6, 8] us"), ("c", "–", "5 [4, 6] us"), ("d", "–", None), ("a", "✔", "1 us")]
    assert "missed: goal b (7 [6, 8] us)" in goals.goals_sentence(found)
