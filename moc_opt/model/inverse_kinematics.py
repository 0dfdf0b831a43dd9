"""Poses that put the tip, and the wrist if wanted, at a point: Newton's method inside the joint limits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.errors import TaskError
from moc_opt.model.robot_model import RobotModel
from moc_opt.model.shaft_kernels import desired_wrist
from moc_opt.numerics.arrays import Array

_TOLERANCE_M = 1e-8
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
    """
    pose = np.clip(np.asarray(q, dtype=np.float64), robot.q_min, robot.q_max)
    damping, last = 1e-12, np.inf
    best, miss = pose, np.inf
    for _ in range(iterations):
        state = robot.state(pose)
        error, jacobian = tip - state.tip, state.J_tip
        if wrist is not None:
            error, jacobian = np.concatenate([error, wrist - state.wrist]), state.A
        worst = float(np.abs(error).max())
        if worst < miss:
            best, miss = pose, worst
        if worst < _TOLERANCE_M:
            break
        # Out of reach, undamped steps swing about without end.
        damping = 1e-12 if worst < 0.5 * last else min(max(10.0 * damping, 1e-8), 1e-2)
        last = worst
        step = _step(robot, pose, error, jacobian, damping)
        length = float(np.abs(step).max())
        if length < 1e-12:
            break
        pose = np.clip(pose + step * min(1.0, _LONGEST_STEP / length), robot.q_min, robot.q_max)
    stuck = np.flatnonzero((best <= robot.q_min) | (best >= robot.q_max))
    return Placed(best, miss, tuple(stuck.tolist()))


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


def _step(robot: RobotModel, q: Array, error: Array, jacobian: Array, damping: float) -> Array:
    """Return the smallest damped least-squares step whose joints do not run against the limits they stand at."""
    free = np.ones(robot.n, dtype=np.bool_)
    step = np.zeros(robot.n)
    for _ in range(robot.n):
        part = jacobian[:, free]
        gram = part @ part.T
        # Tip and wrist are rigidly tied: the product is singular, so a trace of damping is always there.
        gram[np.diag_indices_from(gram)] += max(damping, 1e-10 * float(np.trace(gram)), 1e-14)
        step[:] = 0.0
        step[free] = part.T @ np.linalg.solve(gram, error)
        blocked = free & (((q >= robot.q_max) & (step > 0.0)) | ((q <= robot.q_min) & (step < 0.0)))
        if not blocked.any():
            break
        free &= ~blocked
        if not free.any():
            return np.zeros(robot.n)
    return step


def _limits(robot: RobotModel, placed: Placed) -> str:
    names = [robot.data.joint_names[i] for i in placed.at_limit]
    return f" ({', '.join(names)} at the limit)" if names else ""


def _point(name: str, value: ArrayLike) -> Array:
    point = np.asarray(value, dtype=np.float64)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise TaskError(f"{name} = {value!r}: give three finite numbers [m]")
    return point
