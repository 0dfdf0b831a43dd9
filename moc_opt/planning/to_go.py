"""The value of a pose: the largest integral of mu over time from it to the end of the path.

Dynamic programming backwards over the map, once, before anything moves:

    V_k(p) = mu dt + max { V_{k+1}(p') - c |q - q'|^2 / dt : |q - q'| <= v_max dt for every joint }

A horizon that ends in V chooses as if it went to the end of the path: it leaves a local maximum of mu for a better one
where that pays, at any time and from any pose. V knows path and time law, joint limits and speeds, and the robot model.
It does not know what pushes the arm nor what acceleration costs, and it is as accurate as its map: a pose stands for
a quarter of a cell on either side.
"""

from __future__ import annotations

import math
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.planning.course import weights
from moc_opt.planning.pose_map import Margin, PoseMap
from moc_opt.planning.search import half_cells
from moc_opt.planning.search_kernels import BLOCK, boxes, out_of_reach

NEARBY_RAD = 0.2
"""Poses within this way of each other are one neighbourhood, in which V is a parabola."""
KEPT = 64
"""Times whose poses are kept: a run goes through them in order."""


class End(NamedTuple):
    """V near a pose: value + slope z + bend z^2 / 2, low <= z = along . (q - q_rad) <= high."""

    q_rad: Array
    """(n,) [rad]"""
    along: Array
    """(n,) unit vector of the self-motion"""
    slope: float
    """[m^3 s / rad]"""
    bend: float
    """[m^3 s / rad^2], never above 0"""
    low: float
    """Beyond it no pose is known to reach the end of the path [rad]."""
    high: float


class _Poses(NamedTuple):
    """Poses of one time, and what a step to them is measured by."""

    q: Array
    """(b,m,n) [rad]"""
    slack: Array
    """(b,m,n) the way that each stands for [rad]"""
    low: Array
    """(b,blocks,n) and high: as of `search_kernels.boxes`"""
    high: Array


def _poses(found: PoseMap, k: int) -> _Poses:
    q = found.poses(k)
    slack = 0.5 * half_cells(q)
    return _Poses(q, slack, *boxes(q, slack))


class ToGo:
    """V over a map of k times, b branches, m samples."""

    def __init__(self, found: PoseMap, step_rad: Array, margin: Margin = 0.0, price: float = 0.0) -> None:
        """Go through the map from its end to its start.

        Args:
            step_rad: (n,) most that a joint turns in one period [rad].
            margin: from the joint limits.
            price: c, of speed [m^3 s^2/rad^2].
        """
        self._price = price / found.targets.period_s
        self.map, self._step, count = found, step_rad, len(found.targets)
        # Not a method: the object would hold itself, 50 MB that wait for the garbage collector.
        self._poses = lru_cache(KEPT)(partial(_poses, found))
        weight = weights(count) * found.targets.period_s
        self._gain = np.where(found.feasible(margin), found.mu * weight[:, None, None], -np.inf)
        self.value = np.array(self._gain)
        """(k,b,m) [m^3 s], its own share included; -inf: the end cannot be reached from there"""
        for k in range(count - 2, -1, -1):
            after = self._poses(k + 1)
            self.value[k] = self._spread(k, after.q, after.slack, self.value[k + 1], self._gain[k])[0]

    def way(self, q: Array, t_s: float, end: int, hurry: float = 1.0) -> tuple[Array, Array, int, int] | None:
        """Find the best way from a pose at any time to the map's time ``end``, and on from there by V.

        Args:
            q: (n,) [rad].
            t_s: before the time ``end`` [s].
            end: number of a time of the map.
            hurry: times the steps of V that may be used up to there.

        Returns:
            Times (w,) [s] and poses (w,n) [rad], the given one first, branch and sample at the end; None: there is
            no way.
        """
        t, period = self.map.targets.t_s, self.map.targets.period_s
        first = min(int(np.searchsorted(t, t_s + 0.5 * period)), end)
        branches = self.value.shape[1]
        before, slack = np.tile(q, (branches, 1, 1)), np.zeros((branches, 1, len(q)))
        value, backs, now = np.zeros((branches, 1)), [], t_s
        for k in range(first, end + 1):
            gain = self.value[k] if k == end else self._gain[k]
            value, back = self._spread(k, before, slack, value, gain, hurry * (float(t[k]) - now) / period)
            backs.append(back)
            (before, slack, *_), now = self._poses(k), float(t[k])
        b, j = (int(i) for i in np.unravel_index(int(np.argmax(value)), value.shape))
        if not np.isfinite(value[b, j]):
            return None
        poses, at = [], (b, j)
        for k, back in zip(range(end, first - 1, -1), backs[::-1], strict=True):
            poses.append(self._poses(k).q[at])
            at = divmod(int(back[at]), back.shape[1])
        return np.append(t_s, t[first : end + 1]), np.array([q, *poses[::-1]]), b, j

    def near(self, end: int, b: int, j: int) -> End:
        """Return the parabola through V around one pose of the map."""
        q, count, value = self._poses(end).q[b], self.value.shape[2], self.value[end, b]
        along = q[(j + 1) % count] - q[j - 1]
        size = float(np.linalg.norm(along))
        if not 0.0 < size < NEARBY_RAD:
            return End(q[j], np.zeros(q.shape[1]), 0.0, 0.0, 0.0, 0.0)
        along /= size
        with np.errstate(invalid="ignore"):
            close = np.linalg.norm(q - q[j], axis=1) < NEARBY_RAD
        z, dead = (q - q[j]) @ along, close & np.isneginf(value)
        low = max(z[dead & (z < 0.0)], default=-NEARBY_RAD)
        high = min(z[dead & (z > 0.0)], default=NEARBY_RAD)
        near = close & np.isfinite(value) & (z > low) & (z < high)
        if np.count_nonzero(near) < 4:
            return End(q[j], along, 0.0, 0.0, min(z[near]), max(z[near]))
        bend, slope, _ = np.polyfit(z[near], value[near] - value[j], 2)
        return End(q[j], along, float(slope), float(min(2.0 * bend, 0.0)), min(z[near]), max(z[near]))

    def _spread(
        self, k: int, before: Array, slack: Array, value_before: Array, gain: Array, periods: float = 1.0
    ) -> tuple[Array, NDArray[np.int32]]:
        value, back = np.empty(gain.shape), np.empty(gain.shape, dtype=np.int32)
        price, step = self._price / max(periods, 1e-9), periods * self._step
        crossing = self.map.crossing(k, step)
        spread(before, slack, value_before, *self._poses(k), gain, step, crossing, price, value, back)
        return value, back


@njit(cache=True, nogil=True)
def spread(
    before: Array, slack_before: Array, value_before: Array, q: Array, slack: Array, low: Array, high: Array,
    gain: Array, step: Array, crossing: NDArray[np.int64], price: float, value: Array, back: NDArray[np.int32],
) -> None:  # fmt: skip
    """Fill value and back (b,m) as `search_kernels.advance` does, but going out from the poses that have a value.

    That costs what is reached, not what there is: a horizon begins at one pose. Low, high: `search_kernels.boxes` of
    q and slack. Price: of a step's square [1/rad^2].
    """
    branches, m, n = q.shape
    m0 = before.shape[1]
    blocks = low.shape[1]
    crossed = np.zeros(blocks, dtype=np.int64)
    for j in range(m):
        crossed[j // BLOCK] |= crossing[j]
    value[:], back[:] = -math.inf, -1
    for b in range(branches):
        for j0 in range(m0):
            worth = value_before[b, j0]
            if worth == -math.inf:
                continue
            for block in range(blocks):
                flips = crossed[block]
                while True:  # over all subsets of the bits, the empty one last
                    to = b ^ flips
                    if not out_of_reach(low[to, block], high[to, block], before[b, j0], slack_before[b, j0], step):
                        for j in range(block * BLOCK, min(m, (block + 1) * BLOCK)):
                            if flips & ~crossing[j]:
                                continue
                            near, total = worth + gain[to, j] > value[to, j], worth + gain[to, j]
                            for a in range(n):
                                if not near:
                                    break
                                away = abs(q[to, j, a] - before[b, j0, a])
                                near = away <= step[a] + slack[to, j, a] + slack_before[b, j0, a]
                                total -= price * away * away
                            if near and total > value[to, j]:
                                value[to, j], back[to, j] = total, b * m0 + j0
                    if flips == 0:
                        break
                    flips = (flips - 1) & crossed[block]
