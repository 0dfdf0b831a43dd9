"""The search for a home pose: what it promises holds on every arm of the package, and seeds repeat."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from moc_opt.commissioning.home import CLEARANCE_M, MARGIN, REGULAR, SHARE, search_home, task_fault
from moc_opt.errors import RobotError
from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.redundancy.freedoms import freedoms
from moc_opt.robots import available_robots
from moc_opt.scenario import Scenario


@pytest.mark.parametrize("name", available_robots())
def test_a_found_pose_is_what_was_asked_for(name: str) -> None:
    robot = load_robot(name)
    home = search_home(robot, seed=3)
    left, state = freedoms(robot, home.q), robot.state(home.q)
    assert left.tip > REGULAR[0]
    assert left.both > REGULAR[1]
    assert home.margin > MARGIN - 0.01  # poses are rounded to two digits
    assert SHARE[0] <= home.mu / home.mu_best <= SHARE[1]
    assert state.mu == pytest.approx(home.mu)
    assert min(state.tip[2], state.wrist[2]) > CLEARANCE_M - 0.01
    assert home.task == "" == task_fault(robot, home.q)


def test_seeds_repeat_and_differ(robot: RobotModel) -> None:
    np.testing.assert_array_equal(search_home(robot, seed=1).q, search_home(robot, seed=1).q)
    assert np.abs(search_home(robot, seed=1).q - search_home(robot, seed=2).q).max() > 0.1


def test_a_task_that_cannot_be_done_says_why(robot: RobotModel) -> None:
    said = task_fault(robot, robot.data.q_home, Scenario(task={"sizes": {"radius": 0.8}}))
    assert "mm along the path" in said


def test_an_arm_that_is_singular_everywhere_has_no_home(robot: RobotModel) -> None:
    """Limits that keep elbow and wrist straight."""
    q_min, q_max = robot.data.q_min.copy(), robot.data.q_max.copy()
    q_min[[1, 3, 5]], q_max[[1, 3, 5]] = -1e-3, 1e-3
    stiff = RobotModel(dataclasses.replace(robot.data, q_min=q_min, q_max=q_max, q_home=np.zeros(7)))
    with pytest.raises(RobotError, match="home pose: 6000 poses drawn"):
        search_home(stiff)
