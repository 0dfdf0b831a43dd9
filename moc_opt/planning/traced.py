"""The map of an arm without closed form: self-motion curves found from many seeds, and followed along the path.

At each time the curves that the time before it had are reached again by Newton's method, and random inverse kinematics
look for others. Curves end nowhere but at singularities: joint limits are judged afterwards. Where tip and wrist leave
more than one freedom (a tool off the last axis), a curve is a part of the poses only, and the map no bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from moc_opt.errors import RobotError
from moc_opt.model.inverse_kinematics import solve_pose
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.planning.pose_map import ROUNDING_RAD, Flags, Margin, PoseMap
from moc_opt.planning.targets import Targets
from moc_opt.redundancy.arm_angle import nearest_turns, reach, without_limits
from moc_opt.redundancy.self_motion import self_motion

STEP_RAD = 0.03
"""Spacing of the samples along a curve."""
MOST_CURVES = 16
"""Most different curves at one time; further ones are left out."""
SAME_CURVE = 0.7
"""A pose this share of a step from a sample lies on its curve."""


@dataclass(frozen=True, eq=False)
class TracedMap(PoseMap):
    """Curves one after the other in the third dimension, a NaN between two."""

    q_rad: Array
    """(k,1,m,n)"""

    limits: tuple[Array, Array]
    """q_min, q_max (n,) [rad], [m]; without any where a joint is idle"""

    def feasible(self, margin: Margin = 0.0) -> Flags:
        """Return (k,1,m) whether every joint keeps its margin from its limits."""
        if np.ndim(margin) == 0:
            return super().feasible(margin)
        low, high = self.limits
        room = np.minimum(self.q_rad - low, high - self.q_rad) - margin
        return room.min(axis=-1) >= -ROUNDING_RAD  # NaN: no pose

    def poses(self, k: int) -> Array:
        """Return the poses (1,m,n) [rad] at time k; NaN where there is none."""
        found: Array = self.q_rad[k]
        return found


def traced_map(
    robot: RobotModel,
    targets: Targets,
    q_start: Array,
    *,
    seeds: int = 64,
    step_rad: float = STEP_RAD,
    rng: np.random.Generator | None = None,
) -> TracedMap:
    """Scan the self-motions along the path.

    Args:
        q_start: (n,) a pose for the first of them [rad]; its idle joints are kept.
        seeds: random starts of the inverse kinematics at the first time; a sixteenth of them at each later one.
        step_rad: spacing of the samples along a curve [rad].
        rng: draws the seeds; seeded with 0 by default.

    Raises:
        RobotError: seeds or step are not usable.
    """
    if seeds < 1 or not step_rad > 0.0:
        raise RobotError(f"seeds = {seeds}, step_rad = {step_rad:g}: give one or more and a positive step")
    draw = np.random.default_rng(0) if rng is None else rng
    free, moving = without_limits(robot), _moving(robot)
    columns: list[list[Array]] = []
    for k in range(len(targets)):
        tip, wrist = targets.tip[k], targets.wrist[k]
        if k and max(np.abs(tip - targets.tip[k - 1]).max(), np.abs(wrist - targets.wrist[k - 1]).max()) < 1e-12:
            columns.append(columns[-1])
            continue
        before = [] if not k else [curve[int(i)] for curve in columns[-1] for i in _thirds(len(curve))]
        guesses = [q_start] if not k else before
        found: list[Array] = []
        for guess in guesses:
            _add(free, reach(free, guess, tip, wrist), found, step_rad, moving)
        for _ in range(seeds if not k else seeds // 16):
            start = np.where(moving, draw.uniform(robot.q_min, robot.q_max), q_start)
            placed = solve_pose(robot, start, tip, wrist)
            _add(free, placed.q if placed.found else None, found, step_rad, moving)
        columns.append(found)
    return _stacked(robot, targets, columns, moving)


def _moving(robot: RobotModel) -> Flags:
    found: Flags = np.asarray(robot.moves.any(axis=0))
    return found


def _thirds(length: int) -> tuple[int, int, int]:
    return 0, length // 3, 2 * length // 3


def _add(free: RobotModel, pose: Array | None, found: list[Array], step: float, moving: Flags) -> None:
    """Scan the curve through the pose, unless it is known, singular, or one too many."""
    if pose is None or len(found) >= MOST_CURVES:
        return
    for curve in found:
        apart = np.mod(curve - pose + np.pi, 2.0 * np.pi) - np.pi
        apart = np.where(free.chain.prismatic, curve - pose, apart)[:, moving]
        if np.linalg.norm(apart, axis=1).min() < SAME_CURVE * step:
            return
    try:
        found.append(np.array(self_motion(free, pose, step).q))
    except RobotError:
        return  # a singular pose: no single curve leads through it


def _stacked(
    robot: RobotModel, targets: Targets, columns: list[list[Array]], moving: Flags
) -> TracedMap:
    longest = max(1, *(sum(len(curve) + 1 for curve in column) for column in columns))
    q = np.full((len(columns), 1, longest, robot.n), np.nan)
    for k, column in enumerate(columns):
        at = 0
        for curve in column:
            q[k, 0, at : at + len(curve)] = nearest_turns(robot, curve)
            at += len(curve) + 1
    known = np.isfinite(q[..., 0])
    mu, room = np.full(known.shape, np.nan), np.full(known.shape, np.nan)
    mu[known] = robot.mu_along(q[known])
    room[known] = np.minimum(q[known] - robot.q_min, robot.q_max - q[known])[:, moving].min(axis=1)
    limits = np.where(moving, robot.q_min, -np.inf), np.where(moving, robot.q_max, np.inf)
    return TracedMap(targets, mu, room, q, limits)
