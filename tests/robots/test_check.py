"""The table of an arm: what is sound passes, each fault turns its own row and names a cure."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from moc_opt.robots import available_robots
from moc_opt.robots.check import Finding, check_robot, verdict
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.scenario import Scenario, run


def rows(robot: RobotModel, scenario: Scenario | None = None) -> dict[str, Finding]:
    return {row.what: row for row in check_robot(robot, scenario)}


def altered(robot: RobotModel, **fields: object) -> RobotModel:
    return RobotModel(dataclasses.replace(robot.data, **fields))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", available_robots())
def test_the_arms_of_the_package_can_be_used(name: str) -> None:
    found = check_robot(load_robot(name))
    assert verdict(found) == "ok"
    assert len(found) == 11
    assert not any(row.cure for row in found)
    assert max(len(row.found) for row in found) <= 54  # 80 columns with the others


@pytest.mark.parametrize(("what", "fields", "judged", "told"), [
    ("joint speeds", {"v_max": [1.9, 1.9, 10.0, 2, 2, 2, 2]}, "care", "joint_3 10 rad/s"),
    ("gravity at home", {"tau_max": [5.0] * 7}, "cannot", "check masses"),
    ("masses", {"urdf": ('ixx="0.01845" iyy="0.01602"', 'ixx="5.0" iyy="5.0"')}, "care", "link_1"),
])  # fmt: skip
def test_each_fault_turns_its_own_row(robot: RobotModel, what: str, fields: dict, judged: str, told: str) -> None:
    if "urdf" in fields:
        assert fields["urdf"][0] in robot.data.urdf
        fields = {"urdf": robot.data.urdf.replace(*fields["urdf"], 1)}
    row = rows(altered(robot, **fields))[what]
    assert row.verdict == judged
    assert told in row.cure


def test_a_joint_that_slides_has_its_room_in_mm() -> None:
    rail = load_robot("lwr4_rail")
    row = rows(rail)["nearest limit"]
    room = min(rail.data.q_home[0] - rail.q_min[0], rail.q_max[0] - rail.data.q_home[0])
    assert f"joint_1 is {1e3 * room:.0f} mm away" in row.found
    assert " deg away" in row.found
    near = rail.data.q_home.copy()
    near[0] = rail.q_max[0] - 0.04
    row = rows(altered(rail, q_home=near))["nearest limit"]
    assert row.verdict == "care"
    assert "keeps 50 mm free: move home.q_rad 80 mm" in row.cure
    assert "deg or more" not in row.cure


def test_a_singular_home_is_refused_and_every_row_that_is_not_ok_has_a_cure(robot: RobotModel) -> None:
    found = rows(altered(robot, q_home=np.zeros(7), v_max=np.full(7, 10.0), tau_max=np.full(7, 1.0)))
    assert verdict(list(found.values())) == "cannot"
    assert "singular" in found["freedoms left"].cure + found["singular values"].cure
    assert "task from home" not in found
    assert sum(row.verdict != "ok" for row in found.values()) >= 3
    assert all(bool(row.cure) == (row.verdict != "ok") for row in found.values())


def test_a_task_out_of_reach_is_told(robot: RobotModel) -> None:
    asked = Scenario(task={"path": "circle", "sizes": {"radius": 0.5}})
    row = rows(robot, asked)["task from home"]
    assert row.verdict == "care"
    assert row.cure.startswith("make it smaller, or move home.q_rad: ")


@pytest.mark.parametrize("factor", [0.9, 8.0])
def test_gains_beyond_the_limit_swing_and_are_refused(robot: RobotModel, factor: float) -> None:
    """The verdict is what the plant does: the idle joint without friction, at the LWR4+'s table times a factor."""
    gains = [factor * gain for gain in robot.data.gains["default"]["K_N2"]]  # type: ignore[union-attr]
    asked = Scenario(control={"K_N2": gains}, plant={"friction": 0.0}, bound_samples=0, judge=False)
    asked = asked.change(task={"path": "line", "sizes": {"length": 0.005}})
    found = next(row for row in check_robot(robot, asked) if row.what == "gains")
    assert (found.verdict == "cannot") == (run(asked).meta["ended"] != "completed") == (factor > 1.0)
