"""Optimize a course (the joint motion along a path) by direct transcription.

The variables q are the positions of the joints that move tip or wrist, at K evenly spaced times after a fixed start:

    max  mean of {mu / mu_0 - w (|ddq|^2 + |dq|^2 / T^2)} + V(q_K) / (K dt mu_0)
    s.t. X(q_k) = X_d,  B_k^T (N(q_k) - X_d) = 0,  q_min <= q_k <= q_max,  |q_k - q_k-1| <= v_max dt,
         and every joint can brake before its limit (`too_fast`)

mu is the manipulability, less a penalty on poses that can hardly turn the shaft (`lowered` in course.py). mu_0 is a
typical mu, w a weight, T = `SETTLED_S`, dt the time step, and V the largest integral of mu after q_K (search.py). X(q)
is the tip, X_d its target, and N(q) the wrist. The columns of B_k (3,2) are orthogonal to the desired shaft, so that N
lies on it. |X - N| is constant, so a third equation for N would make multipliers ambiguous.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from moc_opt.arrays import Array
from moc_opt.planning.course import WORTH, Course, Limits, Targets, make_course, shaft_shares, worth
from moc_opt.planning.search import End
from moc_opt.robots.model import RobotModel

# Settings of ipopt for a whole path. The first barrier parameter (ipopt.mu_init) is small. With a larger one, ipopt
# often moves far away from a guess that comes near a limit or has fast joint motions.
WHOLE: dict[str, Any] = {
    "print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.max_iter": 300, "ipopt.tol": 1e-8,
    "ipopt.constr_viol_tol": 1e-10, "ipopt.bound_relax_factor": 0.0, "ipopt.honor_original_bounds": "yes",
    "ipopt.mu_init": 1e-5, "ipopt.bound_push": 1e-6, "ipopt.bound_frac": 1e-6, "ipopt.slack_bound_push": 1e-6,
    "ipopt.slack_bound_frac": 1e-6, "ipopt.acceptable_iter": 0,
}  # fmt: skip
# Settings of CasADi's SQP for a receding horizon.
HORIZON: dict[str, Any] = {
    "print_time": False, "print_header": False, "print_iteration": False, "print_status": False, "error_on_fail": False,
    "max_iter": 3, "tol_pr": 1e-6, "tol_du": 1e-3, "convexify_strategy": "regularize", "qpsol": "osqp", "expand": True,
    "qpsol_options": {
        "error_on_fail": False,
        "osqp": {"verbose": False, "max_iter": 1000, "eps_abs": 1e-5, "eps_rel": 1e-5, "adaptive_rho_interval": 25},
    },
}  # fmt: skip
SETTLED_S = 0.3  #: Time T in the objective above.
SOFT_RAD = 0.003  #: e in `too_fast`; it keeps the derivative finite at the joint limit.
SMOOTH_LOSS = 0.05  #: Share of mean mu that smoothness and braking may cost.
LEAST_SHARE = 1e-4  #: Instead of s = `shaft_shares`, sqrt(s^2 + `LEAST_SHARE`^2) is used: it is smooth at s = 0.
INSIDE = 1e-9  #: Margin for rounding at the joint limits and the largest step [rad].


class Program:
    """The nonlinear program for one arm and K times."""

    def __init__(
        self, robot: RobotModel, nodes: int, period_s: float, limits: Limits, *, mu: float, top: float = 0.0,
        smoothness: float = 0.0, brake: float = np.inf, horizon: bool = False,
    ) -> None:  # fmt: skip
        """Write the program for K = ``nodes`` times after the start, ``period_s`` [s] apart.

        Args:
            mu: mu_0, which scales the objective [m^3].
            top: factor of the penalty that is subtracted from mu [m^3]: the largest mu of a course. If 0, mu_0 is used.
            smoothness: w [s^4/rad^2].
            brake: deceleration with which joints must be able to stop before their limits [rad/s^2]; inf: no such rule.
            horizon: use SQP instead of ipopt, and do not penalize the deceleration to rest after the last time.
        """
        import casadi as ca  # slow to import

        self._moving = moving = np.flatnonzero(robot.moves.any(axis=0))
        self.robot, self.nodes, self.limits, n, a = robot, nodes, limits, robot.n, len(moving)
        sym, kin = ca.MX.sym, robot.kinematics()
        x, start, speed_0, dt = sym("q", a, nodes), sym("q_0", n), sym("dq_0", n), sym("dt")
        tip, one, two = sym("tip", 3, nodes), sym("one", 3, nodes), sym("two", 3, nodes)
        end, along, slope, bend = sym("end", n), sym("along", n), sym("slope"), sym("bend")
        place = np.zeros((n, a))
        place[moving, np.arange(a)] = 1.0
        idle = start * ca.DM(1.0 - place.sum(axis=1))
        q = ca.mtimes(ca.DM(place), x) + ca.repmat(idle, 1, nodes)
        mus, lever = kin.mu.map(nodes)(q), kin.wrist.map(nodes)(q) - tip
        tasks = [kin.tip.map(nodes)(q) - tip, ca.sum1(one * lever), ca.sum1(two * lever)]
        first = start[moving.tolist()]
        steps = x - ca.horzcat(first, x[:, :-1])
        before = ca.horzcat(dt * speed_0[moving.tolist()], steps[:, :-1])
        keep = limits.margin + INSIDE
        low, high = ((limit + sign * keep)[moving] for limit, sign in ((robot.q_min, 1.0), (robot.q_max, -1.0)))
        self._low, self._high = np.tile(low, nodes), np.tile(high, nodes)
        self._speed = np.tile((limits.speed_share * robot.v_max)[moving], nodes)
        brakes = ca.MX(0, 1)
        if np.isfinite(brake):
            ends = ca.repmat(ca.DM(low), nodes), ca.repmat(ca.DM(high), nodes)
            brakes = dt * too_fast(ca.vec(steps) / dt, ca.vec(x), *ends, brake=brake)
        z = ca.dot(along, q[:, -1] - end)
        share = ca.sqrt(kin.shaft.map(nodes)(q) + LEAST_SHARE**2)
        price = WORTH * ca.fmax(1.0 - share / limits.shaft, 0.0) ** 2 if limits.shaft > 0.0 else ca.MX.zeros(1, nodes)
        worth = (mus - (top or mu) * price) / mu
        weight = np.ones(nodes)
        weight[-1] = 0.5
        cost = -ca.dot(ca.DM(weight), worth.T) / nodes - (slope * z + 0.5 * bend * z**2) / (mu * nodes * dt)
        rough = ca.sumsqr(steps - before) / dt**4 + ca.sumsqr(steps) / (dt * SETTLED_S) ** 2
        if not horizon:
            rough += ca.sumsqr(steps[:, -1]) / dt**4
        cost += smoothness / nodes * rough
        self._brakes = brakes.numel()
        given = ca.vertcat(start, speed_0, dt, ca.vec(tip), ca.vec(one), ca.vec(two), end, along, slope, bend)
        kept = ca.vertcat(*(ca.vec(task) for task in tasks), ca.vec(steps), z, brakes)
        problem = {"x": ca.vec(x), "p": given, "f": cost, "g": kept}
        method, options = ("sqpmethod", HORIZON) if horizon else ("ipopt", WHOLE)
        self._make: Callable[[], Any] = lambda: ca.nlpsol("course", method, problem, options)
        self.period_s = period_s
        self.forget()

    def forget(self) -> None:
        """Rebuild the solver, so that a second run is bitwise equal to the first."""
        self._solver = self._make()

    def solve(
        self, guess: Array, start: Array, targets: Targets, speed: Array | None = None, end: End | None = None,
        period_s: float | None = None,
    ) -> tuple[Array, bool]:  # fmt: skip
        """Return poses (K,n) [rad], which may be NaN, and whether the solver met its tolerances.

        The iteration begins at ``guess`` (K,n). The course leaves ``start`` (n,) at ``speed`` (n,) [rad/s]. ``end``
        describes V near the last pose. ``period_s`` replaces the program's period.
        """
        dt, n = self.period_s if period_s is None else period_s, len(start)
        speed = np.zeros(n) if speed is None else speed
        known = End(start, np.zeros(n), low=-np.inf, high=np.inf) if end is None else end
        one, two = np.moveaxis(across(targets.wrist - targets.tip), 1, 0)
        given = np.concatenate([
            start, speed, [dt], targets.tip.ravel(), one.ravel(), two.ravel(), known.q_rad, known.along,
            [known.slope, known.bend],
        ])  # fmt: skip
        most, equal = np.maximum(dt * self._speed - INSIDE, 0.5 * dt * self._speed), np.zeros(5 * self.nodes)
        answer = self._solver(
            x0=np.clip(guess[:, self._moving].ravel(), self._low, self._high), p=given, lbx=self._low, ubx=self._high,
            lbg=np.concatenate([equal, -most, [known.low], np.full(self._brakes, -np.inf)]),
            ubg=np.concatenate([equal, most, [known.high], np.zeros(self._brakes)]),
        )  # fmt: skip
        found = np.tile(start, (self.nodes, 1))
        found[:, self._moving] = np.array(answer["x"]).reshape(self.nodes, -1)
        return found, bool(self._solver.stats()["success"])


def refine(
    robot: RobotModel, targets: Targets, course: Course, limits: Limits, *, smoothness: float = 0.0,
    brake: float = np.inf,
) -> Course:  # fmt: skip
    """Improve a course over the whole path to a local optimum. The first pose stays the same.

    The given course is returned unchanged if the answer is infeasible or worse. Smoothness and braking may cost the
    share `SMOOTH_LOSS` of mean mu.
    """
    # The program is faster without the shaft margin, which the answer may keep anyway.
    if limits.shaft > 0.0 and _above(robot, course, limits):
        bare = replace(limits, shaft=0.0)
        free = refine(robot, targets, course, bare, smoothness=smoothness, brake=brake)
        if _above(robot, free, limits):
            return free
    top = float(course.mu.max())
    program = Program(
        robot, len(targets) - 1, targets.period_s, limits, mu=course.mu_mean, top=top, smoothness=smoothness,
        brake=brake,
    )  # fmt: skip
    poses, met = program.solve(course.q_rad[1:], course.q_rad[0], targets[1:])
    if not np.isfinite(poses).all():
        return course
    found = make_course(robot, targets, np.concatenate([course.q_rad[:1], poses]), limits)
    loss = SMOOTH_LOSS if smoothness > 0.0 or np.isfinite(brake) else 0.0
    gained = worth(robot, found, limits, top) - worth(robot, course, limits, top)
    if not found.kept or (course.kept and gained < -loss * course.mu_mean):
        return course
    return replace(found, certified=met)


def _above(robot: RobotModel, course: Course, limits: Limits) -> bool:
    return bool((shaft_shares(robot, course.q_rad) >= limits.shaft).all())


def too_fast(speed: Any, pose: Any, low: Any, high: Any, brake: float) -> Any:
    """Return each joint's excess over the speed from which it can stop before its limit.

    At a distance d from a limit, this speed is sqrt(2 brake) (sqrt(d + e) - sqrt(e)), where e is `SOFT_RAD`. The
    excesses of all joints towards ``high`` come first, then those towards ``low``.
    """
    import casadi as ca

    def most(room: Any) -> Any:
        return np.sqrt(2.0 * brake) * (ca.sqrt(ca.fmax(room, 0.0) + SOFT_RAD) - np.sqrt(SOFT_RAD))

    return ca.vertcat(speed - most(high - pose), -speed - most(pose - low))


def across(shafts: Array) -> Array:
    """Return two unit vectors (K,2,3) for each shaft (K,3), orthogonal to the shaft and to each other."""
    vectors: Array = np.linalg.svd(shafts[:, None])[2][:, 1:]
    return vectors
