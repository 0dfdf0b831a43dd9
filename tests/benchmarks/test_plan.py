"""The study of planning: figures that follow from its rows, and an order among courses, map and bounds."""

from typing import Any

import pytest

from benchmarks import plan
from moc_opt.study.command import CONFIGS

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
