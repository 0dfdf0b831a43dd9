"""Level 2: where the wrist belongs, its force, and projectors that leave the tip alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.control import law, rcm
from moc_opt.control.tip_impedance import task_inertia
from moc_opt.model.shaft_kernels import desired_wrist
from moc_opt.numerics.dense import cholesky
from moc_opt.tasks import shaft_distance
from tests.control.torques import of, tracking

NO_TIP = np.array([0.0, 0.0, 800.0, 60.0])  # K_X, D_X, K_N, D_N
BOTH = pytest.mark.parametrize("form", ["compiled", "plain"])
SEEDS = st.integers(0, 2**32 - 1)


def project(name, state, tau, form="compiled"):
    """tau through one of the projectors, with its own arguments made from the state."""
    J_tip = np.array(state.J_tip)
    if name == "dynamic":
        W, factor = task_inertia(J_tip, cholesky(np.array(state.M)))
        return of(rcm.project_dynamic, form)(J_tip, W, factor, tau)
    return of(getattr(rcm, f"project_{name}"), form)(J_tip, tau)


def matrix(name, state):
    """The projector itself (n, n), column by column."""
    return np.array([project(name, state, e) for e in np.eye(state.n)]).T


def level_two(state, trocar, projector):
    """tau_rcm alone: levels 1 and 2 without tip gains, less the arm's own dynamics."""
    tip_ref = np.zeros((3, 3))
    return tracking(state, tip_ref, trocar, gains=NO_TIP, projector=projector) - state.h


def shifted_trocar(state, rng, offset=0.01):
    """A trocar near the shaft, slowly moving."""
    point = state.tip - 0.15 * state.tool_direction + offset * rng.normal(size=3)
    return np.array([point, 0.02 * rng.normal(size=3)])


def unit(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


@BOTH
def test_projectors_against_numpy(form, robot, regular_poses):
    rng = np.random.default_rng(0)
    for q in regular_poses(10):
        s, tau = robot.state(q), rng.normal(size=7) * 10.0
        J, Minv = s.J_tip, np.linalg.inv(s.M)
        inertia = np.linalg.inv(J @ Minv @ J.T)
        inverse = Minv @ J.T @ inertia
        wanted = {
            "dynamic": (np.eye(7) - J.T @ inverse.T) @ tau,
            "static": (np.eye(7) - J.T @ np.linalg.pinv(J).T) @ tau,
            "as_published": (np.eye(7) - J.T @ J) @ tau,
        }
        assert set(wanted) == set(law.PROJECTORS)
        for name, value in wanted.items():
            np.testing.assert_allclose(project(name, s, tau, form), value, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", ["dynamic", "static"])
def test_consistent_projectors_are_idempotent(name, robot, regular_poses):
    for q in regular_poses(20):
        N = matrix(name, robot.state(q))
        np.testing.assert_allclose(N @ N, N, atol=1e-11 * np.abs(N).max() ** 2)
        assert np.linalg.matrix_rank(N, tol=1e-8) == 4  # seven joints less three tip directions


def test_level_two_moves_no_tip(robot, regular_poses):
    """J_T M^-1 tau_rcm = 0 for the dynamic projector, and only for it."""
    rng = np.random.default_rng(1)
    leak = {name: [] for name in law.PROJECTORS}
    for q in regular_poses(30):
        s = robot.state(q, rng.uniform(-1.0, 1.0, 7))
        trocar = shifted_trocar(s, rng)
        for number, name in enumerate(law.PROJECTORS):
            tau = level_two(s, trocar, number)
            free = np.linalg.norm(s.J_tip @ np.linalg.inv(s.M), 2) * np.linalg.norm(tau)
            leak[name].append(np.linalg.norm(s.J_tip @ np.linalg.solve(s.M, tau)) / free)
    assert max(leak["dynamic"]) < 1e-10
    assert np.median(leak["static"]) > 1e-3
    assert np.median(leak["as_published"]) > 1e-3


def test_static_projector_carries_no_tip_force(robot, regular_poses):
    """pinv(J_T)^T tau = 0: nothing of the torque is balanced by a force at the tip in rest."""
    rng = np.random.default_rng(2)
    for q in regular_poses(20):
        s = robot.state(q)
        tau = project("static", s, rng.normal(size=7) * 10.0)
        np.testing.assert_allclose(np.linalg.pinv(s.J_tip).T @ tau, 0.0, atol=1e-9)


@pytest.mark.parametrize("name", law.PROJECTORS)
@BOTH
def test_level_two_against_numpy(form, name, robot, regular_poses):
    number = {"dynamic": law.DYNAMIC, "static": law.STATIC, "as_published": law.AS_PUBLISHED}[name]
    assert law.PROJECTORS.index(name) == number
    rng = np.random.default_rng(3)
    for q in regular_poses(10):
        s = robot.state(q, rng.uniform(-1.0, 1.0, 7))
        trocar = shifted_trocar(s, rng)
        gains, tip_ref = np.array([0.0, 0.0, 700.0, 50.0]), np.zeros((3, 3))
        found = tracking(s, tip_ref, trocar, form, gains=gains, projector=number) - s.h

        L, dX = np.linalg.norm(s.tip - s.wrist), s.J_tip @ s.v
        to = trocar[0] - s.tip
        e = to / np.linalg.norm(to)
        de = (np.eye(3) - np.outer(e, e)) @ (trocar[1] - dX) / np.linalg.norm(to)
        force = 700.0 * (s.tip + L * e - s.wrist) + 50.0 * (dX + L * de - s.J_wrist @ s.v)
        Minv = np.linalg.inv(s.M)
        inverse = Minv @ s.J_tip.T @ np.linalg.inv(s.J_tip @ Minv @ s.J_tip.T)
        if name == "static":
            inverse = np.linalg.pinv(s.J_tip)
        elif name == "as_published":
            inverse = s.J_tip.T
        wanted = (np.eye(7) - s.J_tip.T @ inverse.T) @ s.J_wrist.T @ force
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9)


@settings(max_examples=100)
@given(seed=SEEDS, angle=st.floats(1e-4, 3.0), depth=st.floats(0.02, 0.3))
def test_rcm_error_is_proportional_to_the_wrist_error(seed, angle, depth):
    """d = lambda |N - N_d|, lambda = |P - X|/L cos(theta/2), theta between e and -u."""
    rng = np.random.default_rng(seed)
    span, tip, u = 0.378, rng.normal(size=3), unit(rng)
    wrist = tip - span * u
    across = np.cross(u, unit(rng))
    across /= np.linalg.norm(across)
    trocar = tip + depth * (-np.cos(angle) * u + np.sin(angle) * across)
    desired, _ = desired_wrist(tip, np.zeros(3), trocar, np.zeros(3), span)
    factor = depth / span * np.cos(angle / 2.0)
    d = float(shaft_distance(tip, wrist, trocar))
    assert d == pytest.approx(factor * np.linalg.norm(wrist - desired), rel=1e-9, abs=1e-12)


@BOTH
@pytest.mark.parametrize("rcm_lambda", [0.5, 0.2])
def test_published_error_of_the_wrist(form, rcm_lambda, robot, regular_poses):
    """F_W = K_N (d / lambda) (N_d - N)/|N_d - N| + D_N (dN_d - dN): the paper's length, our direction."""
    rng = np.random.default_rng(4)
    gains, tip_ref = np.array([0.0, 0.0, 800.0, 10.0]), np.zeros((3, 3))
    for q in regular_poses(10):
        s = robot.state(q, rng.uniform(-1.0, 1.0, 7))
        trocar = shifted_trocar(s, rng)
        found = tracking(s, tip_ref, trocar, form, gains=gains, rcm_lambda=rcm_lambda) - s.h
        desired, speed = desired_wrist(s.tip, s.J_tip @ s.v, trocar[0], trocar[1], s.tool_span)
        d = np.linalg.norm(np.cross(trocar[0] - s.tip, s.tool_direction))
        force = 800.0 * d / rcm_lambda * (desired - s.wrist) / np.linalg.norm(desired - s.wrist)
        force += 10.0 * (speed - s.J_wrist @ s.v)
        wanted = project("dynamic", s, s.J_wrist.T @ force)
        np.testing.assert_allclose(found, wanted, rtol=1e-8, atol=1e-8)


def test_published_error_is_ours_where_lambda_is_the_true_one(robot):
    s = robot.state(robot.data.q_home, np.full(7, 0.1))
    trocar = shifted_trocar(s, np.random.default_rng(2))
    desired, _ = desired_wrist(s.tip, s.tip * 0.0, trocar[0], trocar[1], s.tool_span)
    true = float(shaft_distance(s.tip, s.wrist, trocar[0])) / np.linalg.norm(s.wrist - desired)
    for number in range(3):
        ours, theirs = (
            tracking(s, np.zeros((3, 3)), trocar, gains=NO_TIP, projector=number, rcm_lambda=value)
            for value in (0.0, true)
        )
        np.testing.assert_allclose(theirs, ours, rtol=1e-9, atol=1e-9)


def test_wrist_is_accelerated_towards_where_it_belongs(robot, regular_poses):
    rng = np.random.default_rng(5)
    for q in regular_poses(20):
        s = robot.state(q)
        trocar = shifted_trocar(s, rng)
        trocar[1] = 0.0
        desired, _ = desired_wrist(np.array(s.tip), np.zeros(3), trocar[0], trocar[1], s.tool_span)
        tau = level_two(s, trocar, law.DYNAMIC)
        acceleration = s.J_wrist @ np.linalg.solve(s.M, tau)
        assert acceleration @ (desired - s.wrist) > 0.0


def test_no_torque_when_the_shaft_goes_through_the_trocar(robot, regular_poses):
    for q in regular_poses(10):
        s = robot.state(q)
        trocar = np.array([s.tip - 0.12 * s.tool_direction, np.zeros(3)])
        for number in range(3):
            np.testing.assert_allclose(level_two(s, trocar, number), 0.0, atol=1e-9)
