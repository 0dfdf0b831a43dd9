"""The whole horizon as one sparse nonlinear program (direct transcription), begun at the course that the search found.

Variables are the joints that move, at every time; each time keeps five equations (the tip at its point, the wrist on
the shaft's line) and the joint limits, each pair of times the joint speeds:

    max  f(q_0, ..., q_k)
    s.t. X(q_k) = X_d,  B_k^T (N(q_k) - X_d) = 0,  q_min <= q_k <= q_max,  |q_k - q_k-1| <= v_max dt

B_k (3,2) is orthogonal to the shaft. Five equations, since tip and wrist are rigidly tied: with six no multiplier is
unique. f is the mean of mu, the mean of log mu, or s with mu(q_k) >= s.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.model.robot_model import RobotModel
from moc_opt.planning.course import Course, Objective, make_course, weights
from moc_opt.planning.targets import Targets

Array = NDArray[np.float64]

MOST_VIOLATION = 1e-8
"""Of an answer that is taken [m], [rad]."""
OPTIONS: dict[str, Any] = {
    "print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.max_iter": 300, "ipopt.tol": 1e-8,
    "ipopt.constr_viol_tol": 1e-10, "ipopt.bound_relax_factor": 0.0, "ipopt.honor_original_bounds": "yes",
    "ipopt.mu_init": 1e-3, "ipopt.bound_push": 1e-6, "ipopt.bound_frac": 1e-6, "ipopt.slack_bound_push": 1e-6,
    "ipopt.slack_bound_frac": 1e-6, "ipopt.acceptable_iter": 0,
}  # fmt: skip
INSIDE = 1e-9
"""Limits and speeds are kept this far inside, so that rounding stays within them [rad]."""


def refine(
    robot: RobotModel,
    targets: Targets,
    course: Course,
    objective: Objective = "mean",
    *,
    guess: Array | None = None,
    free_start: bool = False,
    margin_rad: float = 0.0,
    speed_share: float = 1.0,
) -> Course:
    """Improve a course to a local optimum.

    Args:
        robot: the arm.
        targets: tip and wrist over time.
        course: that is to be improved; all times.
        guess: (k,n) poses to begin with in place of the course's; they may break constraints.
        objective: as for the search.
        free_start: whether the first pose may change, too.
        margin_rad: from the joint limits.
        speed_share: of the joints' speed limits.

    Returns:
        The better of both courses by the robot model's own mu; one that breaks a constraint by more than
        `MOST_VIOLATION` is never taken. ``certified`` where ipopt met its tolerances at the course that is returned.
    """
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
    across = _across(targets.wrist - targets.tip)
    rows: list[tuple[Any, Any, Any]] = [(ca.vec(tip - ca.DM(targets.tip.T)), 0.0, 0.0)]
    rows += [(ca.sum1(ca.DM(side.T) * (wrist - ca.DM(targets.tip.T))).T, 0.0, 0.0) for side in across]
    step = (speed_share * robot.v_max * targets.period_s)[moving] - INSIDE
    most = np.tile(step, k - 1)
    rows.append((ca.vec(x[:, 1:] - x[:, :-1]), -most, most))
    keep = margin_rad + INSIDE
    low, high = (np.tile(limit[moving], k) for limit in (robot.q_min + keep, robot.q_max - keep))
    begin = np.array((course.q_rad if guess is None else guess)[:, moving]).ravel()
    if not free_start:
        low[:a] = high[:a] = course.q_rad[0, moving]
    weight, variables = weights(k) / weights(k).sum(), ca.vec(x)
    scale = float(np.mean(course.mu))
    if objective == "worst":
        least = ca.MX.sym("s")
        variables, begin = ca.vertcat(variables, least), np.append(begin, course.mu.min() / scale)
        low, high = np.append(low, -np.inf), np.append(high, np.inf)
        rows.append((mu.T / scale - least, 0.0, np.inf))
        cost = -least
    else:
        cost = -ca.dot(ca.DM(weight), (ca.log(mu) if objective == "log" else mu / scale).T)
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
    found = make_course(robot, targets, poses, margin_rad, speed_share)
    if found.violation > MOST_VIOLATION or found.value(objective) < course.value(objective):
        return course
    return found.as_certified() if solver.stats()["success"] else found


def _across(shafts: Array) -> tuple[Array, Array]:
    """Two unit vectors (k,3) each, at right angles to the shafts (k,3) and to each other."""
    along = shafts / np.linalg.norm(shafts, axis=1, keepdims=True)
    other = np.eye(3)[np.argmin(np.abs(along).max(axis=0))]
    first = np.cross(along, other)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(along, first)
