"""The computations behind docs/errata.md: printed and consistent forms, on the same arm in the same poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
from moc_opt.model.robot_model import RobotModel, RobotState, load_robot
from moc_opt.model.shaft_kernels import desired_wrist
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.dense import cholesky
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.scenario import Scenario, run
from moc_opt.tasks.trocar import shaft_distance
from moc_opt.vision.board import BOARD_TASKS

POSES = 50
PAPER = ControlSettings.paper()
K = 0.1  # gain of the network, as printed
K_N2 = np.array([80.0, 120.0, 60.0, 30.0, 20.0, 10.0, 10.0])
"""(7,) Table I [N m s/rad]"""


@dataclass(frozen=True)
class Arm:
    """The arm at rest in the poses that the numbers are taken over."""

    robot: RobotModel
    states: tuple[RobotState, ...]

    @classmethod
    def load(cls, poses: int = POSES, seed: int = 0) -> Arm:
        """Return the LWR4+ in seeded regular poses."""
        robot, rng = load_robot(), np.random.default_rng(seed)
        return cls(robot, tuple(robot.state(robot.random_regular_pose(rng)) for _ in range(poses)))

    def subproblem(
        self, state: RobotState, c2: float = PAPER.c2, rho: float = PAPER.regularization, weight: float = 1.0,
        speed: float = 0.0,
    ) -> NullSpaceQP:  # fmt: skip
        """Make the paper's subproblem at a state; ``weight`` scales c0, c1, c2 and rho; tip speed [m/s] along x."""
        robot, lower, upper = self.robot, np.empty(self.robot.n), np.empty(self.robot.n)
        velocity_damper(state.q, np.array([robot.q_min, robot.q_max, robot.v_max]), PAPER.k0_per_s, lower, upper)
        v_tip = np.array([speed, 0.0, 0.0])
        v_wrist = consistent_wrist_velocity(v_tip, v_tip, state.tool_direction)
        return NullSpaceQP(
            state.J_tip, state.J_wrist, v_tip, v_wrist, state.grad_mu, lower=lower, upper=upper,
            c0=PAPER.c0 * weight, c1=PAPER.c1 * weight, c2=c2 * weight, regularization=rho * weight,
        )  # fmt: skip


def projectors(state: RobotState) -> tuple[Array, Array, Array]:
    """Return the printed, the dynamic and the static projector (n, n) of level 2."""
    J, eye = np.array(state.J_tip), np.eye(len(state.q))
    W, factor = task_inertia(J, cholesky(np.array(state.M)))
    printed = np.array([rcm.project_as_published(J, e) for e in eye]).T
    dynamic = np.array([rcm.project_dynamic(J, W, factor, e) for e in eye]).T
    static = np.array([rcm.project_static(J, e) for e in eye]).T
    return printed, dynamic, static


def saddle(qp: NullSpaceQP, sign: float = 1.0) -> Array:
    """Return the Jacobian of F(Y) = [dL/dx, -dL/dlambda], (n + 6, n + 6); sign = -1 is F as printed."""
    return sign * np.block([[qp.P, qp.A.T], [-qp.A, np.zeros((6, 6))]])


def idempotence(N: Array) -> float:
    """Return |N N - N|/|N|."""
    return float(np.linalg.norm(N @ N - N, 2) / np.linalg.norm(N, 2))


def third_level(state: RobotState) -> tuple[Array, Array, Array]:
    """Return the consistent map (n, n), the printed one with the missing Z appended (n, n), and Z M Z^T (r, r)."""
    Z, M = null_space(state.A), np.array(state.M)
    consistent = np.array([self_motion_torque(M, Z, e) for e in np.eye(len(state.q))]).T
    inner = Z @ M @ Z.T
    return consistent, (inner @ Z @ M).T @ Z, inner


def network(qp: NullSpaceQP, steps: int, sign: float, k: float = 0.5) -> Array:
    """Iterate Y <- Y - k F(Y), x clipped to the box (h = 1); |A x - b|_inf over the last tenth of the steps."""
    x, y, slack = np.zeros(qp.n), np.zeros(6), []
    for _ in range(steps):
        F_x, F_y = qp.P @ x + qp.p + qp.A.T @ y, -(qp.A @ x - qp.b)
        x, y = np.clip(x - sign * k * F_x, qp.lower, qp.upper), y - sign * k * F_y
        slack.append(float(np.abs(F_y).max()))
    return np.array(slack[-steps // 10 :])


def time_constants(arm: Arm) -> tuple[float, float]:
    """Return (fastest, slowest) mode of dY/dt = -k F(Y) at the printed weights [s]; free directions have none."""
    fastest, slowest = np.inf, 0.0
    for s in arm.states:
        rates = -np.linalg.eigvals(-K * saddle(arm.subproblem(s))).real
        moving = rates[rates > 1e-12]
        fastest, slowest = min(fastest, 1.0 / moving.max()), max(slowest, 1.0 / moving.min())
    return float(fastest), float(slowest)


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
                session.observe(v)  # type: ignore[attr-defined]
                x = session.solve(qp).x
                torques.append(tick.third_level(s.record, packed(arm.robot.n, K_N2=K_N2), null_space(s.A), x, 1.0))
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
