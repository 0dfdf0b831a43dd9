"""A short stretch of a course as a nonlinear program, made once and solved again and again from where the arm is.

The equations of `refine` at N evenly spaced times after the pose that was measured, which stays as it is:

    max  int mu / mu_0 - w (|ddq|^2 + |dq|^2 / T^2) dt + V(q_N) / mu_0
    s.t. X(q_k) = X_d,  B_k^T (N(q_k) - X_d) = 0,  q_min <= q_k <= q_max,  |q_k - q_k-1| <= v_max dt,
         and no joint is `refine.too_fast`

With a margin from losing the shaft one inequality more a time: the pose's share (`shaft`), linear about the guess, is
at least the margin, or that of a guess between `LEFT` and all of it; below that there is no inequality. V is what the
pose at the end is worth for the rest of the path, as a parabola (`to_go`). Sequential quadratic programs (OSQP) solve
it, begun at a course that is near; the answer is judged by the caller.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.planning.pose_map import Margin
from moc_opt.planning.refine import SETTLED_S, across_shafts, too_fast
from moc_opt.planning.targets import Targets
from moc_opt.planning.to_go import End

# Three steps: the next solve, begun at this answer, goes on where it ends.
OPTIONS: dict[str, Any] = {
    "print_time": False, "print_header": False, "print_iteration": False, "print_status": False, "error_on_fail": False,
    "max_iter": 3, "tol_pr": 1e-6, "tol_du": 1e-3, "convexify_strategy": "regularize", "qpsol": "osqp",
    "qpsol_options": {
        "error_on_fail": False,
        "osqp": {"verbose": False, "max_iter": 1000, "eps_abs": 1e-5, "eps_rel": 1e-5, "adaptive_rho_interval": 25},
    },
}  # fmt: skip
LEFT = 0.95
"""Of the shaft's margin: where a guess is below it, the program has no inequality, and V alone keeps it away."""


class Horizon:
    """The program for one arm; ``solve`` fills in times, targets, start and end."""

    def __init__(
        self, robot: RobotModel, nodes: int, *, mu: float, margin: Margin, speed: Array, smoothness: float,
        brake: float = np.inf, shaft_margin: float = 0.0,
    ) -> None:
        """Write the program.

        Args:
            nodes: N, times after the start.
            mu: mu_0, what a pose is usually worth [m^3].
            margin: from the joint limits.
            speed: (n,) most of each joint [rad/s].
            smoothness: w [s^4/rad^2], as of `refine`.
            brake: as of `refine` [rad/s^2].
            shaft_margin: as of `shaft.keeping_shaft`.
        """
        import casadi as ca  # late: half a second

        self._moving = moving = np.flatnonzero(robot.moves.any(axis=0))
        n, a = robot.n, len(moving)
        place = np.zeros((n, a))
        place[moving, np.arange(a)] = 1.0
        sym, kin = ca.SX.sym, robot.kinematics()
        x, start, speed_0, dt = sym("q", a, nodes), sym("q_0", n), sym("dq_0", n), sym("dt")
        tip, one, two = sym("tip", 3, nodes), sym("one", 3, nodes), sym("two", 3, nodes)
        end, along, slope, bend = sym("end", n), sym("along", n), sym("slope"), sym("bend")
        turns = sym("turns", n, nodes if shaft_margin > 0.0 else 0)
        idle = start * ca.DM(1.0 - place.sum(axis=1))
        low, high = robot.q_min + margin, robot.q_max - margin
        gain, tasks, steps, brakes, shafts, before, moved = ca.SX(0.0), [], [], [], [], start, speed_0
        for k in range(nodes):
            q = ca.DM(place) @ x[:, k] + idle
            lever = kin.wrist(q) - tip[:, k]
            tasks += [kin.tip(q) - tip[:, k], ca.dot(one[:, k], lever), ca.dot(two[:, k], lever)]
            velocity = (q - before) / dt
            rough = ca.sumsqr((velocity - moved) / dt) + ca.sumsqr(velocity) / SETTLED_S**2
            gain += dt * ((0.5 if k == nodes - 1 else 1.0) * kin.mu(q) / mu - smoothness * rough)
            steps.append((q - before)[moving.tolist()])
            if np.isfinite(brake):
                v, at, ends = velocity[moving.tolist()], q[moving.tolist()], (ca.DM(low[moving]), ca.DM(high[moving]))
                brakes.append(dt * too_fast(v, at, *ends, brake=brake))
            if shaft_margin > 0.0:
                shafts.append(ca.dot(turns[:, k], q))
            before, moved = q, velocity
        z = ca.dot(along, before - end)
        gain += (slope * z + 0.5 * bend * z**2) / mu
        given = ca.vertcat(
            start, speed_0, dt, ca.vec(tip), ca.vec(one), ca.vec(two), end, along, slope, bend, ca.vec(turns)
        )
        kept = ca.vertcat(*tasks, *steps, z, *brakes, *shafts)
        problem: dict[str, Any] = {"x": ca.vec(x), "p": given, "f": -gain, "g": kept}
        self._make: Callable[[], Any] = lambda: ca.nlpsol("horizon", "sqpmethod", problem, OPTIONS)
        self.forget()
        self._low, self._high = (
            np.tile(limit[moving], nodes) for limit in (low, high)
        )
        self._brakes = np.zeros(ca.vertcat(*brakes).numel())
        self._step, self._equal = np.tile(speed[moving], nodes), np.zeros(5 * nodes)
        self.nodes, self.speed, self.margin = nodes, speed, margin
        self._robot, self._shaft_margin = robot, shaft_margin

    def forget(self) -> None:
        """Make the solver anew: its workspace goes from call to call, and a run is to be repeated to the last bit."""
        self._solver = self._make()

    def solve(self, guess: Array, start: Array, speed: Array, targets: Targets, end: End) -> Array:
        """Solve it.

        Args:
            guess: (N,n) to begin with [rad].
            start: (n,) the pose before the first time [rad].
            speed: (n,) the joints' velocity there [rad/s].
            targets: of the N times; their spacing is that from the start to the first.
            end: what the last pose is worth.

        Returns:
            (N,n) [rad], not judged; NaN where no quadratic program could be solved.
        """
        dt = targets.period_s
        one, two = across_shafts(targets.wrist - targets.tip)
        turns, least = self._shafts(guess)
        given = np.concatenate([
            start, speed, [dt], targets.tip.ravel(), one.ravel(), two.ravel(), end.q_rad, end.along,
            [end.slope, end.bend], turns.ravel(),
        ])  # fmt: skip
        step = dt * self._step
        answer = self._solver(
            x0=np.clip(guess[:, self._moving].ravel(), self._low, self._high), p=given, lbx=self._low, ubx=self._high,
            lbg=np.concatenate([self._equal, -step, [end.low], self._brakes - np.inf, least]),
            ubg=np.concatenate([self._equal, step, [end.high], self._brakes, np.full(len(least), np.inf)]),
        )  # fmt: skip
        found = np.tile(start, (self.nodes, 1))
        found[:, self._moving] = np.array(answer["x"]).reshape(self.nodes, -1)
        return found

    def _shafts(self, guess: Array) -> tuple[Array, Array]:
        """Return slopes (N,n) of the shaft's share at the guess, and the least (N,) of slope . q; none if no margin."""
        if self._shaft_margin <= 0.0:
            return np.empty((0, self._robot.n)), np.empty(0)
        states = [self._robot.state(q) for q in guess]
        shares = np.array([state.mu_shaft / state.tool_span**2 for state in states])
        turns = np.array([state.grad_mu_shaft / state.tool_span**2 for state in states])
        least = (turns * guess).sum(axis=1) + np.minimum(self._shaft_margin - shares, 0.0)
        return turns, np.where(shares < LEFT * self._shaft_margin, -np.inf, least)
