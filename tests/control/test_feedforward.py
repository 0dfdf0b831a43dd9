"""With a perfect model the feed-forward gives tip and wrist the accelerations that were asked for."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from moc_opt.control.feedforward import desired_wrist_acceleration, independent_rows, motion_feedforward
from moc_opt.model.shaft_kernels import desired_wrist
from moc_opt.numerics.dense import cholesky

SPAN = 0.378


def test_wrist_acceleration_is_the_derivative_of_its_velocity():
    """Along a tip that moves on a parabola and a trocar at constant velocity."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        tip, velocity, acceleration = rng.normal(size=3), 0.1 * rng.normal(size=3), rng.normal(size=3)
        trocar, drift = tip + 0.15 * rng.normal(size=3), 0.05 * rng.normal(size=3)

        def wrist_velocity(t, x=tip, v=velocity, a=acceleration, p=trocar, dp=drift):
            return desired_wrist(x + v * t + 0.5 * a * t * t, v + a * t, p + dp * t, dp, SPAN)[1]

        found = desired_wrist_acceleration(tip, velocity, acceleration, trocar, drift, SPAN)
        assert_allclose(found, (wrist_velocity(1e-6) - wrist_velocity(-1e-6)) / 2e-6, rtol=1e-6, atol=1e-5)


def test_independent_rows_lose_nothing(robot, regular_poses):
    for q in regular_poses(10):
        s = robot.state(q)
        A5, across = independent_rows(np.array(s.A), np.array(s.tool_direction))
        assert np.linalg.matrix_rank(A5, tol=1e-9) == 5
        assert_allclose(across @ across.T, np.eye(2), atol=1e-14)
        assert_allclose(across @ s.tool_direction, 0.0, atol=1e-14)
        # what is left out follows: u^T J_W = u^T J_T
        assert_allclose(s.tool_direction @ s.J_wrist, s.tool_direction @ A5[:3], atol=1e-12)


def test_the_first_direction_across_is_level_with_the_axis_that_the_tool_is_least_along():
    """So that their cross product is never short: a tool along an axis, too."""
    rng = np.random.default_rng(4)
    tools = [*rng.normal(size=(40, 3)), *np.eye(3), *-np.eye(3), *(np.eye(3) + 1e-9)]
    for u in tools:
        u = u / np.linalg.norm(u)
        _, across = independent_rows(np.zeros((6, 7)), u)
        least = np.flatnonzero(np.abs(u) == np.abs(u).min())
        assert 0.0 in across[0, least]
        assert_allclose(np.vstack([across, u]) @ np.vstack([across, u]).T, np.eye(3), atol=1e-14)


def test_both_points_get_their_accelerations(robot, regular_poses):
    rng = np.random.default_rng(2)
    for q in regular_poses(10):
        s = robot.state(q, rng.normal(size=robot.n))
        u, turn = s.tool_direction, (s.J_tip - s.J_wrist) @ s.v
        tip = rng.normal(size=3)
        # a rigid tool: the points close in on each other at |turn|^2 / L
        wrist = tip + np.cross(u, rng.normal(size=3)) + (turn @ turn / s.tool_span) * u
        tau = motion_feedforward(
            np.array(s.A), np.array(u), cholesky(np.array(s.M)), np.r_[s.drift_tip, s.drift_wrist], tip, wrist
        )
        qdd = np.linalg.solve(s.M, tau)
        assert_allclose(s.J_tip @ qdd + s.drift_tip, tip, atol=1e-9)
        assert_allclose(s.J_wrist @ qdd + s.drift_wrist, wrist, atol=1e-8)


def straight(robot, angle):
    return robot.state([0.3, 0.6, 0.2, angle, 0.4, 0.9, 0.0], np.full(robot.n, 0.1))


@pytest.mark.parametrize("angle", [0.0, 1e-13, 1e-10, 1e-7, 1e-5, -1e-4])
def test_a_straight_elbow_leaves_out_what_it_cannot_do(robot, angle):
    """The torque stays near that of the straight elbow, and the tip gets its acceleration all the same."""
    rng = np.random.default_rng(3)
    tip, wrist = rng.normal(size=3), rng.normal(size=3)

    def torque(s):
        return motion_feedforward(
            np.array(s.A), np.array(s.tool_direction), cholesky(np.array(s.M)), np.r_[s.drift_tip, s.drift_wrist],
            tip, wrist,
        )  # fmt: skip

    s = straight(robot, angle)
    tau = torque(s)
    assert_allclose(tau, torque(straight(robot, 0.0)), atol=20.0 * abs(angle) + 1e-9)
    qdd = np.linalg.solve(s.M, tau)
    assert_allclose(s.J_tip @ qdd + s.drift_tip, tip, atol=1e-9)
    # across the tool the wrist gets the nearest that there is: the rest cannot be had by any joint acceleration
    across = np.eye(3) - np.outer(s.tool_direction, s.tool_direction)
    missing = across @ (wrist - s.J_wrist @ qdd - s.drift_wrist)
    free = np.linalg.svd(s.J_tip)[2][3:]  # joint accelerations that leave the tip alone
    size = np.linalg.norm(across @ s.J_wrist @ free.T, axis=0)
    assert np.abs(missing @ s.J_wrist @ free.T).max() <= (1e-9 + 2.0 * abs(angle)) * size.max()
    assert np.linalg.norm(missing) > 0.01


@pytest.mark.parametrize("scale", [1e-6, 1e6])
@pytest.mark.parametrize("angle", [2e-4, 5e-3, 0.5])
def test_the_unit_of_mass_does_not_matter(robot, angle, scale):
    """Neither to the torque nor to which elbow is a straight one."""
    rng, s = np.random.default_rng(5), straight(robot, angle)
    rest = np.array(s.A), np.array(s.tool_direction)
    accelerations = np.r_[s.drift_tip, s.drift_wrist], rng.normal(size=3), rng.normal(size=3)
    tau = motion_feedforward(*rest, cholesky(np.array(s.M)), *accelerations)
    scaled = motion_feedforward(*rest, cholesky(scale * s.M), *accelerations)
    assert_allclose(scaled, scale * tau, rtol=1e-7, atol=1e-9 * scale * np.abs(tau).max())
