"""A course: one pose for each time of a path, its objective, and its violations of the constraints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array, read_only
from moc_opt.planning.pose_map import Margin
from moc_opt.planning.targets import Targets

Objective = Literal["mean", "worst", "log"]
OBJECTIVES: tuple[Objective, ...] = ("mean", "worst", "log")
MOST_VIOLATION = 1e-8
"""Of a course that is taken for one [m], [rad]."""
LEAST_MU = 1e-12
"""Below it the logarithm is taken here [m^3]."""


@dataclass(frozen=True, eq=False)
class Course:
    """k times, n joints; read-only arrays. ``k`` is less than the path's where the course ends early.

    Example:
        >>> course = mo.plan(mo.Scenario(duration_s=1.0), times=20, refined=False).best
        >>> course.q_rad.shape, course.kept, course.value("worst") <= course.mu_mean
        ((20, 7), True, True)
    """

    t_s: Array
    """(k,) [s]"""
    q_rad: Array
    """(k,n)"""
    mu: Array
    """(k,) [m^3], by the robot model"""
    violation: float
    """Largest of: tip or wrist off its target [m]; a joint beyond its limit, its speed times the period, or its
    acceleration times the period's square [rad]."""
    certified: bool = False
    """Whether it is a local optimum to the solver's tolerance; False: the best on a grid."""

    def value(self, objective: Objective) -> float:
        """Mean mu, worst mu [m^3], or mean of log mu, over the time by the trapezoidal rule."""
        if objective == "worst":
            return float(self.mu.min())
        gain = self.mu if objective == "mean" else np.log(np.maximum(self.mu, LEAST_MU))
        weight = weights(len(gain))
        return float(weight @ gain / weight.sum())

    @property
    def mu_mean(self) -> float:
        """Mean manipulability over the time [m^3]."""
        return self.value("mean")

    @property
    def kept(self) -> bool:
        """Whether it keeps targets, limits and speeds to `MOST_VIOLATION`."""
        return self.violation <= MOST_VIOLATION

    def as_certified(self) -> Course:
        """Return the same, said to be a local optimum."""
        return replace(self, certified=True)


def weights(count: int) -> Array:
    """Return the weights of the trapezoidal rule on evenly spaced times, (count,)."""
    weight = np.ones(count)
    if count > 1:
        weight[[0, -1]] = 0.5
    return weight


def faster(q: Array) -> Array:
    """Return |ddq| dt^2 (k-1,n) [rad] of evenly spaced poses (k,n) that begin at rest."""
    return np.abs(np.diff(q, n=2, axis=0, prepend=q[:1]))


def margin_at(robot: RobotModel, q_start: Array, margin: Margin) -> Margin:
    """Return the margin, no larger than what the start keeps itself: no smooth course from there could keep more."""
    room = np.maximum(np.minimum(q_start - robot.q_min, robot.q_max - q_start), 0.0)
    room = np.where(robot.moves.any(axis=0), room, np.inf)
    return np.minimum(margin, room) if isinstance(margin, np.ndarray) else min(margin, float(room.min()))


def make_course(
    robot: RobotModel, targets: Targets, q: Array, margin: Margin = 0.0, speed_share: float = 1.0,
    acceleration: float = np.inf,
) -> Course:  # fmt: skip
    """Judge poses (k,n) for the first k times by the robot model itself, independent of their origin.

    The joints begin at rest; ``acceleration`` [rad/s^2] is the most of any of them.
    """
    count = len(q)
    tips, wrists = robot.tool_along(q)
    off = max(np.abs(tips - targets.tip[:count]).max(), np.abs(wrists - targets.wrist[:count]).max())
    moving = robot.moves.any(axis=0)
    beyond = np.maximum(q - robot.q_max + margin, robot.q_min + margin - q)[:, moving].max()
    fast = np.abs(np.diff(q, axis=0)) - speed_share * robot.v_max * targets.period_s
    gained = faster(q) - acceleration * targets.period_s**2
    violation = float(max(off, beyond, fast.max(initial=-np.inf), gained.max(initial=-np.inf), 0.0))
    t, poses, mu = np.array(targets.t_s[:count]), np.array(q), robot.mu_along(q)
    return Course(read_only(t), read_only(poses), read_only(mu), violation)
