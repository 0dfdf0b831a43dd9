"""Targets of tip and wrist along a path, and courses that reach them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from moc_opt.arrays import Array, read_only
from moc_opt.errors import TaskError
from moc_opt.robots.chain import desired_wrist
from moc_opt.robots.model import RobotModel
from moc_opt.tasks import Reference, Trocar

Margin = float | Array
"""Distance kept from the joint limits, a number or (n,) [rad, or m for a prismatic joint]."""
SHALLOWEST_M = 0.002  #: Smallest allowed distance from tip to trocar.
MOST_VIOLATION = 1e-8  #: `Course.violation` up to which a course counts as feasible.
WORTH = 10.0  #: Weight of the penalty that `lowered` subtracts from mu.


@dataclass(frozen=True, eq=False)
class Targets:
    """Required positions of tip and wrist at k times."""

    t_s: Array  #: (k,) evenly spaced [s]
    tip: Array  #: (k,3) [m]
    wrist: Array  #: (k,3) [m], on the line from the tip through the trocar
    arc_length_m: Array  #: (k,) length of the tip's path up to each time [m]

    @property
    def period_s(self) -> float:
        """Time between two targets [s]."""
        return float(self.t_s[1] - self.t_s[0])

    def __getitem__(self, some: slice) -> Targets:
        return Targets(self.t_s[some], self.tip[some], self.wrist[some], self.arc_length_m[some])

    def at(self, t: Array) -> Targets:
        """Interpolate the targets linearly at times (m,) [s]."""
        tip, wrist = (between(t, self.t_s, rows) for rows in (self.tip, self.wrist))
        return Targets(t, tip, wrist, np.interp(t, self.t_s, self.arc_length_m))

    def __len__(self) -> int:
        return len(self.t_s)


def lay_targets(
    reference: Reference, trocar: Trocar, span_m: float, duration_s: float, count: int,
    tool_m: float = np.inf,
) -> Targets:  # fmt: skip
    """Sample reference and trocar at ``count`` times from 0 to ``duration_s`` [s].

    ``span_m`` is the distance from wrist to tip, and ``tool_m`` the length of the tool [m].

    Raises:
        TaskError: the trocar is farther from the tip than ``span_m`` or ``tool_m``, or nearer than `SHALLOWEST_M`.
    """
    t = np.linspace(0.0, duration_s, count)
    tip = np.ascontiguousarray(reference.at(t)[0])
    trocars = trocar.at(t)[0]
    depth = np.linalg.norm(trocars - tip, axis=1)
    deepest = min(span_m, tool_m)
    off = (depth < SHALLOWEST_M) | (depth > deepest)
    if off.any():
        k = int(np.argmax(off))
        raise TaskError(
            f"trocar: at t = {t[k]:.2f} s it is {1e3 * depth[k]:.0f} mm from the tip; it must lie on the shaft, "
            f"{1e3 * SHALLOWEST_M:.0f} to {1e3 * deepest:.0f} mm from the tip: make the path smaller, or change depth_m"
        )
    arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))))
    return Targets(*map(read_only, (t, tip, desired_wrist(tip, 0.0, trocars, 0.0, span_m)[0], arc)))


@dataclass(frozen=True, eq=False)
class Course:
    """A joint trajectory with k times and n joints. It may end before the path does."""

    t_s: Array  #: (k,) [s]
    q_rad: Array  #: (k,n)
    mu: Array  #: (k,) manipulability [m^3]
    violation: float
    """Largest of: tip or wrist error [m], excess over joint limits [rad], excess over the allowed step [rad]."""
    certified: bool = False  #: Whether the nonlinear program has converged to a local optimum.

    @property
    def mu_mean(self) -> float:
        """Mean manipulability over time [m^3]."""
        return time_mean(self.mu)

    @property
    def kept(self) -> bool:
        """Whether `violation` is at most `MOST_VIOLATION`."""
        return self.violation <= MOST_VIOLATION


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits for a course."""

    margin: Margin = 0.0  #: distance from the joint limits
    speed_share: float = 1.0  #: share of the joints' speed limits that a course may use
    shaft: float = 0.0  #: soft lower bound on `shaft_shares`: below it, `lowered` reduces mu


def lowered(mu: Array, share: Array, limits: Limits, top: float) -> Array:
    """Return mu - `WORTH` * top * (1 - s/s_0)^2 where s < s_0, and mu elsewhere.

    s is the ``share`` from `shaft_shares`, s_0 is ``limits.shaft``, and ``top`` is the largest mu [m^3].
    """
    if limits.shaft <= 0.0:
        return mu
    with np.errstate(invalid="ignore"):
        less: Array = mu - WORTH * top * np.maximum(1.0 - share / limits.shaft, 0.0) ** 2
    return less


def shaft_shares(robot: RobotModel, poses: Array) -> Array:
    """Compute mu_shaft / (distance from wrist to tip)^2, (k,), at the poses (k,n) [rad].

    mu_shaft is the manipulability of the wrist while the tip rests. It is near 0 if the shaft can hardly turn.
    """
    squares = np.array(robot.kinematics().shaft(np.ascontiguousarray(poses).T)).ravel()
    return np.sqrt(np.maximum(squares, 0.0))


def weights(count: int) -> Array:
    """Return the trapezoidal rule's weights (count,) on evenly spaced times."""
    weight = np.ones(count)
    if count > 1:
        weight[[0, -1]] = 0.5
    return weight


def time_mean(rows: Array) -> float:
    """Return the mean of rows (k,) over evenly spaced times."""
    weight = weights(len(rows))
    return float(weight @ rows / weight.sum())


def between(t: Array, times: Array, rows: Array) -> Array:
    """Interpolate linearly at ``t`` (m,) between the rows (k,n) of the ``times`` (k,)."""
    return np.stack([np.interp(t, times, column) for column in rows.T], axis=1)


def margin_at(robot: RobotModel, poses: Array, margin: Margin) -> Margin:
    """Return the smaller of the margin and the least distance of the poses (..., n) from the joint limits.

    The distance is 0 beyond a limit. A margin (n,) is compared joint by joint.
    """
    room = np.minimum(poses - robot.q_min, robot.q_max - poses).reshape(-1, robot.n).min(axis=0)
    room = np.where(robot.moves.any(axis=0), np.maximum(room, 0.0), np.inf)
    return np.minimum(margin, room) if isinstance(margin, np.ndarray) else min(margin, float(room.min()))


def make_course(robot: RobotModel, targets: Targets, q: Array, limits: Limits | None = None) -> Course:
    """Make a course of poses (k,n) at the first k targets."""
    limits, count = Limits() if limits is None else limits, len(q)
    tips, wrists = robot.tool_along(q)
    off = max(np.abs(tips - targets.tip[:count]).max(), np.abs(wrists - targets.wrist[:count]).max())
    moving = robot.moves.any(axis=0)
    beyond = np.maximum(q - robot.q_max + limits.margin, robot.q_min + limits.margin - q)[:, moving].max()
    fast = np.abs(np.diff(q, axis=0)) - limits.speed_share * robot.v_max * targets.period_s
    violation = float(max(off, beyond, fast.max(initial=-np.inf), 0.0))
    t, poses, mu = np.array(targets.t_s[:count]), np.array(q), robot.mu_along(q)
    return Course(read_only(t), read_only(poses), read_only(mu), violation)


def worth(robot: RobotModel, course: Course, limits: Limits, top: float) -> float:
    """Return the mean mu of a course [m^3], less the mean penalty of `lowered`."""
    if limits.shaft <= 0.0:
        return course.mu_mean
    return time_mean(lowered(course.mu, shaft_shares(robot, course.q_rad), limits, top))
