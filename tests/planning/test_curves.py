"""Curves of poses with the same tip and wrist. A gantry's curves are straight lines."""

import numpy as np
import pytest

from moc_opt import core
from moc_opt.planning.self_motion import self_motion
from moc_opt.robots.model import load_robot

AXES = [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]
ALONG = np.array([1.0, -1.0, 0.0, 0.0, 0.0]) / np.sqrt(2.0)
TURN = np.eye(5)[4]


def gantry(slides):
    """Four joints slide along x, x, y and z. The fifth slides along z if `slides`, and turns about z otherwise."""
    rows = np.zeros((5, 27))
    rows[:, :9], rows[:, 12:15], rows[:, 15] = np.eye(3).ravel(), AXES, [1, 1, 1, 1, slides]
    moves = np.ones((2, 5))
    moves[:, 4] = slides
    return core.Arm(rows, np.array([[0.0, 0.0, 0.35], [0.0, 0.0, 0.05]]), np.eye(3), moves, np.zeros(3))


def follow(low, high, start, tangent, step, most=200, slides=False):
    arm = gantry(slides)
    tips, wrists, _ = arm.along(start[None])
    s, poses, mus = np.full(most, np.nan), np.full((most, 5), np.nan), np.full(most, np.nan)
    count, closed = arm.follow_curve(low, high, np.array([tips[0], wrists[0]]), start, tangent, step, s, poses, mus)
    assert (np.isnan(s[count:]).all(), np.isfinite(mus[:count]).all()) == (True, True)
    return s[:count], poses[:count], closed


def test_a_straight_curve_ends_at_the_first_joint_limit():
    start, high = np.array([0.1, 0.2, 0.3, 0.0, 0.0]), np.array([0.5, 3.0, 1.0, 0.0, 0.0])
    for least, end in ((-0.19, 0.39), (-0.21, 0.4), (-0.3, 0.4)):  # joint 2 ends the curve at 0.39, joint 1 at 0.4
        low = np.array([-1.0, least, 0.2, 0.0, 0.0])
        s, poses, closed = follow(low, high, start, 0.5 * ALONG + np.eye(5)[2], 0.11)
        length = np.sqrt(2.0) * end
        np.testing.assert_allclose(s, [*np.arange(0.0, length - 1e-3, 0.11), length], atol=1e-9)
        np.testing.assert_allclose(poses, start + s[:, None] * ALONG, atol=1e-9)
        assert poses[-1, 1 if end < 0.4 else 0] == (least if end < 0.4 else 0.5), "the curve ends exactly at the limit"
        assert not closed
        again, *_ = follow(low, high, poses[-1], ALONG, 0.11)
        assert len(again) == 1, "the start is at the limit already"
        assert len(follow(low, high, start, np.eye(5)[2], 0.11)[0]) == 1, "no self-motion lies along this tangent"
        shorter, *_ = follow(low, high, start, ALONG, 0.11, most=3)
        np.testing.assert_array_equal(shorter, s[:3])


@pytest.mark.parametrize("step", [0.1, 0.0995, 0.15, 2.0 * np.pi / 60])
def test_a_curve_closes_after_one_turn_of_a_joint(step):
    low, high, start = np.full(5, -30.0), np.full(5, 30.0), np.array([1.0, 0.0, 0.0, 0.0, 2.0])
    low[1:4] = high[1:4] = 0.0
    low[0] = high[0] = 1.0
    for way in (1.0, -1.0):
        s, poses, closed = follow(low, high, start, way * TURN, step)
        np.testing.assert_allclose(poses, start + np.outer(s, way * TURN), atol=1e-12)
        assert (closed, s[-1]) == (True, pytest.approx(2.0 * np.pi, abs=1e-12))
        gaps = np.diff(s)
        np.testing.assert_allclose(gaps[:-1], step, atol=1e-9)
        assert 0.1 * step < gaps[-1] < 1.11 * step
        most = len(s) - 1
        assert len(follow(low, high, start, way * TURN, step, most=most)[0]) == most
        for side, limits in ((1.0, high), (-1.0, low)):
            bounded = limits.copy()
            bounded[4] = 2.0 + side * (2.0 * np.pi - 0.04)  # a limit ends the curve just before it closes
            pair = (low, bounded) if side > 0.0 else (bounded, high)
            s, poses, closed = follow(*pair, start, side * TURN, step)
            assert (closed, poses[-1, 4]) == (0, bounded[4])
    low[3], high[3] = -30.0, 30.0
    tangent = np.array([0.0, 0.0, 0.0, 1.0, -1.0]) / np.sqrt(2.0)
    s, _, closed = follow(low, high, start, tangent, step, most=400, slides=True)
    assert (closed, s[-1]) == (False, pytest.approx(min(399 * step, 30.0 * np.sqrt(2.0)), rel=1e-9))


def test_inverse_kinematics_takes_short_damped_newton_steps():
    arm, low, high = gantry(True), np.zeros(5), np.zeros(5)
    low[2], high[2] = -9.0, 9.0
    for reach, points in ((0.7, 2), (0.2, 1)):
        target = np.array([[0.0, reach, 0.35], [0.0, reach, 0.05]])[:points]
        error = reach
        for rounds in range(1, 9):
            miss, q = arm.nearest_pose(low, high, target, np.zeros(5), rounds)
            assert (miss, q[2]) == (pytest.approx(error, abs=1e-9), pytest.approx(reach - error, abs=1e-9))
            error -= min(0.25, points * error / (points + 0.1 * points * error**2))
    miss, q = arm.nearest_pose(low, high, target, high, 0)
    assert (miss, q.tolist()) == (np.inf, high.tolist())
    high[2] = 0.5
    miss, q = arm.nearest_pose(low, high, np.array([[0.0, 0.7, 0.35]]), np.zeros(5), 60)
    assert (miss, q[2]) == (pytest.approx(0.2), 0.5)


@pytest.mark.parametrize(("name", "draw"), [("panda", 129), ("panda", 298), ("gen3", 260), ("xarm7", 5)])
def test_a_sharply_bent_curve_is_followed_in_shorter_steps(name, draw):
    robot = load_robot(name)
    q = np.random.default_rng(3).uniform(robot.q_min, robot.q_max, (300, 7))[draw]
    fine, coarse = (self_motion(robot, q, step=step) for step in (0.005, 0.1))
    assert np.ptp(coarse.s) == pytest.approx(np.ptp(fine.s), rel=5e-4)
    assert coarse.mu_best == pytest.approx(fine.mu_best, rel=1e-4)
    gaps = np.diff(coarse.s)
    assert gaps.min() < 0.011 < 0.099 < np.median(gaps)
