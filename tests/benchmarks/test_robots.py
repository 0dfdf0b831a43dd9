from typing import Any

import pytest

from benchmarks import plan, robots
from moc_opt.study.results import Results

TINY = """
robots = ["xarm7", "lwr4_rail"]
tasks = ["circle"]
starts = 1
solvers = ["exact"]
scenario = { start = { pose = "random" }, duration_s = 0.4, bound_samples = 2 }
"""


def test_summary_agrees_with_the_rows(tiny: Any) -> None:
    left = tiny(robots, TINY)
    rows = left.rows
    runs = [("xarm7", "dcac"), ("xarm7", "exact"), ("lwr4_rail", "dcac"), ("lwr4_rail", "exact")]
    assert [(row["robot"], row["controller"]) for row in rows] == runs
    assert all(row["ended"] == "completed" for row in rows)
    summary = left.summary
    for robot in ("xarm7", "lwr4_rail"):
        base, mine = (row for row in rows if row["robot"] == robot)
        gain = 100.0 * (mine["mu_mean"] / base["mu_mean"] - 1.0)
        assert summary["robots"][robot]["exact"]["mu_gain_percent"] == pytest.approx(gain)
        assert set(summary["findings"][robot].values()) == {None}, "one trial decides nothing"


def row(trial: int, controller: str, mu: float = 1.0, tip: float = 1.0, **more: Any) -> dict[str, Any]:
    errors = {f"settled_{name}": 1.0 for name in robots.ERRORS} | {"settled_ticks": 100.0}
    own = {"mu_mean": mu, "tip_error_mean_mm": tip, "settled_tip_error_mean_mm": tip}
    about = {"trial": f"t{trial}", "controller": controller, "ended": "completed", "whole": True, "error": None}
    return {**about, **errors, **own, **more}


def test_finding_is_decided_only_if_its_whole_interval_agrees() -> None:
    base = [row(k, "dcac") for k in range(40)]
    mine = [row(k, "exact", mu=1.2, tip=1.2 if k == 0 else 1.0) for k in range(40)]

    def found(count: int = 40) -> dict[str, bool | None]:
        return robots.verdicts(Results(base[:count] + mine[:count]), "exact")

    assert found() == dict.fromkeys(robots.FINDINGS, True) | {"tails": None}, "1 large error in 40 decides nothing"
    mine[:20] = [row(k, "exact", mu=1.2, tip=1.0 + 0.012 * k) for k in range(20)]
    tip, tails = "settled_tip_error_change_percent", "tails"
    assert [key for key, holds in found().items() if holds is not True] == [tip, tails]
    assert (found()[tip], found()[tails]) == (None, False)
    mine[:20] = [row(k, "exact", mu=0.9 + 0.04 * k, tip=2.0) for k in range(20)]
    assert (found()[tip], found()["mu_gain_percent"]) == (False, True)
    mine[20:] = [row(k, "exact", mu=0.9) for k in range(20, 40)]
    assert found()["mu_gain_percent"] is None
    assert set(found(7).values()) == {None}, "seven trials decide nothing"
    mine[-1] = row(39, "exact") | {"whole": False, "ended": "stopped", "error": "stopped: far off", "mu_mean": 9.0}
    assert found()["all_end"] is False


def test_arm_with_equal_solvers_has_no_rank_correlation() -> None:
    means = {"a": (1.1, 1.2, 1.3), "b": (2.1, 2.2, 2.3), "c": (3.3, 3.2, 3.1), "d": (1.0, 1.0 + 1e-6, 1.0)}
    figures = {arm: {s: {"mu_mean": m} for s, m in zip("xyz", of, strict=True)} for arm, of in means.items()}
    ranking = robots.ranking(figures)
    assert ranking["order"]["a"] == ["z", "y", "x"]
    assert ranking["between"] == pytest.approx({"a, b": 1.0, "a, c": -1.0, "b, c": -1.0}), "solvers are equal on arm d"


PLANNED = """
robots = ["lwr4"]
tasks = ["circle"]
poses = 1
halvings = 1
loops = { local = { third_level = "local" }, planned = { third_level = "planned" } }
scenario = { start = { pose = "random" }, duration_s = 1.0 }
"""


def test_mu_of_planned_courses_is_below_the_bound_and_hardly_below_that_of_runs(tiny: Any) -> None:
    left = tiny(plan, PLANNED)
    rows = left.rows
    parts = [row["part"] for row in rows]
    assert {part: parts.count(part) for part in parts} == {"courses": 1, "loop": 2, "halving": 1}
    course = {row["trial"]: row for row in rows if row["part"] == "courses"}
    for row in course.values():
        assert row["from_start"] <= row["best"]
        assert min(row["climb_gap_percent"], row["bound_gap_percent"]) >= -1e-9
        assert row["violation"] < 1e-8
    for row in (row for row in rows if row["part"] == "loop" and row["whole"]):
        gap = 100.0 * (1.0 - row["mu_mean"] / course[row["trial"]]["from_start"])
        assert row["gap_percent"] == pytest.approx(gap)
        assert -0.5 < gap < 50.0  # [%]: mu of a run may exceed that of its course by 0.5 %
    [halved] = [row for row in rows if row["part"] == "halving"]
    assert abs(halved["halving_percent"]) < 0.5
    planned = [row["gap_percent"] for row in rows if row["controller"] == "planned" and row["whole"]]
    assert left.summary["loops"]["lwr4"]["planned"]["gap_percent"] == pytest.approx(sum(planned) / len(planned))
