"""Level 1: the force of the spring and damper, the inertia at the tip, and the torque of the whole level."""

import numpy as np
import pytest

from moc_opt.control.tip_impedance import compliance_force, task_inertia
from moc_opt.numerics.dense import cholesky
from tests.control.torques import of, tracking

GAINS = (3000.0, 80.0, 0.0, 0.0)  # no level 2
BOTH = pytest.mark.parametrize("form", ["compiled", "plain"])


def moving_states(robot, poses, seed=1):
    rng = np.random.default_rng(seed)
    return [robot.state(q, rng.uniform(-1.0, 1.0, robot.n)) for q in poses]


def references(rng, state):
    """A tip reference nearby, and a trocar on the shaft."""
    tip_ref = np.array([state.tip + rng.normal(size=3) * 1e-3, rng.normal(size=3) * 0.05, rng.normal(size=3)])
    trocar = np.array([state.tip - 0.15 * state.tool_direction, np.zeros(3)])
    return tip_ref, trocar


@BOTH
def test_force_is_spring_and_damper(form):
    rng = np.random.default_rng(0)
    for _ in range(20):
        K, D = rng.uniform(0.0, 5000.0), rng.uniform(0.0, 100.0)
        x_d, dx_d, x, dx = rng.normal(size=(4, 3))
        np.testing.assert_allclose(
            of(compliance_force, form)(K, D, x_d, dx_d, x, dx),
            K * (x_d - x) + D * (dx_d - dx),
            rtol=1e-14,
            atol=1e-9,
        )


@BOTH
def test_task_inertia(form, robot, regular_poses):
    for q in regular_poses(10):
        s = robot.state(q)
        W, factor = of(task_inertia, form)(np.array(s.J_tip), cholesky(np.array(s.M)))
        Minv = np.linalg.inv(s.M)
        np.testing.assert_allclose(W, Minv @ s.J_tip.T, rtol=0.0, atol=1e-12 * np.abs(W).max())
        mobility = s.J_tip @ Minv @ s.J_tip.T
        np.testing.assert_allclose(factor @ factor.T, mobility, rtol=0.0, atol=1e-12 * np.abs(mobility).max())


@BOTH
def test_torque_of_the_level(form, robot, regular_poses):
    rng = np.random.default_rng(2)
    for s in moving_states(robot, regular_poses(10)):
        tip_ref, trocar = references(rng, s)
        found = tracking(s, tip_ref, trocar, form, gains=GAINS)
        J = s.J_tip
        force = 3000.0 * (tip_ref[0] - s.tip) + 80.0 * (tip_ref[1] - J @ s.v)
        np.testing.assert_allclose(found, s.h + J.T @ force, rtol=1e-10, atol=1e-9)


def test_at_rest_on_the_reference_only_gravity_is_carried(robot, regular_poses):
    for q in regular_poses(5):
        s = robot.state(q)
        tip_ref = np.array([s.tip, np.zeros(3), np.zeros(3)])
        trocar = np.array([s.tip - 0.1 * s.tool_direction, np.zeros(3)])
        gains = np.array([3000.0, 80.0, 800.0, 60.0])
        tau = tracking(s, tip_ref, trocar, gains=gains)
        np.testing.assert_allclose(tau, robot.gravity(q), atol=1e-10)


def test_feedforward_gives_the_tip_its_acceleration(robot, regular_poses):
    """With a perfect model and no tracking error, X'' = ddX_d; without feed-forward it is not."""
    rng = np.random.default_rng(3)
    for s in moving_states(robot, regular_poses(10)):
        _, trocar = references(rng, s)
        tip_ref = np.array([s.tip, s.J_tip @ s.v, rng.normal(size=3)])
        accelerations = []
        for feedforward in (True, False):
            tau = tracking(s, tip_ref, trocar, gains=GAINS, feedforward=feedforward)
            qdd = np.linalg.solve(s.M, tau - s.h)
            accelerations.append(s.J_tip @ qdd + s.drift_tip)
        np.testing.assert_allclose(accelerations[0], tip_ref[2], atol=1e-9)
        assert np.abs(accelerations[1] - tip_ref[2]).max() > 1e-2


def test_spring_pulls_the_tip_back(robot, regular_poses):
    """The force does positive work towards the reference: a sign error would push away."""
    for q in regular_poses(10):
        s = robot.state(q)
        offset = np.array([1e-3, -2e-3, 1e-3])
        tip_ref = np.array([s.tip + offset, np.zeros(3), np.zeros(3)])
        trocar = np.array([s.tip - 0.1 * s.tool_direction, np.zeros(3)])
        tau = tracking(s, tip_ref, trocar, gains=GAINS)
        acceleration = s.J_tip @ np.linalg.solve(s.M, tau - s.h)
        assert acceleration @ offset > 0.0
