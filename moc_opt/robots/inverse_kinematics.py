"""Find poses with the tip (and the wrist) at given points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.arrays import Array
from moc_opt.errors import RobotError, TaskError
from moc_opt.robots.chain import desired_wrist
from moc_opt.robots.model import RobotModel

_RESTARTS = 60


class Placed(NamedTuple):
    """The result of a search for a pose."""

    q: Array  #: (n,) [rad], inside the limits unless they are ignored.
    miss_m: float  #: Largest component of the position errors of tip and wrist.
    at_limit: tuple[int, ...]  #: Joints (from 0) at a limit.

    @property
    def found(self) -> bool:
        """Whether `miss_m` is below 1e-6 m."""
        return self.miss_m < 1e-6


def solve_pose(
    robot: RobotModel, q: ArrayLike, tip: ArrayLike, wrist: ArrayLike | None = None, *, iterations: int = 40,
    limited: bool = True,
) -> Placed:  # fmt: skip
    """Search locally for a pose near q (n,) with the tip, and the wrist if given, at points (3,) [m].

    If ``limited`` is False, joint limits are ignored. Raise a RobotError if an argument is not usable.
    """
    points = np.array([tip] if wrist is None else [tip, wrist], dtype=np.float64)
    low, high = (robot.q_min, robot.q_max) if limited else (np.full(robot.n, -np.inf), np.full(robot.n, np.inf))
    begin = np.clip(np.asarray(q, dtype=np.float64), low, high)
    for name, value, shapes in (("q", begin, [(robot.n,)]), ("tip or wrist", points, [(1, 3), (2, 3)])):
        if value.shape not in shapes:
            raise RobotError(f"{name} has shape {value.shape}: give {' or '.join(map(str, shapes))}")
        if not np.isfinite(value).all():
            raise RobotError(f"{name} = {value.tolist()} is not finite: check the sensor or code that it comes from")
    miss, best = robot.arm.nearest_pose(low, high, points, begin, iterations)
    stuck = np.flatnonzero((best <= low) | (best >= high))
    return Placed(best, miss, tuple(stuck.tolist()))


def pose_with_tip(robot: RobotModel, q: ArrayLike, tip: ArrayLike) -> Array:
    """Find a pose (n,) near q with the tip at the incision ``tip`` (3,) [m]. Raise a TaskError if none is found."""
    placed = solve_pose(robot, q, tip, iterations=200)
    if not placed.found:
        raise TaskError(
            f"incision = {np.round(np.asarray(tip), 4).tolist()} m is out of reach: the tip comes no closer than "
            f"{1e3 * placed.miss_m:.0f} mm; move the patient or the robot's base"
        )
    return placed.q


def pose_through(robot: RobotModel, tip: ArrayLike, trocar: ArrayLike) -> Array:
    """Find a pose (n,) with the tip at a point (3,) [m] and the shaft through the trocar (3,) [m].

    Raise a TaskError if none is found.
    """
    x, p = np.asarray(tip, dtype=np.float64), np.asarray(trocar, dtype=np.float64)
    length = robot.data.tool_length
    depth = float(np.linalg.norm(p - x))
    if not 1e-3 < depth < length:
        raise TaskError(
            f"trocar = {np.round(p, 4).tolist()} m is {1e3 * depth:.0f} mm from the tip: the trocar must lie on the "
            f"tool, 1 to {1e3 * length:.0f} mm from the tip; move the trocar, or lengthen the tool"
        )
    wrist, _ = desired_wrist(x, 0.0, p, 0.0, robot.state(robot.data.q_home).tool_span)
    tried = [solve_pose(robot, robot.data.q_home, x, wrist, iterations=100)]
    if tried[0].found:
        return tried[0].q
    starts = np.random.default_rng(0).uniform(robot.q_min, robot.q_max, (_RESTARTS, robot.n))
    tried += [solve_pose(robot, start, x, wrist, iterations=60) for start in starts]
    good = [placed.q for placed in tried if placed.found]
    if not good:
        nearest = min(tried, key=lambda each: each.miss_m)
        raise TaskError(
            f"trocar = {np.round(p, 4).tolist()} m is out of reach with the tip at {np.round(x, 4).tolist()} m: "
            f"tip or wrist stays {1e3 * nearest.miss_m:.0f} mm off; move the trocar or the task towards the arm, or "
            "turn the line from the trocar to the tip"
        )
    return max(good, key=lambda q: np.minimum(robot.q_max - q, q - robot.q_min).min())
