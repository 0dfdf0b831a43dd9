"""Dynamic programming over the map: the best course within joint limits and joint speeds, and a bound on any course.

At time k the value of a pose is the best of the values of the poses from which it can be reached in one period, plus
(mean mu, mean log mu) or at most (worst mu) its own: F_k(p) = g_k(p) + max F_{k-1}(p'), |q - q'| <= v_max dt for every
joint. From a singular pose a course may go on in another branch: the joints tell which is next to it.

The bound searches the same map made generous: every pose stands for the half cell around it, so it is allowed where a
neighbour is, as good as the best nearby, and its joints get half a cell more of way. Any course whose poses lie on the
curves that the map samples stays within that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moc_opt.numerics.arrays import Array
from moc_opt.planning.course import LEAST_MU, Objective, weights
from moc_opt.planning.pose_map import Margin, PoseMap
from moc_opt.planning.search_kernels import advance

CURVED = 1.1
"""Factor on a joint's way in half a cell and on the higher differences of mu, for what lies between the samples."""


@dataclass(frozen=True, eq=False)
class Search:
    """The result of a search over the map."""

    value: float
    """Of the best course, in the objective's unit; -inf: there is none."""
    reached: int
    """Number of times, from the first one on, that some course gets to."""
    q_rad: Array | None
    """(k,n) poses of the best course; None where none goes all the way."""
    last: NDArray[np.bool_]
    """(b,m) the poses that are reached at the last time reached."""


def search(
    found: PoseMap,
    step_rad: Array,
    objective: Objective = "mean",
    *,
    start: tuple[Array, float] | None = None,
    margin: Margin = 0.0,
    generous: bool = False,
    floor: float = -np.inf,
) -> Search:
    """Find the best course.

    Args:
        step_rad: (n,) most that a joint turns in one period [rad].
        objective: "mean" mu, "worst" mu, or the mean of "log" mu. Of all courses with the largest worst mu (to
            rounding) the one with the best mean is taken.
        start: the pose (n,) to begin with [rad] and its mu [m^3]; None: any pose of the first time.
        margin: from the joint limits.
        generous: search for the bound.
        floor: poses with a smaller mu are forbidden [m^3].
    """
    if objective == "worst" and not generous and floor == -np.inf:
        # Nothing is forbidden yet: mu that was lowered (`shaft.keeping_shaft`) may be far below zero.
        least = search(found, step_rad, "worst", start=start, margin=margin, floor=-np.finfo(np.float64).max)
        if least.q_rad is None:
            return least
        best = search(found, step_rad, "mean", start=start, margin=margin, floor=least.value - 1e-12)
        return Search(least.value, best.reached, best.q_rad, best.last)
    count, worst = len(found.targets), objective == "worst"
    weight = np.ones(count) if worst else weights(count)
    feasible, mu = found.feasible(margin), found.mu
    if generous:
        feasible, mu = _dilated(feasible), _highest_nearby(mu)
    gain = np.where(feasible & (mu >= floor), gain_of(mu, objective) * weight[:, None, None], -np.inf)
    before, value = found.poses(0), gain[0]
    last = np.isfinite(value)
    if start is not None:  # one pose in every branch of the first time; the joint steps tell which branch it is in
        own = float(gain_of(np.array(start[1]), objective)) * weight[0]
        before, value = np.tile(start[0], (gain.shape[1], 1, 1)), np.full((gain.shape[1], 1), own)
        last = np.zeros(gain.shape[1:], dtype=np.bool_)
    elif not last.any():
        return Search(-np.inf, 0, None, last)
    slack_before = _slack(before, generous and start is None)
    back = np.full(gain.shape, -1, dtype=np.int32)
    for k in range(1, count):
        q, value_before, value = found.poses(k), np.ascontiguousarray(value), np.empty(gain.shape[1:])
        slack = _slack(q, generous)
        advance(
            before, slack_before, value_before, q, slack, np.ascontiguousarray(gain[k]), step_rad,
            found.crossing(k, step_rad), worst, value, back[k],
        )  # fmt: skip
        if not np.isfinite(value).any():
            return Search(-np.inf, k, None, last)
        before, slack_before, last = q, slack, np.isfinite(value)
    b, j = np.unravel_index(int(np.argmax(value)), value.shape)
    total = float(value[b, j]) if worst else float(value[b, j]) / float(weight.sum())
    return Search(total, count, _course(found, back, int(b), int(j), None if start is None else start[0]), last)


def gain_of(mu: Array, objective: Objective) -> Array:
    """Return what a pose of that mu [m^3] adds to a course's value."""
    with np.errstate(invalid="ignore"):
        return np.log(np.maximum(mu, LEAST_MU)) if objective == "log" else mu


def _course(found: PoseMap, back: NDArray[np.int32], b: int, j: int, start: Array | None) -> Array:
    poses = []
    for k in range(len(back) - 1, 0, -1):
        poses.append(found.poses(k)[b, j])
        b, j = divmod(int(back[k, b, j]), back.shape[2] if k > 1 or start is None else 1)
    poses.append(found.poses(0)[b, j] if start is None else start)
    return np.array(poses[::-1])


def _slack(q: Array, generous: bool) -> Array:
    return CURVED * half_cells(q) if generous else np.zeros_like(q)


def half_cells(q: Array) -> Array:
    """Return (b,m,n) way of each joint within half a cell to either side of poses (b,m,n) [rad]."""
    apart = np.abs(np.mod(np.roll(q, -1, axis=1) - q + np.pi, 2.0 * np.pi) - np.pi)
    return 0.5 * np.nan_to_num(np.fmax(apart, np.roll(apart, 1, axis=1)))


def _dilated(feasible: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return feasible | np.roll(feasible, 1, axis=2) | np.roll(feasible, -1, axis=2)


def _highest_nearby(mu: Array) -> Array:
    """Return the largest mu within half a cell: the parabola through three poses, and what two more differences add.

    Stirling's interpolation at |s| <= 1/2: s (s^2 - 1)/6 of the third difference is at most 1/16 of it,
    s^2 (s^2 - 1)/24 of the fourth at most 1/128; the fifth is left to `CURVED`.
    """
    left, right = np.roll(mu, 1, axis=2), np.roll(mu, -1, axis=2)
    slope, bend = 0.5 * (right - left), left + right - 2.0 * mu
    edge = mu + 0.5 * np.abs(slope) + 0.125 * bend
    third = 0.5 * np.abs(np.roll(bend, -1, axis=2) - np.roll(bend, 1, axis=2))
    fourth = np.abs(np.roll(bend, -1, axis=2) + np.roll(bend, 1, axis=2) - 2.0 * bend)
    with np.errstate(invalid="ignore", divide="ignore"):
        top = np.where((bend < 0.0) & (np.abs(slope) <= -0.5 * bend), mu - 0.5 * slope**2 / bend, edge)
    nearby = np.maximum(edge, top) + CURVED * np.nan_to_num(third / 16.0 + fourth / 128.0)
    # beside a place without poses there is no parabola
    return np.fmax(mu, np.where(np.isnan(nearby), np.fmax(left, right), nearby))
