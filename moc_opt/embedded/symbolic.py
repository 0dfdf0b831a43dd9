"""One control tick as CasADi expressions: the equations of `moc_opt.control`, written out for one arm.

Same levels, same signs, same order as `moc_opt.control.controller.Controller.tick`. Gains, limits and weights
become constants. The memory from tick to tick is an explicit input and output.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from moc_opt.control.feedforward import STRAIGHT
from moc_opt.control.null_space import box_limits
from moc_opt.control.tick import BOX_OPENS, SHAFT_LOST, SHAFT_PULL
from moc_opt.embedded import dynamics, swivel
from moc_opt.embedded.arm import Arm, without_dust
from moc_opt.embedded.layout import OBSERVED, Layout, layout
from moc_opt.embedded.support import TickSpec, check_supported
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.solvers.base import Solver
from moc_opt.solvers.exact.elimination import OK, STUCK
from moc_opt.solvers.exact.solver import Exact

SX = Any


@dataclass(frozen=True)
class Tick:
    """The two CasADi functions of one law on one arm."""

    n: int
    rows: int
    """of the null space that the third level acts in; 0: it does nothing"""
    layout: Layout
    start: Any
    """(q, v) -> state"""
    tick: Any
    """(inputs, observer's part of the state and last torque) -> (status, observer's part of the state, report)"""
    gravity: Any
    """q -> torque that carries the arm's weight (n,) [Nm]"""
    tool_pose: Any
    """q -> (4,3) the tool's axes x, y, z and its tip [m], as `RobotModel.tool_pose`"""


def build_tick(spec: TickSpec) -> Tick:
    """Write out the tick of `Controller(*spec)`.

    Raises:
        ControlError: the generated code cannot do what this setting asks for; the message names it.
    """
    check_supported(spec)
    robot, settings = spec.robot, spec.settings
    active = int(robot.moves.any(axis=0).sum())
    rows = robot.n - active + 1 if settings.law == "moc" or settings.damps_dcac else 0
    names = layout(robot.n, settings.law, rows)
    # of the state, the observer's memory, and the torque that acted since
    observed = names.state[: OBSERVED + 1]
    symbols = {field.name: ca.SX.sym(field.name, field.length) for field in (*names.inputs, *observed)}
    law = _Law(spec, symbols)
    begin = {"momentum": law.p, "torque": law.h}
    start = [begin.get(field.name, ca.SX.zeros(field.length)) for field in names.state]
    results = [law.results[field.name] for field in (*observed[:OBSERVED], *names.report)]
    q = symbols["q"]
    return Tick(
        n=robot.n,
        rows=rows,
        layout=names,
        start=_function("moc_start_equations", [q, symbols["v"]], start),
        tick=_function("moc_tick_equations", list(symbols.values()), [law.status, *results]),
        gravity=_function("moc_gravity_equations", [q], [law.gravity]),
        tool_pose=_function("moc_tool_pose_equations", [q], [_tool_pose(robot, law.at)]),
    )


class _Law:
    """The expressions, level by level; `s` holds the symbols and `results` the values, both by field name."""

    def __init__(self, spec: TickSpec, s: dict[str, SX]) -> None:
        robot, settings, solver, period = spec
        self.robot, self.settings, self.s = robot, settings, s
        self.gains = settings.resolve_gains(robot.data.gains, robot.n)
        self.arm = arm = Arm.of(robot)
        self.span = float(np.linalg.norm(arm.offsets[0] - arm.offsets[1]))
        frames = dynamics.joint_frames(arm, s["q"])
        self.at = dynamics.points(arm, frames)
        self.mu, self.grad_mu = dynamics.manipulability(self.at)
        self.h = dynamics.bias_torque(arm, frames, s["v"])
        self.M, self.gravity = dynamics.inertia_and_gravity(arm, frames)
        self.p, energy_slope = dynamics.momentum(arm, frames, s["v"])
        self.status: SX = ca.SX(OK)
        self.results = {
            **s, "mu": self.mu, "grad_mu": self.grad_mu, "tip": self.at.tip, "wrist": self.at.wrist,
            "M": ca.vec(self.M), "h": self.h, "energy_slope": energy_slope, "gravity": self.gravity,
        }  # fmt: skip

        self.results["levels"] = self._tip_and_rcm()
        if settings.law == "moc" or settings.damps_dcac:
            self._third_level(solver)
        if settings.observer_gain_per_s:
            known = s["torque"] + energy_slope - self.gravity
            integral = s["momentum"] + (known + s["external_torque"]) * period
            residual = settings.observer_gain_per_s * (self.p - integral)
            self.results |= {"momentum": integral, "external_torque": residual}

    def _shaft_turn(self, tip_velocity: SX) -> tuple[SX, SX, SX, SX]:
        """Compute |P_t - X|, e, its closing speed and de/dt, see `moc_opt.model.shaft_kernels.shaft_turn`."""
        to_trocar = self.s["trocar"][:3] - self.at.tip
        distance = ca.norm_2(to_trocar)
        e = to_trocar / distance
        slip = self.s["trocar"][3:] - tip_velocity
        closing = ca.dot(e, slip)
        return distance, e, closing, (slip - closing * e) / distance

    def _desired_wrist(self, tip_velocity: SX) -> tuple[SX, SX]:
        """Compute N_d = X + L e and its velocity, see `moc_opt.model.shaft_kernels.desired_wrist`."""
        _, e, _, turn = self._shaft_turn(tip_velocity)
        return self.at.tip + self.span * e, tip_velocity + self.span * turn

    def _tip_and_rcm(self) -> SX:
        """Compute levels 1 and 2, see `moc_opt.control.tick.tracking_torque`."""
        J_tip, J_wrist, v, gains = self.at.J_tip, self.at.J_wrist, self.s["v"], self.gains
        X_d, dX_d, ddX_d = (self.s["tip_ref"][i : i + 3] for i in (0, 3, 6))
        dX, dN = J_tip @ v, J_wrist @ v
        factor = ca.chol(self.M).T
        Y = ca.solve(factor, J_tip.T)  # J M^-1 J^T = Y^T Y, M^-1 J^T = factor^-T Y
        mobility = ca.chol(Y.T @ Y)

        force = gains.K_X * (X_d - self.at.tip) + gains.D_X * (dX_d - dX)
        N_d, dN_d = self._desired_wrist(dX)
        if self.settings.rcm_lambda is not None:
            distance, e, *_ = self._shaft_turn(dX)
            along = ca.dot(e, self.at.wrist - self.at.tip) / self.span
            true_lambda = distance / self.span * ca.sqrt(ca.fmax(0, 0.5 * (1 + along)))
            N_d = self.at.wrist + true_lambda / self.settings.rcm_lambda * (N_d - self.at.wrist)
        tau_wrist = J_wrist.T @ (gains.K_N * (N_d - self.at.wrist) + gains.D_N * (dN_d - dN))
        if self.settings.projector == "dynamic":
            at_tip = _solve_factored(mobility, Y.T @ ca.solve(factor, tau_wrist))
        elif self.settings.projector == "static":
            at_tip = _solve_factored(ca.chol(J_tip @ J_tip.T), J_tip @ tau_wrist)
        else:
            at_tip = J_tip @ tau_wrist
        tau = self.h + tau_wrist + J_tip.T @ (force - at_tip)
        return tau + self._feedforward(factor, dX, ddX_d) if self.settings.feedforward else tau

    def _feedforward(self, factor: SX, dX: SX, ddX_d: SX) -> SX:
        """Compute the accelerations of tip and desired wrist, see `moc_opt.control.feedforward`."""
        at, v = self.at, self.s["v"]
        distance, e, closing, turn = self._shaft_turn(dX)
        pull = -ddX_d - 2 * closing * turn
        ddN_d = ddX_d + self.span * ((pull - ca.dot(e, pull) * e) / distance - ca.dot(turn, turn) * e)
        across = ca.vertcat(*((at.R @ ca.SX(b)).T for b in _across(self.arm.offsets[0] - self.arm.offsets[1])))
        A5 = ca.vertcat(at.J_tip, across @ at.J_wrist)
        tip, wrist = ddX_d - dynamics.drift(at, at.J_tip, v), ddN_d - dynamics.drift(at, at.J_wrist, v)
        desired = ca.vertcat(tip, across @ wrist)
        return factor @ _orthogonal_effort(ca.solve(factor, A5.T), desired)

    def _third_level(self, solver: Solver | None) -> None:
        """Compute the null space and, under MOC, the solver's answer; the torque that follows it is `moc_level3.c`.

        Z is z beside the unit vectors of the idle joints. Any basis of the null space gives the same torque, so that
        none is carried from tick to tick.
        """
        n = self.robot.n
        active = np.flatnonzero(self.arm.moves.any(axis=0)).tolist()
        across = [self.at.R @ ca.SX(b) for b in _across(self.arm.offsets[0] - self.arm.offsets[1])]
        turning = ca.vertcat(*(b.T @ self.at.axes for b in across))
        triangle = swivel.triangulate(ca.vertcat(self.at.J_wrist, turning)[:, active])
        z = swivel.null_vector(triangle)
        Z = ca.SX.zeros(n - len(active) + 1, n)
        Z[0, active] = z.T
        for i, j in enumerate(sorted(set(range(n)) - set(active))):
            Z[i + 1, j] = 1
        self.results["null_space"] = ca.vec(Z.T)
        if isinstance(solver, Exact):
            self._subproblem(solver.tolerance, triangle, z, active, *across)
        else:
            self.status = ca.if_else(triangle.regular, ca.SX(OK), ca.SX(STUCK))
            self.results["A"] = ca.vec(ca.vertcat(self.at.J_tip, self.at.J_wrist).T)

    def _subproblem(
        self, tolerance: float, triangle: swivel.Triangle, z: SX, active: list[int], b1: SX, b2: SX
    ) -> None:
        """Build this tick's subproblem, see `moc_opt.control.tick.fill_subproblem`, and answer it."""
        robot, settings, q = self.robot, self.settings, self.s["q"]
        v_tip = self.s["tip_ref"][3:6]
        _, desired = self._desired_wrist(v_tip)
        gap = v_tip - desired
        v_wrist = v_tip - ca.dot(b1, gap) * b1 - ca.dot(b2, gap) * b2  # a rigid tool keeps its length
        # b1, b2, u are right-handed: b1 . omega = -b2 . (v_T - v_W)/L and b2 . omega = b1 . (v_T - v_W)/L.
        rates = ca.vertcat(-ca.dot(b2, gap), ca.dot(b1, gap)) / self.span
        k0 = settings.k0_per_s
        q_min, q_max, v_max = box_limits(
            robot.q_min, robot.q_max, robot.v_max,
            margin=settings.limit_margins(robot.chain.prismatic), speed_fraction=settings.speed_fraction,
        )  # fmt: skip
        gradient, margin = self.grad_mu, settings.shaft_margin * self.span**2
        if margin > 0.0:
            mu_shaft, slope = dynamics.shaft_manipulability(self.at)
            left, lost = ca.fmax(1 - mu_shaft / margin, 0), SHAFT_LOST * margin
            gradient = gradient + SHAFT_PULL * left * mu_shaft / (mu_shaft**2 + lost**2) * slope  # tick.shaft_push
            v_max = v_max * (1 + (1 / settings.speed_fraction - 1) * ca.fmin(1, BOX_OPENS * left))
        box = swivel.Box(
            ca.fmin(ca.fmax(-v_max, -k0 * (q - q_min)), v_max), ca.fmax(ca.fmin(v_max, -k0 * (q - q_max)), -v_max)
        )
        answer = swivel.solve(
            triangle, z, ca.vertcat(v_wrist, rates), gradient, box, active,
            c2=settings.c2, rho=settings.regularization, tolerance=tolerance,
        )  # fmt: skip
        self.status = answer.status
        on_tip = (answer.dual[4] * b1 - answer.dual[3] * b2) / self.span
        weights = [settings.c0, settings.c1, settings.c2, settings.regularization]
        A = ca.vertcat(self.at.J_tip, self.at.J_wrist)
        self.results |= {
            "x": answer.x,
            "dual": ca.vertcat(on_tip, answer.dual[:3] - on_tip),
            "subproblem": ca.vertcat(ca.vec(A.T), v_tip, v_wrist, gradient, *box, *weights, q),
        }  # fmt: skip


def _tool_pose(robot: RobotModel, at: dynamics.Points) -> SX:
    """Compute (12,) rows x, y, z, tip; see `moc_opt.model.kinematics_kernels.tool_pose`."""
    return ca.vertcat(*(at.R @ ca.SX(axis) for axis in without_dust(robot.mount)), at.tip)


def _orthogonal_effort(Y: SX, desired: SX) -> SX:
    """Compute the shortest y, Y^T y = desired, for Y (n,5); the wrist's harder direction as `control.feedforward`."""
    columns: list[SX] = ca.horzsplit(Y)
    entries: list[SX] = ca.vertsplit(desired)
    effort: SX = ca.SX.zeros(Y.shape[0])
    tip: list[tuple[SX, SX]] = []
    for i in range(5):
        for unit, share in tip:
            along = ca.dot(unit, columns[i])
            entries[i] = entries[i] - along * share
            columns[i] = columns[i] - along * unit
        if i < 3:
            length = ca.norm_2(columns[i])
            tip.append((columns[i] / length, entries[i] / length))
            effort = effort + tip[i][1] * tip[i][0]
    one, other = columns[3:]
    product, gap = ca.dot(one, other), ca.dot(one, one) - ca.dot(other, other)
    size = ca.fabs(gap) + ca.sqrt(gap * gap + 4 * product * product)
    tangent = ca.if_else(gap >= 0, 2, -2) * product / ca.if_else(size > 0, size, 1)
    turned = (
        (one + tangent * other, entries[3] + tangent * entries[4]),
        (other - tangent * one, entries[4] - tangent * entries[3]),
    )
    mobilities = [ca.dot(row, row) for row, _ in turned]
    for (row, share), mobility in zip(turned, mobilities, strict=True):
        moves = mobility > STRAIGHT**2 * ca.fmax(*mobilities)
        effort = effort + ca.if_else(moves, share / ca.if_else(moves, mobility, 1), 0) * row
    return effort


def _across(direction: Array) -> tuple[Array, Array]:
    """Return the unit vectors b1, b2 that make (b1, b2, direction) right-handed."""
    u = direction / np.linalg.norm(direction)
    b1 = np.cross(np.eye(3)[(int(np.argmax(np.abs(u))) + 2) % 3], u)
    b1 /= np.linalg.norm(b1)
    return b1, np.cross(u, b1)


def _solve_factored(upper: SX, b: SX) -> SX:
    """Compute S^-1 b for S = upper^T upper."""
    return ca.solve(upper, ca.solve(upper.T, b))


def _function(name: str, given: list[SX], outputs: list[SX]) -> Any:
    return ca.Function(name, given, [ca.densify(value) for value in outputs], {"cse": True})
