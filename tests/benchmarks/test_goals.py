"""Goals, and the phases of a run (travelling, settled)."""

from typing import Any

import numpy as np
import pytest

from benchmarks import goals
from benchmarks.goals import Goal
from benchmarks.phases import PHASES, with_phases
from moc_opt.study.statistics import Change, Interval
from moc_opt.study.trials import BASELINE, Run


def change(one: tuple[float, float], two: tuple[float, float], trials: int = 9) -> Change:
    return Change(*(Interval(sum(ends) / 2, *ends, trials) for ends in (one, two)))


@pytest.mark.parametrize(("measured", "most", "least"), [
    (4.0, "yes", "no"), (5.0, "yes", "yes"), (6.0, "no", "yes"), (Interval(4.0, 3.0, 4.9, 9), "yes", "no"),
    (Interval(4.0, 3.0, 5.1, 9), "open", "open"), (Interval(7.0, 6.0, 8.0, 9), "no", "yes"),
    (Interval(4.0, 3.0, 4.9, 7), "open", "open"), (Interval(4.0, 4.0, 4.0, 2), "open", "open"),
    (Interval(4.0, float("nan"), float("nan"), 1), "open", "open"),
    (change((3, 4), (2, 4)), "yes", "no"), (change((3, 4), (2, 6)), "open", "open"),
    (change((3, 4), (6, 7)), "open", "open"), (change((3, 4), (2, 4), 7), "open", "open"),
    (None, "not measured", "not measured"),
])  # fmt: skip
def test_goal_is_judged_by_the_ends_of_an_interval_not_by_its_middle(measured: Any, most: str, least: str) -> None:
    summary = {} if measured is None else {"x": measured}
    asked = {str(m): Goal("x", "us", 5.0, lambda s: s["x"], most=m, made_of=lambda s: "all") for m in (True, False)}
    found = goals.judge(summary, asked)
    assert [found[str(m)]["reached"] for m in (True, False)] == [most, least]
    assert (found["True"]["kind"], found["True"]["made_of"]) == ("at most", "" if measured is None else "all")


def test_missed_goals_are_shown_first() -> None:
    values = {"a": 1.0, "b": Interval(7.0, 6.0, 8.0, 9), "c": Interval(5.0, 4.0, 6.0, 9)}
    asked = {key: Goal(f"goal {key}", "us", 5.0, lambda s, key=key: s[key], section="All") for key in "acbd"}
    found = goals.judge(values, asked)
    rows = [(row["what"][-1], row["reached"].symbol, row["measured"]) for row in goals.goals_table(found).rows]
    assert rows == [("b", "✘", "7 [6, 8] us"), ("c", "–", "5 [4, 6] us"), ("d", "–", None), ("a", "✔", "1 us")]
    assert "Missed: goal b = 7 [6, 8] us" in goals.goals_sentence(found)


def made(controller: str, travelling: list[int] | None, trial: str = "t", **more: Any) -> Run:
    """Return a run of four ticks. At tick k the norm of each metric's column is 2^k * 1e-6, doubled for BASELINE."""
    error = 1e-6 * 2.0 ** np.arange(4) * (2.0 if controller == BASELINE else 1.0)
    columns = dict.fromkeys(("t_s", "mu", "tip_error_m", "rcm_error_model_m"), error)
    columns["trocar_force_N"] = np.outer(error, (0.0, 0.6, -0.8))
    flags = {} if travelling is None else {"travelling": np.array(travelling, float)}
    return Run({"trial": trial, "controller": controller, **more}, {**columns, **flags})


def test_all_controllers_of_a_trial_have_the_same_phases() -> None:
    runs = [
        made(BASELINE, None), made("exact", [1, 0, 0, 0]), made("rnn", [0, 0, 1, 0]),
        Run({"trial": "t", "controller": "osqp", "whole": False}),
        made("exact", [0, 0, 0, 0], "other trial"), made("exact", [0, 1, 0, 0], "t", group="other group"),
        made(BASELINE, None, "of DCAC alone"),
    ]  # fmt: skip
    base, exact, rnn, broken, still, grouped, alone = (run.row for run in with_phases(runs))
    for row, scale in ((base, 2.0), (exact, 1.0), (rnn, 1.0)):
        assert (row["travelling_ticks"], row["settled_ticks"]) == (2, 2)
        assert row["travelling_mu_mean"] == pytest.approx(scale * 2.5e-6)
        assert row["settled_tip_error_mean_mm"] == pytest.approx(scale * 5e-3)
        assert row["settled_rcm_error_model_mean_mm"] == row["settled_tip_error_mean_mm"]
        assert row["settled_trocar_force_mean_N"] == pytest.approx(scale * 5e-6)
    means = ("mu_mean", "tip_error_mean_mm", "rcm_error_model_mean_mm", "trocar_force_mean_N", "ticks")
    assert {*exact} == {"trial", "controller", *(f"{phase}_{name}" for phase in PHASES for name in means)}
    assert broken == runs[3].row
    assert (still["settled_ticks"], "travelling_mu_mean" in still) == (4, False)
    assert grouped["travelling_mu_mean"] == pytest.approx(2e-6)
    assert alone == runs[-1].row
    short = Run(runs[2].row, {name: column[:3] for name, column in runs[2].columns.items()})
    assert with_phases([runs[1], short]) == [runs[1], short], "runs of different lengths have no common phases"
