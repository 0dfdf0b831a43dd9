"""The study of planning: figures that follow from its rows, and an order among courses, map and bounds."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks import plan
from benchmarks.goals import judge
from moc_opt.study.command import CONFIGS
from moc_opt.study.results import Results

TINY = """
robots = ["lwr4"]
tasks = ["circle"]
poses = 1
halvings = 1
[loops]
local = { third_level = "local" }
planned = { third_level = "planned" }
[scenario]
start = { pose = "random" }
duration_s = 1.0
"""


def test_courses_are_in_order_and_nothing_beats_map_plan_or_bound(tiny: Any) -> None:
    left = tiny(plan, TINY, pictures=0)
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
        assert -0.5 < gap < 50.0
    [halved] = [row for row in rows if row["part"] == "halving"]
    assert abs(halved["halving_percent"]) < 0.5
    planned = [row["gap_percent"] for row in rows if row["controller"] == "planned" and row["whole"]]
    assert left.summary["loops"]["lwr4"]["planned"]["gap_percent"] == pytest.approx(sum(planned) / len(planned))


def test_the_configuration_that_ships_is_the_default() -> None:
    shipped = plan.Config.load(CONFIGS / "plan.toml")
    assert shipped == plan.Config()
    assert len(shipped.cases()) == 180


def runs(gaps: dict[str, list[float]], tip: float = 0.11) -> list[dict[str, Any]]:
    about = {"part": "loop", "robot": "arm", "whole": True, "error": None, "mu_mean": 0.2, "fraction_of_best": 0.9,
             "rcm_error_model_mean_mm": 0.2}  # fmt: skip
    return [
        {**about, "controller": name, "trial": f"t{k}", "gap_percent": gap,
         "tip_error_model_mean_mm": 0.1 if name == "local" else tip}
        for name, values in gaps.items() for k, gap in enumerate(values)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("spread", "count", "reached"),
    [((0.2, 0.3), 8, "yes"), ((0.3, 0.7), 8, "open"), ((0.9, 1.0), 8, "no"), ((0.2, 0.3), 3, "open")],
)
def test_a_goal_is_judged_by_the_end_of_its_interval(spread: tuple[float, float], count: int, reached: str) -> None:
    rows = Results(runs({"local": [1.0] * count, "planned": [spread[k % 2] for k in range(count)]}))
    loops = {name: plan.loop_figures(rows, name) for name in ("local", "planned")}
    found = judge({"loops": loops, "courses": {}}, plan.goals(loops))
    assert found["gap planned"]["reached"] == reached
    assert {found[key]["reached"] for key in ("scratch", "halving")} == {"not measured"}
    assert found["planned tip"]["reached"] == ("no" if count == 8 else "open"), "10 % above local's"
