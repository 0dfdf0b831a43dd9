"""The paper's equations as printed and as computed here, in numpy; docs/method.md has the table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space

from moc_opt import solvers
from moc_opt.arrays import Array
from moc_opt.control.settings import ControlSettings
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.robots.chain import desired_wrist
from moc_opt.robots.model import RobotModel, RobotState
from moc_opt.scenario import Scenario, run
from moc_opt.solvers.base import ObservingSession
from moc_opt.tasks.trocar import shaft_distance
from moc_opt.vision.board import BOARD_TASKS

PAPER = ControlSettings.paper()
K = 0.1  # gain of the network, as printed
K_N2 = np.array([80.0, 120.0, 60.0, 30.0, 20.0, 10.0, 10.0])
"""(7,) Table I [N m s/rad]"""


@dataclass(frozen=True)
class Arm:
    """The arm at rest in the poses that the numbers are taken over."""

    robot: RobotModel
    states: tuple[RobotState, ...]

    def subproblem(
        self, state: RobotState, c2: float = PAPER.c2, rho: float = PAPER.regularization, weight: float = 1.0,
        speed: float = 0.0,
    ) -> NullSpaceQP:  # fmt: skip
        """Make the paper's subproblem at a state; ``weight`` scales c0, c1, c2 and rho; tip speed [m/s] along x."""
        robot, k0, v_tip = self.robot, PAPER.k0_per_s, np.array([speed, 0.0, 0.0])
        lower, upper = (
            np.clip(-k0 * (state.q - limit), -robot.v_max, robot.v_max) for limit in (robot.q_min, robot.q_max)
        )
        v_wrist = v_tip  # the tool is rigid: u^T (v_T - v_W) = 0
        return NullSpaceQP(
            state.J_tip, state.J_wrist, v_tip, v_wrist, state.grad_mu, lower=lower, upper=upper,
            c0=PAPER.c0 * weight, c1=PAPER.c1 * weight, c2=c2 * weight, regularization=rho * weight,
        )  # fmt: skip


# --- both forms, computed ---


def projectors(state: RobotState) -> tuple[Array, Array, Array]:
    """Return the printed, the dynamic and the static projector (n, n) of level 2."""
    J, eye, yields = np.array(state.J_tip), np.eye(len(state.q)), np.linalg.inv(state.M)
    dynamic = eye - J.T @ np.linalg.inv(J @ yields @ J.T) @ J @ yields
    return eye - J.T @ J, dynamic, eye - J.T @ np.linalg.pinv(J).T


def idempotence(N: Array) -> float:
    """Return |N N - N|/|N|."""
    return float(np.linalg.norm(N @ N - N, 2) / np.linalg.norm(N, 2))


def leak(state: RobotState, N: Array) -> float:
    """Return the tip acceleration left of that of an unprojected torque."""
    J, M = state.J_tip, state.M
    return float(np.linalg.norm(J @ np.linalg.solve(M, N), 2) / np.linalg.norm(J @ np.linalg.inv(M), 2))


def third_level(state: RobotState) -> tuple[Array, Array, Array]:
    """Return the consistent map (n, n), the printed one, which lacks a Z, (n, r), and Z (r, n)."""
    Z, M = np.asarray(null_space(state.A, rcond=1e-7).T), np.array(state.M)
    inner = Z @ M @ Z.T
    return M @ Z.T @ np.linalg.inv(inner) @ Z, (inner @ Z @ M).T, Z


def saddle(qp: NullSpaceQP, sign: float = 1.0) -> Array:
    """Return the Jacobian of F(Y) = [dL/dx, -dL/dlambda], (n + 6, n + 6); sign = -1 is F as printed."""
    return sign * np.block([[qp.P, qp.A.T], [-qp.A, np.zeros((6, 6))]])


def network(qp: NullSpaceQP, steps: int, sign: float, k: float = 0.5) -> tuple[Array, Array]:
    """Iterate Y <- Y - k F(Y), x clipped to the box (h = 1); x, and |A x - b|_inf over the last tenth of the steps."""
    x, y, slack = np.zeros(qp.n), np.zeros(6), []
    for _ in range(steps):
        F_x, F_y = qp.P @ x + qp.p + qp.A.T @ y, -(qp.A @ x - qp.b)
        x, y = np.clip(x - sign * k * F_x, qp.lower, qp.upper), y - sign * k * F_y
        slack.append(float(np.abs(F_y).max()))
    return x, np.array(slack[-steps // 10 :])


def rates(qp: NullSpaceQP) -> Array:
    """Return the decay rates [1/s] of dY/dt = -k F(Y) at the printed weights; free directions have none."""
    found = -np.linalg.eigvals(-K * saddle(qp)).real
    return np.sort(found[found > 1e-12])


def torque_of_mu(arm: Arm) -> float:
    """Return the largest share of mu in the torque of ``rnn-printed`` [Nm], at rest and slow: with c2 less without."""
    rng, printed, share = np.random.default_rng(0), solvers.create("rnn-printed"), 0.0
    for rest in arm.states:
        for v in (np.zeros(arm.robot.n), rng.uniform(-0.01, 0.01, arm.robot.n)):
            s = arm.robot.state(rest.q, v)
            torques = []
            for c2 in (PAPER.c2, 0.0):
                qp = arm.subproblem(s, c2=c2)
                session = printed.start(qp)
                assert isinstance(session, ObservingSession)
                session.observe(v)
                torques.append(third_level(s)[0] @ (K_N2 * (session.solve(qp).x - s.v)))
            share = max(share, float(np.abs(torques[0] - torques[1]).max()))
    return share


def true_lambdas(arm: Arm, off_m: float = 0.002) -> list[float]:
    """Return d / |N - N_d| at the depths of the virtual tasks, the trocar a little beside the shaft."""
    found = []
    for s in arm.states:
        across = np.cross(s.tool_direction, np.eye(3)[int(np.argmin(np.abs(s.tool_direction)))])
        across /= np.linalg.norm(across)
        for task in BOARD_TASKS.values():
            trocar = s.tip - task.depth_m * s.tool_direction + off_m * across
            desired, _ = desired_wrist(s.tip, np.zeros(3), trocar, np.zeros(3), s.tool_span)
            distance = float(shaft_distance(s.tip, s.wrist, trocar))
            found.append(distance / float(np.linalg.norm(s.wrist - desired)))
    return found


def gains_in_mu() -> dict[str, float]:
    """Return the change of mu in one second at rest in a plant that equals the model, from a poor swivel [percent]."""
    base = Scenario(
        duration_s=1.0, start={"swivel": 0.15}, plant={"preset": "nominal"}, judge=False, bound_samples=0,
        task={"wait_s": 2.0}, control={"preset": "paper"},
    )  # fmt: skip
    found = {}
    for name in ("exact", "rnn-printed"):
        trace = run(base.change(solver={"name": name}))
        found[name] = 100.0 * float(trace.mu[-1] / trace.mu[0] - 1.0)
    return found
