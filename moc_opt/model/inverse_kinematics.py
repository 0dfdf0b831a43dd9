"""Poses that put the tip, and the wrist if wanted, at a point: Newton's method inside the joint limits."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.errors import RobotError, TaskError
from moc_opt.model.kinematics_kernels import point_jacobian
from moc_opt.model.place_kernels import place_joints, point_in_world, spatial_axes
from moc_opt.model.robot_model import RobotModel
from moc_opt.model.shaft_kernels import desired_wrist
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import FLAGS, INTEGER, MATRIX, VECTOR, CompiledKernel
from moc_opt.numerics.dense import cholesky, solve_in_place

_TOLERANCE_M = 1e-9
_LONGEST_STEP = 0.25  # [rad]: beyond it the linearization is worth little
_RESTARTS = 60


class Placed(NamedTuple):
    """The result of a search for a pose."""

    q: Array
    """(n,) inside the limits [rad]"""
    miss_m: float
    """How far tip or wrist still is from where it should be [m]."""
    at_limit: tuple[int, ...]
    """Joints (from 0) that stand at a limit."""

    @property
    def found(self) -> bool:
        """Whether this is a solution."""
        return self.miss_m < 1e-6


def solve_pose(
    robot: RobotModel, q: ArrayLike, tip: Array, wrist: Array | None = None, *, iterations: int = 40
) -> Placed:
    """Find the nearest pose with the tip, and the wrist if given, at these points.

    Damped Gauss-Newton from q; a joint that reaches its limit stays there while the others take over, which is
    how the arm's own redundancy is used. The search is local: that it fails proves nothing by itself.

    Args:
        q: (n,) where to begin [rad]; put inside the limits first.
        tip: (3,) [m].
        wrist: (3,) [m], at the tool's length from the tip; None leaves it free.

    Raises:
        RobotError: as of `nearest_pose`.
    """
    begin = np.clip(np.asarray(q, dtype=np.float64), robot.q_min, robot.q_max)
    points = np.stack([tip] if wrist is None else [tip, wrist])
    best, miss = nearest_pose(robot, begin, points, robot.q_min, robot.q_max, iterations)
    stuck = np.flatnonzero((best <= robot.q_min) | (best >= robot.q_max))
    return Placed(best, miss, tuple(stuck.tolist()))


def nearest_pose(
    robot: RobotModel, q: Array, points: Array, low: Array, high: Array, iterations: int
) -> tuple[Array, float]:
    """Go on from q (n,) within these limits; return the best pose (n,), and what it misses the points by [m].

    Args:
        points: (1,3) of the tip, or (2,3) of tip and wrist [m].
        low, high: (n,) limits; infinite: none.

    Raises:
        RobotError: a pose or a point of another shape, or not finite.
    """
    chain, best = robot.chain, np.empty(robot.n)
    begin, wanted = (np.array(given, dtype=np.float64, order="C") for given in (q, points))
    for name, value, shapes in (("q", begin, [(robot.n,)]), ("tip or wrist", wanted, [(1, 3), (2, 3)])):
        if value.shape not in shapes:
            raise RobotError(f"{name} has shape {value.shape}: give {' or '.join(map(str, shapes))}")
        if not np.isfinite(value).all():
            raise RobotError(f"{name} = {value.tolist()} is not finite: check the sensor or step that gave it")
    limits = (np.ascontiguousarray(limit, dtype=np.float64) for limit in (low, high))
    miss = _NEAREST.code(chain.joints, chain.offsets, robot.moves, wanted, *limits, begin, iterations, best)
    return best, float(miss)


def pose_with_tip(robot: RobotModel, q: ArrayLike, tip: ArrayLike) -> Array:
    """Find a pose (n,) near q with the tip at a point (3,) [m].

    Raises:
        TaskError: none is found; the message has the least distance of the tip.
    """
    point = _point("tip", tip)
    placed = solve_pose(robot, q, point, iterations=200)
    if not placed.found:
        raise TaskError(
            f"incision = {np.round(point, 4).tolist()} m is out of reach: the tip gets to "
            f"{1e3 * placed.miss_m:.0f} mm from it{_limits(robot, placed)}; move the patient or the robot's base"
        )
    return placed.q


def pose_through(robot: RobotModel, tip: ArrayLike, trocar: ArrayLike) -> Array:
    """Find a pose (n,) with the tip at a point and the shaft through the trocar, both (3,) [m].

    Tried from the home pose first, then from seeded random poses, of which the solution farthest from the joint limits
    is taken.

    Raises:
        TaskError: the trocar is not on the shaft's length, or no pose is found.
    """
    x, p = _point("tip", tip), _point("trocar", trocar)
    depth = float(np.linalg.norm(p - x))
    if not 1e-3 < depth < robot.data.tool_length:
        raise TaskError(
            f"trocar = {np.round(p, 4).tolist()} m is {1e3 * depth:.0f} mm from the tip: it must lie on the tool, "
            f"1 to {1e3 * robot.data.tool_length:.0f} mm from its tip; move it, or lengthen the tool"
        )
    rest = np.zeros(3)
    wrist, _ = desired_wrist(x, rest, p, rest, robot.state(robot.data.q_home).tool_span)
    placed = solve_pose(robot, robot.data.q_home, x, wrist, iterations=100)
    if placed.found:
        return placed.q
    nearest, good = placed, []
    for start in np.random.default_rng(0).uniform(robot.q_min, robot.q_max, (_RESTARTS, robot.n)):
        placed = solve_pose(robot, start, x, wrist, iterations=60)
        nearest = min(nearest, placed, key=lambda each: each.miss_m)
        if placed.found:
            good.append(placed.q)
    if not good:
        raise TaskError(
            f"trocar = {np.round(p, 4).tolist()} m is out of reach with the tip at {np.round(x, 4).tolist()} m: "
            f"tip or wrist stays {1e3 * nearest.miss_m:.0f} mm away{_limits(robot, nearest)}; move the trocar or the "
            "task towards the arm, or turn the line between them"
        )
    room = np.minimum(robot.q_max - np.array(good), np.array(good) - robot.q_min).min(axis=1)
    return good[int(np.argmax(room))]


@njit(cache=True)
def _nearest(
    joints: Array, offsets: Array, moves: Array, points: Array, low: Array, high: Array, q: Array, iterations: int,
    best: Array,
) -> float:  # fmt: skip
    """Damped Gauss-Newton on q, in place; arguments as of `nearest_pose` and `kinematics_kernels.fill_state`."""
    n, rows = q.shape[0], 3 * points.shape[0]
    places, axes, there = np.empty((n, 12)), np.empty((n, 6)), np.empty(3)
    jacobian, error, step = np.empty((rows, n)), np.empty(rows), np.empty(n)
    damping, last, miss = 1e-12, math.inf, math.inf
    best[:] = q
    for _ in range(iterations):
        place_joints(joints, q, places)
        spatial_axes(joints, places, axes)
        worst = 0.0
        for p in range(points.shape[0]):
            point_in_world(places[n - 1, :9].reshape((3, 3)), places[n - 1, 9:], offsets[p], there)
            point_jacobian(axes, there, moves[p], jacobian[3 * p : 3 * p + 3])
            for i in range(3):
                error[3 * p + i] = points[p, i] - there[i]
                worst = max(worst, abs(error[3 * p + i]))
        if worst < miss:
            best[:], miss = q, worst
        if worst < _TOLERANCE_M:
            break
        # Out of reach, undamped steps swing about without end.
        damping = 1e-12 if worst < 0.5 * last else min(max(10.0 * damping, 1e-8), 1e-2)
        last = worst
        _step(jacobian, error, damping, q, low, high, step)
        length = np.abs(step).max()
        if not length >= 1e-12:
            break
        for j in range(n):
            q[j] = min(max(q[j] + step[j] * min(1.0, _LONGEST_STEP / length), low[j]), high[j])
    return miss


@njit(cache=True)
def _step(jacobian: Array, error: Array, damping: float, q: Array, low: Array, high: Array, step: Array) -> None:
    """Write the smallest damped least-squares step whose joints do not run against the limits they stand at."""
    rows, n = jacobian.shape
    free = np.ones(n, dtype=np.bool_)
    for _ in range(n):
        gram, trace = np.zeros((rows, rows)), 0.0
        for i in range(rows):
            for k in range(rows):
                for j in range(n):
                    if free[j]:
                        gram[i, k] += jacobian[i, j] * jacobian[k, j]
            trace += gram[i, i]
        for i in range(rows):
            # Tip and wrist are rigidly tied: the product is singular, so a trace of damping is always there.
            gram[i, i] += max(damping, 1e-10 * trace, 1e-14)
        weight, blocked = error.copy(), False
        solve_in_place(cholesky(gram), weight)
        for j in range(n):
            step[j] = 0.0
            if free[j]:
                for i in range(rows):
                    step[j] += jacobian[i, j] * weight[i]
                if (q[j] >= high[j] and step[j] > 0.0) or (q[j] <= low[j] and step[j] < 0.0):
                    free[j], blocked = False, True
        if not blocked:
            return
    step[:] = 0.0


_NEAREST = CompiledKernel(_nearest, MATRIX, MATRIX, FLAGS, MATRIX, VECTOR, VECTOR, VECTOR, INTEGER, VECTOR)


def _limits(robot: RobotModel, placed: Placed) -> str:
    names = [robot.data.joint_names[i] for i in placed.at_limit]
    return f" ({', '.join(names)} at the limit)" if names else ""


def _point(name: str, value: ArrayLike) -> Array:
    point = np.asarray(value, dtype=np.float64)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise TaskError(f"{name} = {value!r}: give three finite numbers [m]")
    return point
