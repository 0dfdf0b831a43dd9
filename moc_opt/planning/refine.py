"""The whole horizon as one sparse nonlinear program (direct transcription), begun at the course that the search found.

Variables are the joints that move, at every time; each time keeps five equations (the tip at its point, the wrist on
the shaft's line) and the joint limits, each pair of times the joint speeds:

    max  f(q_0, ..., q_k)
    s.t. X(q_k) = X_d,  B_k^T (N(q_k) - X_d) = 0,  q_min <= q_k <= q_max,  |q_k - q_k-1| <= v_max dt

B_k (3,2) is orthogonal to the shaft. Five equations, since tip and wrist are rigidly tied: with six no multiplier is
unique. f is the mean of mu, the mean of log mu, or s with mu(q_k) >= s. With a margin from losing the shaft mu is
lowered below it as on the map (`shaft`).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.planning.course import Course, Objective, make_course, weights
from moc_opt.planning.pose_map import Margin
from moc_opt.planning.shaft import WORTH, lowered, shaft_shares
from moc_opt.planning.targets import Targets

# mu_init is ipopt's first barrier: with 1e-3 it leaves a course that is fast or close to a limit, often for a slow one
# at another local maximum of mu.
OPTIONS: dict[str, Any] = {
    "print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.max_iter": 300, "ipopt.tol": 1e-8,
    "ipopt.constr_viol_tol": 1e-10, "ipopt.bound_relax_factor": 0.0, "ipopt.honor_original_bounds": "yes",
    "ipopt.mu_init": 1e-5, "ipopt.bound_push": 1e-6, "ipopt.bound_frac": 1e-6, "ipopt.slack_bound_push": 1e-6,
    "ipopt.slack_bound_frac": 1e-6, "ipopt.acceptable_iter": 0,
}  # fmt: skip
SETTLED_S = 0.3
"""A joint's speed counts as much as an acceleration that takes it away in this time."""
SOFT_RAD = 0.003
"""Rounds the speed of a joint that brakes off at its end, where a square root has no slope."""
SMOOTH_LOSS = 0.05
"""Share of the objective that a smoother course, or one that brakes, may cost; where it costs more, the program went to
another local maximum."""
MEAN_TOO = 1e-3
"""Weight of the mean of mu, in shares of itself, beside the worst mu."""
LEAST_SHARE = 1e-4
"""Rounds the share of the squared lever off at zero, where a square root has no slope."""
INSIDE = 1e-9
"""Limits and speeds are kept this far inside, so that rounding stays within them [rad]; half of a step at most is taken
off."""


def refine(
    robot: RobotModel,
    targets: Targets,
    course: Course,
    objective: Objective = "mean",
    *,
    free_start: bool = False,
    margin: Margin = 0.0,
    speed_share: float = 1.0,
    smoothness: float = 0.0,
    acceleration: float = np.inf,
    brake: float = np.inf,
    shaft_margin: float = 0.0,
) -> Course:
    """Improve a course to a local optimum.

    Args:
        course: that is to be improved, all times; it may break constraints.
        objective: as for the search.
        free_start: whether the first pose may change, too.
        margin: from the joint limits.
        speed_share: of the joints' speed limits.
        smoothness: w [s^4/rad^2]; w (|ddq|^2 + |dq|^2 / `SETTLED_S`^2), its mean over the time, is taken off the
            objective (in shares of the mean mu; log: of itself), from rest to rest. The answer is taken if the
            objective proper falls by no more than `SMOOTH_LOSS` of the given course's.
        acceleration: most of any joint, from rest [rad/s^2].
        brake: b of `too_fast` [rad/s^2]; the answer may cost as much as a smoother one.
        shaft_margin: as of `shaft.keeping_shaft`; mu is lowered by it in the objective, and in judging the answer.

    Returns:
        The better of both courses by the robot model's own mu; one that breaks a constraint by more than
        `MOST_VIOLATION` only where it is the given one, and nothing better was found. ``certified`` where ipopt met
        its tolerances at the course that is returned.
    """
    improve = partial(
        _improved, robot, targets, course, objective, free_start=free_start, margin=margin, speed_share=speed_share,
        smoothness=smoothness, acceleration=acceleration, brake=brake,
    )  # fmt: skip

    def above(one: Course) -> bool:
        return bool((shaft_shares(robot, one.q_rad) >= shaft_margin).all())

    # Without the margin a program takes half of the time, and most courses keep it by themselves.
    if shaft_margin == 0.0 or above(course):
        free = improve()
        if shaft_margin == 0.0 or above(free):
            return free
    return improve(shaft_margin=shaft_margin)


def _improved(
    robot: RobotModel,
    targets: Targets,
    course: Course,
    objective: Objective,
    *,
    free_start: bool,
    margin: Margin,
    speed_share: float,
    smoothness: float,
    acceleration: float,
    brake: float,
    shaft_margin: float = 0.0,
) -> Course:
    """Solve the program once; arguments and answer as of `refine`."""
    import casadi as ca  # late: half a second

    moving = np.flatnonzero(robot.moves.any(axis=0))
    k, a = len(course.q_rad), len(moving)
    x = ca.MX.sym("q", a, k)
    place, rest = np.zeros((robot.n, a)), np.array(course.q_rad[0])
    place[moving, np.arange(a)] = 1.0
    rest[moving] = 0.0
    q = ca.mtimes(ca.DM(place), x) + ca.repmat(ca.DM(rest), 1, k)
    kin = robot.kinematics()
    tip, wrist, mu = (each.map(k)(q) for each in (kin.tip, kin.wrist, kin.mu))
    # A start that is given keeps its own equations already.
    there = slice(None) if free_start else slice(1, None)
    wanted = ca.DM(targets.tip[there].T)
    across = across_shafts((targets.wrist - targets.tip)[there])
    rows: list[tuple[Any, Any, Any]] = [(ca.vec(tip[:, there] - wanted), 0.0, 0.0)]
    rows += [(ca.sum1(ca.DM(side.T) * (wrist[:, there] - wanted)).T, 0.0, 0.0) for side in across]
    step = (speed_share * robot.v_max * targets.period_s)[moving]
    most = np.tile(np.maximum(step - INSIDE, 0.5 * step), k - 1)
    rows.append((ca.vec(x[:, 1:] - x[:, :-1]), -most, most))
    if np.isfinite(acceleration):
        rest_on = ca.horzcat(x[:, 0], x)
        gained = rest_on[:, 2:] - 2.0 * rest_on[:, 1:-1] + rest_on[:, :-2]
        gain = acceleration * targets.period_s**2
        most_gained = np.full(a * (k - 1), max(gain - INSIDE, 0.5 * gain))
        rows.append((ca.vec(gained), -most_gained, most_gained))
    keep = margin + INSIDE
    low, high = (np.tile(limit[moving], k) for limit in (robot.q_min + keep, robot.q_max - keep))
    if np.isfinite(brake):
        later, way = ca.vec(x[:, 1:]), ca.vec(x[:, 1:] - x[:, :-1])
        excess = too_fast(way / targets.period_s, later, ca.DM(low[a:]), ca.DM(high[a:]), brake)
        rows.append((targets.period_s * excess, -np.inf, 0.0))
    begin = np.array(course.q_rad[:, moving]).ravel()
    if not free_start:
        low[:a] = high[:a] = course.q_rad[0, moving]
    weight, variables = weights(k) / weights(k).sum(), ca.vec(x)
    scale, top = float(np.mean(course.mu)), float(course.mu.max())
    price = ca.MX.zeros(1, k)
    if shaft_margin > 0.0:
        share = ca.sqrt(kin.shaft.map(k)(q) + LEAST_SHARE**2)
        price = WORTH * ca.fmax(1.0 - share / shaft_margin, 0.0) ** 2
    worth = ca.log(mu) - price if objective == "log" else (mu - top * price) / scale
    if objective == "worst":
        least = ca.MX.sym("s")
        variables, begin = ca.vertcat(variables, least), np.append(begin, course.mu.min() / scale)
        low, high = np.append(low, -np.inf), np.append(high, np.inf)
        rows.append((worth.T - least, 0.0, np.inf))
        # Once the least mu cannot be raised, its mean decides: a fixed start may be the worst pose of all.
        cost = -least - MEAN_TOO * ca.dot(ca.DM(weight), worth.T)
    else:
        cost = -ca.dot(ca.DM(weight), worth.T)
    if smoothness > 0.0:
        still = ca.horzcat(x[:, 0], x, x[:, -1])
        speed = (still[:, 1:] - still[:, :-1]) / targets.period_s
        faster = (speed[:, 1:] - speed[:, :-1]) / targets.period_s
        cost += smoothness / k * (ca.sumsqr(faster) + ca.sumsqr(speed) / SETTLED_S**2)
    bounds = [(np.broadcast_to(lo, g.numel()), np.broadcast_to(hi, g.numel())) for g, lo, hi in rows]
    problem = {"x": variables, "f": cost, "g": ca.vertcat(*(g for g, _, _ in rows))}
    solver = ca.nlpsol("course", "ipopt", problem, OPTIONS)
    answer = solver(
        x0=begin, lbx=low, ubx=high, lbg=np.concatenate([lo for lo, _ in bounds]),
        ubg=np.concatenate([hi for _, hi in bounds]),
    )  # fmt: skip
    poses = np.array(course.q_rad)
    poses[:, moving] = np.array(answer["x"]).ravel()[: k * a].reshape(k, a)
    if not np.isfinite(poses).all():
        return course
    found = make_course(robot, targets, poses, margin, speed_share, acceleration)
    before, after = (lowered(each, robot, shaft_margin, top, objective) for each in (course, found))
    loss = SMOOTH_LOSS if smoothness > 0.0 or np.isfinite(brake) else 0.0
    judged: tuple[Objective, ...] = (objective, "mean") if loss and objective == "worst" else (objective,)
    lost = any(after.value(what) < before.value(what) - loss * abs(course.value(what)) for what in judged)
    if not found.kept or (course.kept and lost):
        return course
    return found.as_certified() if solver.stats()["success"] else found


def too_fast(speed: Any, pose: Any, low: Any, high: Any, brake: float) -> Any:
    """Write how much too fast joints go towards their limits to stop there (2 m), not above 0 where they can.

    At a distance d the most is sqrt(2 b) (sqrt(d + e) - sqrt(e)), e = `SOFT_RAD`.

    Args:
        speed, pose, low, high: (m,) CasADi vectors [rad/s], [rad].
        brake: b [rad/s^2].
    """
    import casadi as ca  # late: half a second

    def most(room: Any) -> Any:
        return np.sqrt(2.0 * brake) * (ca.sqrt(ca.fmax(room, 0.0) + SOFT_RAD) - np.sqrt(SOFT_RAD))

    return ca.vertcat(speed - most(high - pose), -speed - most(pose - low))


def across_shafts(shafts: Array) -> tuple[Array, Array]:
    """Return two unit vectors (k,3) each, at right angles to the shafts (k,3) and to each other."""
    along = shafts / np.linalg.norm(shafts, axis=1, keepdims=True)
    other = np.eye(3)[np.argmin(np.abs(along).max(axis=0))]
    first = np.cross(along, other)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(along, first)
