"""What the paper prints and what we compute: every row of the table, with the number that decides it.

Run with ``pytest -s tests/benchmarks/maintenance/test_errata.py`` to see the numbers.
"""

import numpy as np
import pytest

from moc_opt import solvers
from moc_opt.control import rcm, tick
from moc_opt.control.law import packed
from moc_opt.control.null_space import (
    consistent_wrist_velocity,
    null_space,
    self_motion_torque,
    velocity_damper,
)
from moc_opt.control.settings import ControlSettings
from moc_opt.control.tip_impedance import task_inertia
from moc_opt.model.shaft_kernels import desired_wrist
from moc_opt.numerics.dense import cholesky
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.scenario import Scenario, run
from moc_opt.vision.board import BOARD_TASKS

PAPER = ControlSettings.paper()  # c0 = c1 = 0.01, c2 = 0.001, rho = 0, k0 = 0.1
K = 0.1  # the paper's gain of the network
K_N2 = np.array([80.0, 120.0, 60.0, 30.0, 20.0, 10.0, 10.0])


@pytest.fixture(scope="module")
def states(robot, regular_poses):
    """The arm at rest in 50 regular poses."""
    return [robot.state(q) for q in regular_poses(50)]


def subproblem(robot, state, v=None, c2=PAPER.c2, rho=PAPER.regularization, speed=0.0, weight=1.0):
    """The paper's subproblem at a state; ``weight`` scales all four weights together."""
    lower, upper = np.empty(7), np.empty(7)
    velocity_damper(state.q, np.array([robot.q_min, robot.q_max, robot.v_max]), PAPER.k0_per_s, lower, upper)
    v_tip = np.array([speed, 0.0, 0.0])
    v_wrist = consistent_wrist_velocity(v_tip, v_tip, state.tool_direction)
    weights = (PAPER.c0 * weight, PAPER.c1 * weight, c2 * weight, rho * weight)
    return NullSpaceQP(state.J_tip, state.J_wrist, v_tip, v_wrist, state.grad_mu, lower, upper, *weights)


def saddle(A, P, sign=1.0):
    """Jacobian of F(Y) = [dL/dx, -dL/dl] (13, 13); sign = -1 is F as the paper prints it."""
    return sign * np.block([[P, A.T], [-A, np.zeros((6, 6))]])


def network(qp, steps, sign, k=0.5):
    """Y <- Y - k F(Y), x clipped to the box: the network with h = 1; x, and the last 500 values of |A x - b|."""
    x, y, slack = np.zeros(7), np.zeros(6), []
    for _ in range(steps):
        F_x, F_y = qp.P @ x + qp.p + qp.A.T @ y, -(qp.A @ x - qp.b)
        x, y = np.clip(x - sign * k * F_x, qp.lower, qp.upper), y - sign * k * F_y
        slack.append(np.abs(F_y).max())
    return x, np.array(slack[-500:])


# (I - J_T^T J_T) J_W^T F  ->  I - J_T^T Jbar_T^T, or I - J_T^T pinv(J_T)^T


def test_printed_projector_is_not_idempotent(states):
    printed, dynamic, static, leak = [], [], [], []
    for s in states:
        J, eye = np.array(s.J_tip), np.eye(7)
        W, factor = task_inertia(J, cholesky(np.array(s.M)))
        N = np.array([rcm.project_as_published(J, e) for e in eye]).T
        D = np.array([rcm.project_dynamic(J, W, factor, e) for e in eye]).T
        S = np.array([rcm.project_static(J, e) for e in eye]).T
        np.testing.assert_allclose(N, eye - J.T @ J, atol=1e-14)
        printed.append(np.linalg.norm(N @ N - N, 2))
        dynamic.append(np.linalg.norm(D @ D - D, 2))
        static.append(np.linalg.norm(S @ S - S, 2))
        leak.append(
            np.linalg.norm(J @ np.linalg.solve(s.M, N), 2) / np.linalg.norm(J @ np.linalg.inv(s.M), 2)
        )
    print(f"\n|N N - N|: printed {min(printed):.2f} to {max(printed):.2f}, dynamic {max(dynamic):.0e}, "
          f"static {max(static):.0e}; of the tip's acceleration it lets {min(leak):.0%} through")  # fmt: skip
    assert min(printed) > 0.1
    assert max(dynamic) < 1e-12
    assert max(static) < 1e-12
    assert min(leak) > 0.3


def test_printed_projector_depends_on_the_unit_of_length(robot):
    """J^T J is in m^2: in millimetres the same arm gets another projector. The consistent one does not."""
    s = robot.state(robot.data.q_home)
    metres, millimetres = np.array(s.J_tip), 1e3 * np.array(s.J_tip)
    tau = np.arange(1.0, 8.0)
    far = rcm.project_as_published(millimetres, tau) - rcm.project_as_published(metres, tau)
    near = rcm.project_static(millimetres, tau) - rcm.project_static(metres, tau)
    assert np.linalg.norm(far) > 1e5
    np.testing.assert_allclose(near, 0.0, atol=1e-9)


# J_W is 3x5  ->  3x7, zero where a joint does not move the wrist


def test_wrist_jacobian_has_seven_columns_three_of_them_zero(states):
    for s in states:
        assert s.J_wrist.shape == (3, 7)
        np.testing.assert_array_equal(s.J_wrist[:, 4:], 0.0)  # axes 5, 6 and 7 meet in the wrist centre
        assert (np.abs(s.J_wrist[:, :4]).max(axis=0) > 0.0).all()
        with pytest.raises(ValueError, match="matmul"):
            s.J_wrist[:, :5] @ s.v  # three rows and five columns cannot multiply seven velocities


# [(Z M Z^T) Z M]^T  ->  M Z^T (Z M Z^T)^-1 Z


def test_printed_third_level_lacks_an_inverse(states):
    wrong, right, factor = [], [], []
    for s in states:
        Z, M = null_space(s.A), np.array(s.M)
        printed = ((Z @ M @ Z.T) @ Z @ M).T
        assert printed.shape == (7, len(Z))  # not (7, 7): it takes no joint vector
        with pytest.raises(ValueError, match="matmul"):
            printed @ s.grad_mu
        N = np.array([self_motion_torque(M, Z, e) for e in np.eye(7)]).T
        np.testing.assert_allclose(N, M @ Z.T @ np.linalg.inv(Z @ M @ Z.T) @ Z, atol=1e-12)
        completed = printed @ Z  # with the missing Z its shape fits, the inverse still lacks
        wrong.append(np.linalg.norm(completed @ completed - completed, 2) / np.linalg.norm(completed, 2))
        right.append(np.linalg.norm(N @ N - N, 2) / np.linalg.norm(N, 2))
        factor.extend(np.linalg.eigvalsh(Z @ M @ Z.T) ** 2)  # printed over consistent torque, kg^2 m^4
    print(f"\n|N N - N|/|N|: printed {min(wrong):.2f} to {max(wrong):.2f}, with the inverse {max(right):.0e}; "
          f"the printed torque is {min(factor):.3f} to {max(factor):.2f} times the consistent one")  # fmt: skip
    assert min(wrong) > 0.5
    assert max(right) < 1e-12
    assert max(factor) < 0.5


# F(Y) = [-dL/dqd, dL/dl]  ->  [dL/dqd, -dL/dl]


def test_printed_sign_runs_away(robot, states):
    """Scaled weights (c0 = c1 = 1), k = 0.5, h = 1: the consistent sign converges, the printed one climbs L
    until the box stops it, and meets no reference."""
    exact = solvers.create("exact")
    lost, kept = [], []
    for s in states[:8]:
        qp = subproblem(robot, s, rho=1e-4, speed=0.005, weight=100.0)
        best = exact.start(qp).solve(qp)
        assert best.status is solvers.Status.SOLVED
        x, slack = network(qp, 10_000, +1.0)
        kept.append(slack.max())
        assert qp.residuals(x).loss < 0.05
        x, slack = network(qp, 1000, -1.0)
        lost.append(slack.min())
    print(
        f"\n|A x - b|: consistent {max(kept):.0e} m/s after 10000 steps, printed never below {min(lost):.1e} m/s"
    )
    assert max(kept) < 1e-5
    assert min(lost) > 1e-2


def test_printed_sign_has_unstable_modes(robot, states):
    for s in states[:10]:
        qp = subproblem(robot, s)
        consistent = np.linalg.eigvals(-K * saddle(qp.A, qp.P, +1.0)).real
        printed = np.linalg.eigvals(-K * saddle(qp.A, qp.P, -1.0)).real
        assert consistent.max() < 1e-10
        assert printed.max() > 1e-4


# grad F + grad F^T <= 0 with blocks J J^T (3x3)  ->  2 diag(c0 J_T^T J_T + c1 J_W^T J_W, 0, 0) >= 0 (7x7)


def test_gradient_of_f_is_positive_semidefinite_and_seven_by_seven(robot, states):
    lowest, highest, printed = [], [], []
    for s in states:
        qp = subproblem(robot, s)
        G = saddle(qp.A, qp.P)
        block = PAPER.c0 * s.J_tip.T @ s.J_tip + PAPER.c1 * s.J_wrist.T @ s.J_wrist
        wanted = np.zeros((13, 13))
        wanted[:7, :7] = 2.0 * block
        assert block.shape == (7, 7)
        assert (s.J_tip @ s.J_tip.T).shape == (3, 3)  # the printed block: of no use for seven velocities
        np.testing.assert_allclose(G + G.T, wanted, atol=1e-15)
        values = np.linalg.eigvalsh(G + G.T)
        lowest.append(values[0])
        highest.append(values[-1])
        printed.append(np.linalg.eigvalsh(-(G + G.T))[0])
    print(
        f"\neigenvalues of grad F + grad F^T: {min(lowest):.0e} to {max(highest):.1e}; printed sign: {min(printed):.1e}"
    )
    assert min(lowest) > -1e-15
    assert min(highest) > 1e-3
    assert max(printed) < -1e-3  # monotone F, on which convergence rests, it is not


# no time constant  ->  eps, or m steps per tick


def test_modes_are_slower_than_fifty_seconds_without_a_time_constant(robot, states):
    """dY/dt = -k F(Y) at the paper's gains: the real parts are k c0 s^2 / 2 for a singular value s of A."""
    fastest, slowest = np.inf, 0.0
    for s in states:
        qp = subproblem(robot, s)
        rates = -np.linalg.eigvals(-K * saddle(qp.A, qp.P)).real
        moving = rates[rates > 1e-12]
        assert len(moving) >= 6
        singular = np.linalg.svd(qp.A, compute_uv=False)[:5]
        np.testing.assert_allclose(moving.max(), 0.5 * K * PAPER.c0 * singular[0] ** 2, rtol=1e-6)
        fastest, slowest = min(fastest, 1.0 / moving.max()), max(slowest, 1.0 / moving.min())
    print(f"\ntime constants at c0 = 0.01, k = 0.1: {fastest:.0f} s to {slowest:.1e} s")
    assert fastest > 50.0


# e_N1 = d / lambda, lambda = 0.5  ->  |N_d - N|, or rcm_lambda


def test_the_true_lambda_is_not_constant(robot, states):
    """By the formula and by the distances; at the depths of the tasks it misses 0.5 and varies with the depth."""
    found = []
    for s in states:
        across = np.linalg.svd(s.tool_direction[None])[2][1]
        for depth in (task.depth_m for task in BOARD_TASKS.values()):
            trocar = s.tip - depth * s.tool_direction + 2e-3 * across
            desired, _ = desired_wrist(s.tip, np.zeros(3), trocar, np.zeros(3), s.tool_span)
            d = np.linalg.norm(np.cross(trocar - s.tip, s.tool_direction))
            found.append(d / np.linalg.norm(desired - s.wrist))
            share = rcm.published_share(s.tip, s.wrist, trocar, s.tool_span, PAPER.rcm_lambda)
            assert share == pytest.approx(found[-1] / PAPER.rcm_lambda, rel=1e-9)
    print(f"\ntrue lambda: {min(found):.3f} to {max(found):.3f}")
    assert max(found) > 1.2 * min(found)
    assert PAPER.rcm_lambda == 0.5


# K_N2 = [80, ...] on qdd_d at c2 = 0.001, k = 0.1  ->  kept as rnn-printed


def test_torque_of_the_printed_network_cannot_act(robot, states):
    """The share of mu in the torque: with c2 less without, the table's K_N2, from rest and in slow motion."""
    rng = np.random.default_rng(0)
    printed = solvers.create("rnn-printed")
    share, free = [], []
    for rest in states:
        for v in (np.zeros(7), rng.uniform(-0.01, 0.01, 7)):
            s = robot.state(rest.q, v)
            torques = []
            for c2 in (PAPER.c2, 0.0):
                qp = subproblem(robot, s, c2=c2)
                session = printed.start(qp)
                session.observe(v)
                x = session.solve(qp).x
                torques.append(tick.third_level(s.record, packed(7, K_N2=K_N2), null_space(s.A), x, 1.0))
            share.append(np.abs(torques[0] - torques[1]).max())
        whole = K_N2 * K * PAPER.c2 * rest.grad_mu  # where no bound is in the way
        free.append(np.abs(self_motion_torque(rest.M, null_space(rest.A), whole)).max())
    print(f"\ntorque of mu: {max(share):.1e} Nm, without bounds {max(free):.1e} Nm")
    assert max(share) == pytest.approx(max(free), rel=1e-6)
    assert 0.0 < max(share) < 2e-3


def test_printed_network_does_not_raise_the_manipulability():
    """In closed loop, where ``exact`` on the same trial does."""
    base = Scenario(
        duration_s=1.0, start={"swivel": 0.15}, plant={"preset": "nominal"}, judge=False, bound_samples=0,
        task={"wait_s": 2.0}, control={"preset": "paper"},
    )  # fmt: skip
    gain = {}
    for name in ("exact", "rnn-printed"):
        trace = run(base.change(solver={"name": name}))
        gain[name] = trace.mu[-1] / trace.mu[0] - 1.0
    print(f"\ngain in mu over one second: exact {gain['exact']:.1%}, rnn-printed {gain['rnn-printed']:.3%}")
    assert gain["exact"] > 0.1  # the paper's k0 = 0.1 keeps the elbow slow
    assert abs(gain["rnn-printed"]) < 1e-3 * gain["exact"]
