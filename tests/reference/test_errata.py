"""Errors in the paper (last section of docs/method.md). Above each test are the printed and the right formula."""

import numpy as np
import pytest

from moc_opt import solvers
from moc_opt.control.settings import ControlSettings
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.robots.chain import desired_wrist
from moc_opt.tasks.trocar import shaft_distance
from moc_opt.vision.board import BOARD_TASKS
from tests.reference.law import null_space, projector, third_level, velocity_damper

PAPER = ControlSettings.preset("paper")
K = 0.1  # gain of the network, as printed
K_N2 = np.array([80.0, 120.0, 60.0, 30.0, 20.0, 10.0, 10.0])  # Table I [N m s/rad]


@pytest.fixture(scope="module")
def states(robot, regular_poses):
    return [robot.state(q) for q in regular_poses(50)]


def subproblem(robot, state, c2=PAPER.c2):
    lower, upper = velocity_damper(state.q, robot.q_min, robot.q_max, robot.v_max, PAPER.k0_per_s)
    return NullSpaceQP(
        state.J_tip, state.J_wrist, np.zeros(3), np.zeros(3), state.grad_mu, lower=lower, upper=upper,
        c0=PAPER.c0, c1=PAPER.c1, c2=c2, regularization=PAPER.regularization,
    )  # fmt: skip


def idempotence(N):
    return np.linalg.norm(N @ N - N, 2) / np.linalg.norm(N, 2)


def leak(state, N):
    """Return the share of the tip acceleration that the projector N lets through."""
    J, M = state.J_tip, state.M
    return np.linalg.norm(J @ np.linalg.solve(M, N), 2) / np.linalg.norm(J @ np.linalg.inv(M), 2)


def saddle(qp):
    """Return the Jacobian (n + 6, n + 6) of F(Y) = [dL/dx, -dL/dlambda]."""
    return np.block([[qp.P, qp.A.T], [-qp.A, np.zeros((6, 6))]])


# Printed: (I - J_T^T J_T) J_W^T F. Right: I - J_T^T Jbar_T^T, or I - J_T^T pinv(J_T)^T.
def test_printed_projector_lets_the_tip_move(states):
    for s in states:
        printed, dynamic, static = (projector(name, s) for name in ("as_published", "dynamic", "static"))
        assert idempotence(printed) > 0.05
        assert max(idempotence(dynamic), idempotence(static)) < 1e-12
        assert leak(s, dynamic) < 1e-10 < 0.3 < leak(s, printed)


# Printed: J_W is 3x5. Right: it is 3x7, and zero where a joint does not move the wrist.
def test_wrist_jacobian_has_seven_columns(states):
    for s in states:
        assert s.J_wrist.shape == (3, 7)
        np.testing.assert_array_equal(s.J_wrist[:, 4:], 0.0)  # axes 5, 6 and 7 meet in the wrist centre
        assert (np.abs(s.J_wrist[:, :4]).max(axis=0) > 0.0).all()


# Printed: [(Z M Z^T) Z M]^T. Right: M Z^T (Z M Z^T)^-1 Z.
def test_printed_third_level_lacks_an_inverse(states):
    for s in states:
        Z = null_space(s.A)
        inner = Z @ s.M @ Z.T
        consistent, printed = s.M @ Z.T @ np.linalg.inv(inner) @ Z, (inner @ Z @ s.M).T
        assert printed.shape == (7, len(Z))  # it cannot multiply a joint vector (7,)
        assert idempotence(consistent) < 1e-9
        assert idempotence(printed @ Z) > 0.5
        # If Z x is an eigenvector of inner, printed torque = (its eigenvalue)^2 [kg^2 m^4] * consistent torque.
        assert (np.linalg.eigvalsh(inner) ** 2).max() < 0.5


# Printed: grad F + grad F^T <= 0, with 3x3 blocks J J^T. Right: 2 diag(c0 J_T^T J_T + c1 J_W^T J_W, 0, 0) >= 0 (7x7).
def test_gradient_of_f_is_positive_semidefinite(robot, states):
    for s in states:
        G, wanted = saddle(subproblem(robot, s)), np.zeros((13, 13))
        wanted[:7, :7] = 2.0 * (PAPER.c0 * s.J_tip.T @ s.J_tip + PAPER.c1 * s.J_wrist.T @ s.J_wrist)
        np.testing.assert_allclose(G + G.T, wanted, atol=1e-15)
        # The proof of convergence needs a monotone F.
        assert np.linalg.eigvalsh(G + G.T)[-1] > 1e-3


# Printed: F(Y) = [-dL/dx, dL/dlambda], without a time constant. Right: [dL/dx, -dL/dlambda], with a time constant.
def test_deviations_grow_with_the_printed_sign(robot, states):
    """With dY/dt = -k F(Y), the real part of an eigenvalue is -k c0 s^2 / 2 for a singular value s of A."""
    for s in states:
        qp = subproblem(robot, s)
        growth = np.linalg.eigvals(-K * saddle(qp)).real  # the printed sign negates these values
        assert growth.max() < 1e-10
        assert (growth < -1e-12).sum() >= 6  # zero along the null space of A
        largest = np.linalg.svd(qp.A, compute_uv=False)[0]
        assert growth.min() == pytest.approx(-0.5 * K * PAPER.c0 * largest**2, rel=1e-6)
        assert 1e-4 < -growth.min() < 1.0 / 50.0


# Length of the wrist error. Printed: d / lambda, with the RCM error d and lambda = 0.5. Right: |N_d - N|.
def test_true_lambda_is_not_constant(states):
    """The true lambda d / |N_d - N| equals (depth of the tip below the trocar) / (length from wrist N to tip)."""
    depths, found = np.array([task.depth_m for task in BOARD_TASKS.values()]), []
    for s in states:
        across = np.cross(s.tool_direction, np.eye(3)[np.argmin(np.abs(s.tool_direction))])
        for depth in depths:
            trocar = s.tip - depth * s.tool_direction + 0.002 * across / np.linalg.norm(across)
            desired, _ = desired_wrist(s.tip, np.zeros(3), trocar, np.zeros(3), s.tool_span)
            found.append(shaft_distance(s.tip, s.wrist, trocar) / np.linalg.norm(s.wrist - desired))
    np.testing.assert_allclose(found, np.tile(depths / states[0].tool_span, len(states)), rtol=1e-3)
    assert max(found) > 1.2 * min(found)
    assert PAPER.rcm_lambda == 0.5


# Printed: K_N2 = [80, ...], c2 = 0.001 and k = 0.1. With them, mu adds less than 2 mNm to each joint torque.
def test_mu_hardly_changes_the_torques_of_the_printed_network(robot, states):
    rng, printed, added, expected = np.random.default_rng(0), solvers.create("rnn-printed"), 0.0, 0.0
    for at_rest in states:
        for v in (np.zeros(7), rng.uniform(-0.01, 0.01, 7)):
            s, torques = robot.state(at_rest.q, v), []
            for c2 in (PAPER.c2, 0.0):
                qp = subproblem(robot, s, c2=c2)
                session = printed.start(qp)
                session.observe(v)
                torques.append(third_level(s, session.solve(qp).x, K_N2, np.zeros(7)))
            added = max(added, np.abs(torques[0] - torques[1]).max())
        wish = K_N2 * K * PAPER.c2 * at_rest.grad_mu
        expected = max(expected, np.abs(third_level(at_rest, wish, np.ones(7), np.zeros(7))).max())
    assert added == pytest.approx(expected, rel=1e-6)
    assert 0.0 < added < 2e-3
