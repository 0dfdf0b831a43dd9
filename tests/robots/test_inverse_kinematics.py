"""Inverse kinematics reaches its targets or explains the failure."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import RobotError, TaskError
from moc_opt.robots.inverse_kinematics import pose_through, pose_with_tip, solve_pose
from moc_opt.tasks import shaft_distance


def inside(robot, q):
    return bool(((q >= robot.q_min) & (q <= robot.q_max)).all())


def test_target_is_reached_with_one_joint_at_its_limit(robot):
    """The shortest way to the goal leads beyond the limit."""
    q = np.array(robot.data.q_home)
    q[2] = robot.q_min[2] + 1e-3
    state = robot.state(q)
    elbow = np.linalg.svd(state.A[:, :6])[2][-1]
    there = q.copy()
    there[:6] += 0.05 * elbow * np.sign(elbow[2])
    goal = robot.state(there)
    q[2] = robot.q_min[2]
    placed = solve_pose(robot, q, goal.tip + np.array([0.0, 0.03, 0.0]))
    assert placed.found
    assert inside(robot, placed.q)


def test_nearest_pose_is_returned_for_target_out_of_reach(robot):
    placed = solve_pose(robot, robot.data.q_home, np.array([3.0, 0.0, 0.3]), iterations=200)
    assert not placed.found
    reach = 0.4 + 0.39 + 0.378  # shoulder to tip of the stretched arm
    assert placed.miss_m == pytest.approx(3.0 - reach, abs=0.05)
    gap = np.abs(np.array([3.0, 0.0, 0.3]) - robot.state(placed.q).tip).max()
    assert placed.miss_m == pytest.approx(gap, abs=1e-12)


@pytest.mark.parametrize(("q", "tip", "message"), [
    (np.full(7, np.nan), np.zeros(3), "q = .* is not finite"), (np.zeros((7, 1)), np.zeros(3), "q has shape"),
    (np.zeros(7), np.array([0.5, 0.0, np.nan]), "tip or wrist = .* is not finite"),
])  # fmt: skip
def test_invalid_pose_or_target_is_refused(robot, q, tip, message):
    """Without this check, a NaN target would count as reached."""
    with pytest.raises(RobotError, match=message):
        solve_pose(robot, q, tip)


@given(st.integers(0, 10_000))
@settings(max_examples=25)
def test_a_pose_is_found_for_the_tip_and_trocar_of_any_regular_pose(robot, seed):
    rng = np.random.default_rng(seed)
    state = robot.state(robot.random_regular_pose(rng))
    trocar = state.tip - rng.uniform(0.02, 0.28) * state.tool_direction
    q = pose_through(robot, state.tip, trocar)
    found = robot.state(q)
    assert inside(robot, q)
    np.testing.assert_allclose(found.tip, state.tip, atol=1e-6)
    assert shaft_distance(found.tip, found.wrist, trocar) < 1e-6
    alone = pose_with_tip(robot, robot.data.q_home, np.array([0.5, 0.3, 0.3]))
    assert inside(robot, alone)
    np.testing.assert_allclose(robot.state(alone).tip, [0.5, 0.3, 0.3], atol=1e-6)


@pytest.mark.parametrize(("tip", "trocar", "message"), [
    ((0.58, 0, 0.05), (0.58, 0, 0.45), "400 mm from the tip"), ((0.58, 0, 0.05), (0.58, 0, 0.05), "0 mm from the tip"),
    ((1.2, 0, 0.05), (1.2, 0, 0.2), "out of reach"), ((0.58, 0, np.nan), (0.58, 0, 0.2), "nan mm from the tip"),
])  # fmt: skip
def test_impossible_tip_or_trocar_is_refused_with_reason(robot, tip, trocar, message):
    with pytest.raises(TaskError, match=message):
        pose_through(robot, tip, trocar)
