"""A task that the arm cannot do is refused before anything moves, naming field, place and cure."""

import dataclasses
import re

import numpy as np
import pytest

from moc_opt.errors import TaskError
from moc_opt.model.inverse_kinematics import pose_through
from moc_opt.model.robot_model import RobotModel
from moc_opt.procedure import reachability as reach
from moc_opt.procedure.reachability import UnreachableError, check_reachable
from moc_opt.redundancy.self_motion import self_motion
from moc_opt.tasks import Reference, Trocar, line, make_path, shaft_distance
from moc_opt.vision.board import BOARD_TASKS, Board, board_below


@pytest.fixture(scope="module")
def home(robot):
    return robot.state(robot.data.q_home)


@pytest.fixture(scope="module")
def trocar(home):
    return home.tip - 0.15 * home.tool_direction


def reference(home, kind="circle", v_max=0.05, a_max=0.2, **sizes):
    path = make_path(kind, home.tip, normal=(0, 0, 1), heading=(1, 0, 0), **sizes)
    return Reference(path, v_max, a_max)


@pytest.mark.parametrize("name", list(BOARD_TASKS))
def test_the_three_tasks_are_within_reach(robot, home, trocar, name):
    board_in_base = board_below(trocar, home.tool_direction, BOARD_TASKS[name].depth_m)
    task = Reference(Board().task_in_base(name, board_in_base), 0.05, 0.2)
    q = pose_through(robot, task.path.start, trocar)
    found = check_reachable(robot, q, task, trocar)
    assert found.as_given
    for t, pose in zip(found.t_s, found.q_rad, strict=True):
        state = robot.state(pose)
        np.testing.assert_allclose(state.tip, task.at(t)[0], atol=2e-6)
        assert shaft_distance(state.tip, state.wrist, trocar) < 2e-6
    assert found.margin_rad.min() > 0.0
    assert ((found.q_rad >= robot.q_min) & (found.q_rad <= robot.q_max)).all()
    assert found.arc_length_m[-1] == pytest.approx(task.path.length, rel=1e-4)
    assert found.speed_share.max() < 1.0


def test_the_speeds_are_those_of_the_followed_poses(robot, home, trocar):
    """Between two close points the joints need no less than the share that was reported."""
    task = reference(home, radius=0.03)
    found = check_reachable(robot, robot.data.q_home, task, trocar, spacing_m=5e-4)
    rates = np.diff(found.q_rad, axis=0) / np.diff(found.t_s)[:, None]
    shares = np.abs(rates / robot.v_max).max(axis=1)
    middle = 0.5 * (found.speed_share[1:] + found.speed_share[:-1])
    fast = middle > 0.03
    np.testing.assert_allclose(shares[fast], middle[fast], rtol=0.05)


def test_too_fast_names_the_joint_and_a_speed_that_works(robot, home, trocar):
    with pytest.raises(UnreachableError, match="rad/s") as told:
        check_reachable(robot, robot.data.q_home, reference(home, "line", 5.0, 200.0, length=0.06), trocar)
    assert told.value.field == "v_max"
    assert 0.0 < told.value.arc_length_m < 0.06
    slower = float(re.search(r"from 5 to ([0-9.]+) m/s", str(told.value)).group(1))
    assert 0.1 < slower < 5.0
    found = check_reachable(
        robot, robot.data.q_home, reference(home, "line", slower, 200.0, length=0.06), trocar
    )
    assert 0.9 < found.speed_share.max() <= 1.0


def test_a_path_that_leaves_the_workspace_says_where(robot):
    """Drawn out along the shaft, the wrist rises until the arm is stretched."""
    tip, trocar = np.array([0.74, 0.0, 0.10]), np.array([0.74, 0.0, 0.30])
    upwards = Reference(line(tip, tip + np.array([0.0, 0.0, 0.16])), 0.05, 0.2)
    with pytest.raises(UnreachableError, match="make the path smaller") as told:
        check_reachable(robot, pose_through(robot, tip, trocar), upwards, trocar)
    assert told.value.field == "path"
    # The shoulder is at 0.3105 m, the arm 0.79 m long, and the wrist 0.378 m above the tip.
    stretched = np.sqrt(0.79**2 - 0.74**2) + 0.3105 - 0.378 - 0.10
    assert told.value.arc_length_m == pytest.approx(stretched, abs=0.003)
    assert f"{1e3 * told.value.arc_length_m:.1f} mm along the path" in str(told.value)


def test_joint_limits_are_named(robot, home, trocar):
    """The elbow's angle follows from the wrist's distance alone: no self-motion can help a joint 4 that is stuck."""
    highest = np.array(robot.q_max)
    highest[3] = home.q[3] + 0.05
    stiff = RobotModel(dataclasses.replace(robot.data, q_max=highest))
    with pytest.raises(UnreachableError, match="joint_4 at the limit") as told:
        check_reachable(stiff, home.q, reference(home, "line", length=0.1), trocar)
    assert told.value.field == "joint limits"
    free = check_reachable(robot, home.q, reference(home, "line", length=0.1), trocar)
    over = free.q_rad[:, 3] > highest[3]
    assert told.value.arc_length_m == pytest.approx(free.arc_length_m[over][0], abs=0.003)


@pytest.mark.parametrize("offset", [(0, 0, 0.3), (1.0, 0, -0.1)])
def test_a_trocar_beyond_the_tool_is_out_of_reach(robot, home, trocar, offset):
    with pytest.raises(UnreachableError, match=r"trocar: .* more than the tool's 300 mm") as told:
        check_reachable(robot, robot.data.q_home, reference(home, radius=0.03), trocar + np.array(offset))
    assert told.value.field == "trocar"
    assert told.value.arc_length_m == 0.0


def test_a_trocar_that_no_pose_can_serve_is_out_of_reach(robot, home):
    with pytest.raises(UnreachableError, match="no pose has the tip"):
        check_reachable(
            robot, robot.data.q_home, reference(home, radius=0.02), home.tip + np.array([0.1, 0, -0.1])
        )


def test_a_path_through_the_trocar_is_refused(robot, home):
    up = Reference(line(home.tip, home.tip + np.array([0.0, 0.0, 0.06])), 0.05, 0.2)
    near = home.tip - 0.03 * home.tool_direction
    with pytest.raises(UnreachableError, match="no direction") as told:
        check_reachable(robot, robot.data.q_home, up, near)
    assert told.value.field == "path"
    assert told.value.arc_length_m == pytest.approx(0.03, abs=0.003)


def test_a_reference_that_begins_elsewhere_is_refused(robot, home, trocar):
    away = Reference(line(home.tip + np.array([0.0, 0.01, 0.0]), home.tip), 0.05, 0.2)
    with pytest.raises(UnreachableError, match=r"start: .* begins 10\.0 mm from the tip"):
        check_reachable(robot, robot.data.q_home, away, trocar)


def test_another_swivel_is_tried_where_the_given_one_gets_stuck(robot, home, trocar, monkeypatch):
    """Every start of the self-motion serves; one that is made to fail is replaced by the one in the middle."""
    task = reference(home, radius=0.03)
    scan = self_motion(robot, home.q)
    for fraction in (0.0, 0.5, 1.0):
        found = check_reachable(robot, scan.at(fraction), task, trocar)
        assert found.as_given
        assert found.margin_rad.min() >= 0.0

    solve = reach.solve_pose
    given = home.q[0]

    def only_elsewhere(arm, q, tip, wrist):
        placed = solve(arm, q, tip, wrist)
        return placed if abs(q[0] - given) > 0.05 else placed._replace(miss_m=1.0)

    monkeypatch.setattr(reach, "solve_pose", only_elsewhere)
    found = check_reachable(robot, home.q, task, trocar)
    assert not found.as_given
    room = np.minimum(scan.q - robot.q_min, robot.q_max - scan.q).min(axis=1)
    assert found.margin_rad[0] == pytest.approx(room.max(), abs=1e-6)


def test_breathing_trocars_are_followed(robot, home, trocar):
    path = make_path("circle", home.tip, normal=(0, 0, 1), heading=(1, 0, 0), radius=0.02)
    circle = Reference(path, 0.05, 0.2, t_start=0.2)
    breathing = Trocar(trocar, breathing_amplitude_m=0.01)
    found = check_reachable(robot, robot.data.q_home, circle, breathing)
    for t, pose in zip(found.t_s[::7], found.q_rad[::7], strict=True):
        state = robot.state(pose)
        assert shaft_distance(state.tip, state.wrist, breathing.at(t)[0]) < 2e-6


def test_what_is_raised_is_a_task_error(robot, home):
    with pytest.raises(TaskError):
        check_reachable(
            robot, robot.data.q_home, reference(home, radius=0.02), home.tip + np.array([0, 0, 1.0])
        )
