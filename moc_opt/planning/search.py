"""The value function V: the largest integral of mu from a pose to the path's end, less a penalty on speed.

    V_k(p) = g_k(p) + max { V_{k+1}(p') - c |q - q'|^2 / dt : |q - q'| <= v_max dt for every joint }

The poses p and p' have the joint positions q and q', and p' is one time step dt later than p. g is mu dt, v_max the
allowed joint speeds, and c the penalty's weight.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt import core
from moc_opt.arrays import Array
from moc_opt.planning.course import Limits, lowered, shaft_shares, weights
from moc_opt.planning.elbow import wrapped
from moc_opt.planning.pose_map import PoseMap

#: With this ``cell``, `Value` estimates an upper bound. If self-motions were straight lines, 1 would be enough.
WHOLE_CELL = 1.1
NEARBY_RAD = 0.2  #: Radius around a pose within which V is approximated by a parabola.


class End(NamedTuple):
    """V near a pose, up to a constant: slope z + bend z^2 / 2, where z = along . (q - q_rad)."""

    q_rad: Array  #: (n,) [rad]
    along: Array  #: (n,) unit vector of the self-motion
    slope: float = 0.0  #: [m^3 s / rad]
    bend: float = 0.0  #: [m^3 s / rad^2], never above 0
    low: float = 0.0  #: least z from which the path's end is within reach [rad]
    high: float = 0.0  #: largest such z [rad]


class Way(NamedTuple):
    """A course along poses of the map."""

    t_s: Array  #: (w,)
    q_rad: Array  #: (w,n), the given pose first
    last: tuple[int, int]  #: branch and sample of the last pose


class Value:
    """V over a map of k times, b branches and m swivels (or samples of traced curves)."""

    def __init__(self, found: PoseMap, limits: Limits, *, cell: float = 0.0, price: float = 0.0) -> None:
        """Compute V, with the penalty's weight c = ``price`` [m^3 s^2/rad^2].

        A step may exceed its limit by ``cell`` times the sum of both poses' `half_cells`. If ``cell`` is 1 or more, V
        estimates an upper bound for all courses, also for those between the map's poses.
        """
        self.map = found
        self._period = found.targets.period_s
        self._step = limits.speed_share * found.robot.v_max * self._period
        self._slack = cell * half_cells(found.q_rad) if cell else np.broadcast_to(0.0, found.q_rad.shape)
        self._price, count = price / self._period, len(found.targets)
        self._weight = weights(count) * self._period
        feasible, mu = found.feasible(limits.margin), found.mu
        if cell >= 1.0:
            feasible = feasible | np.roll(feasible, 1, axis=2) | np.roll(feasible, -1, axis=2)
            mu = _highest_nearby(mu)
        gain = np.where(feasible, mu * self._weight[:, None, None], -np.inf)
        self.value = np.array(gain)
        """V (k,b,m) [m^3 s]; -inf where the path's end cannot be reached"""
        for k in range(count - 2, -1, -1):
            self.value[k] = advance(
                found.q_rad[k], self._slack[k], gain[k], found.q_rad[k + 1], self._slack[k + 1],
                self.value[k + 1], self._step, found.crossing(k, self._step), self._price,
            )  # fmt: skip

    def of(self, q: Array, mu: float) -> float:
        """Return mean mu, less the mean penalty [m^3], of the best course from a pose (n,); -inf if there is no course.

        ``mu`` is the mu of the pose. The penalty on the first step is left out.
        """
        found = self._next(1, q, np.zeros(len(q)), self._step, self._price)
        rest = -np.inf if found is None else float(self.value[1][found])
        return float(mu * self._weight[0] + rest) / self._weight.sum()

    def best(self) -> tuple[float, Array | None]:
        """Return mean mu, less the mean penalty [m^3], of the best of all courses, and its first pose (n,) or None."""
        first = np.unravel_index(int(np.argmax(self.value[0])), self.value[0].shape)
        value = float(self.value[0][first]) / self._weight.sum()
        return value, self.map.q_rad[0][first] if np.isfinite(value) else None

    def way(self, q: Array, t_s: float = 0.0, end: int = -1, hurry: float = 1.0) -> Way | None:
        """Read off the best course from a pose (n,) [rad] at a time [s]; None if there is no course.

        The course ends at the time with index ``end``. ``hurry`` is a factor on the joint speed limits.
        """
        t, poses, slack, at = self.map.targets.t_s, [q], np.zeros(len(q)), (0, 0)
        end = len(t) - 1 if end < 0 else end
        first, now = min(int(np.searchsorted(t, t_s + 0.5 * self._period)), end), t_s
        for k in range(first, end + 1):
            periods = max(float(t[k]) - now, 0.0) / self._period
            step, price = hurry * periods * self._step, self._price / max(periods, 1e-9)
            found = self._next(k, poses[-1], slack, step, price)
            if found is None:
                return None
            at, now = found, float(t[k])
            slack = self._slack[k][at]
            poses.append(self.map.q_rad[k][at])
        return Way(np.append(t_s, t[first : end + 1]), np.array(poses), at)

    def near(self, end: int, at: tuple[int, int]) -> End:
        """Fit a parabola to V around the pose ``at`` (branch, sample) at the time with index ``end``."""
        (b, j), value = at, self.value[end, at[0]]
        q = self.map.q_rad[end, b]
        along = q[(j + 1) % len(q)] - q[j - 1]
        size = float(np.linalg.norm(along))
        if not 0.0 < size < NEARBY_RAD:
            return End(q[j], np.zeros(q.shape[1]))
        along /= size
        with np.errstate(invalid="ignore"):
            close = np.linalg.norm(q - q[j], axis=1) < NEARBY_RAD
        z, dead = (q - q[j]) @ along, close & np.isneginf(value)
        low = max(z[dead & (z < 0.0)], default=-NEARBY_RAD)
        high = min(z[dead & (z > 0.0)], default=NEARBY_RAD)
        near = close & np.isfinite(value) & (z > low) & (z < high)
        bend, slope = 0.0, 0.0
        if np.count_nonzero(near) >= 4:
            bend, slope, _ = np.polyfit(z[near], value[near] - value[j], 2).tolist()
        return End(q[j], along, slope, min(2.0 * bend, 0.0), min(z[near]), max(z[near]))

    def _next(self, k: int, q: Array, slack: Array, step: Array, price: float) -> tuple[int, int] | None:
        alive = self.value[k] > -np.inf
        way, more = step + slack, self._slack[k]
        with np.errstate(invalid="ignore"):
            for a in range(len(q)):
                alive &= np.abs(self.map.q_rad[k, ..., a] - q[a]) <= way[a] + more[..., a]
        b, j = np.nonzero(alive)
        if not len(b):
            return None
        away = ((self.map.q_rad[k, b, j] - q) ** 2).sum(axis=-1)
        i = int(np.argmax(self.value[k, b, j] - price * away))
        return int(b[i]), int(j[i])


def keeping_shaft(found: PoseMap, limits: Limits) -> PoseMap:
    """Lower mu with `lowered` of course.py where the shaft can hardly turn, so that courses avoid such poses."""
    if limits.shaft <= 0.0:
        return found
    # `shaft_shares` is the same for all branches, because the columns of their Jacobians differ only in sign.
    may = found.feasible().any(axis=1)
    share = np.full(may.shape, np.inf)
    share[may] = shaft_shares(found.robot, found.q_rad[:, 0][may])
    share = share[:, None]
    return replace(found, mu=lowered(found.mu, share, limits, float(np.nanmax(found.mu, initial=0.0))))


def reached(found: PoseMap, q_start: Array, limits: Limits) -> list[NDArray[np.bool_]]:
    """Flag the poses (b,m) that can be reached at each time after the start. The list ends where there are none."""
    step, feasible = limits.speed_share * found.robot.v_max * found.targets.period_s, found.feasible(limits.margin)
    before, value = np.tile(q_start, (found.mu.shape[1], 1, 1)), np.zeros((found.mu.shape[1], 1))
    each: list[NDArray[np.bool_]] = []
    for k in range(1, len(found.targets)):
        q, gain, crossing = found.q_rad[k], np.where(feasible[k], 0.0, -np.inf), found.crossing(k, step)
        now = advance(q, np.zeros_like(q), gain, before, np.zeros_like(before), value, step, crossing, 0.0)
        if not np.isfinite(now).any():
            break
        each.append(np.isfinite(now))
        before, value = q, now
    return each


def half_cells(q: Array) -> Array:
    """Return half of each joint's distance to the farther neighbouring pose, (...,m,n) [rad]."""
    apart = np.abs(wrapped(np.roll(q, -1, axis=-2) - q))
    return 0.5 * np.nan_to_num(np.fmax(apart, np.roll(apart, 1, axis=-2)))


def _highest_nearby(mu: Array) -> Array:
    left, right = np.roll(mu, 1, axis=2), np.roll(mu, -1, axis=2)
    bend = np.nan_to_num(np.abs(left + right - 2.0 * mu))
    most = np.maximum(bend, np.maximum(np.roll(bend, 1, axis=2), np.roll(bend, -1, axis=2)))
    chord = np.fmax(mu, np.fmax(0.5 * (mu + left), 0.5 * (mu + right)))
    return np.where(np.isnan(mu), np.fmax(left, right), chord) + WHOLE_CELL * most / 8.0


def advance(
    q: Array, slack: Array, gain: Array, q_next: Array, slack_next: Array, value_next: Array, step: Array,
    crossing: NDArray[np.int64], price: float,
) -> Array:
    """Return the values (b,m) of the poses at one time, from the values at the next time.

    No joint may move farther than its step (n,) [rad] plus the slacks of both poses. A step may flip only bits of
    the branch's index that are set in ``crossing`` (m,).

    Args:
        q, slack: (b,m,n) [rad], NaN if there is no pose. gain: (b,m) added to the value, -inf at a forbidden pose.
        q_next, slack_next: (b,m1,n) [rad] at the next time. value_next: (b,m1).
        price: penalty on the squared step [unit of the values / rad^2].
    """  # fmt: skip
    branches, _, n = q.shape
    # If sorted by the joint with the largest range / step, the poses within reach lie in a short interval.
    spread = np.nan_to_num(np.fmax.reduce(q_next, 1) - np.fmin.reduce(q_next, 1)).sum(axis=0)
    by = int(np.argmax(spread / step))
    order = np.argsort(q_next[:, :, by])
    value_next = np.take_along_axis(value_next, order, 1)
    q_next, slack_next = (np.take_along_axis(each, order[:, :, None], 1) for each in (q_next, slack_next))
    at, room, then, later = (np.ascontiguousarray(each).reshape(-1, n) for each in (q, slack, q_next, slack_next))
    worth = core.advance(
        branches, at, room, np.ascontiguousarray(gain).ravel(), then, later, np.ascontiguousarray(value_next).ravel(),
        np.ascontiguousarray(step), crossing.astype(np.float64), price, by,
        step[by] + np.fmax.reduce(slack_next[:, :, by], None),
    )  # fmt: skip
    return worth.reshape(gain.shape)
