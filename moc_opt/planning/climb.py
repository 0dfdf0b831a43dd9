"""The best result of a local law, which climbs mu along the self-motion as fast as the joints can."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.numerics.arrays import Array
from moc_opt.planning.pose_map import Margin, PoseMap


def climb(found: PoseMap, step_rad: Array, start: Array, margin: Margin = 0.0) -> Array:
    """Follow the gradient of mu from the start, on the samples of the map.

    In each period the poses within the joints' steps are looked at; from the one that asks the least of the joints it
    goes uphill over neighbouring samples of its branch until mu falls, or a limit or the speed ends it.

    Args:
        step_rad: (n,) most that a joint turns in one period [rad].
        start: (n,) the pose to begin with [rad].
        margin: from the joint limits.

    Returns:
        (k,n) its poses, the start first; fewer than the path has times where no pose is within reach.
    """
    feasible, poses = found.feasible(margin), [np.array(start)]
    for k in range(1, len(found.targets)):
        q = found.poses(k)
        share = np.where(feasible[k], (np.abs(q - poses[-1]) / step_rad).max(axis=2), np.inf)
        b, j = (int(i) for i in np.unravel_index(int(np.argmin(share)), share.shape))
        if not share[b, j] <= 1.0:
            break
        poses.append(q[b, _uphill(found.mu[k, b], share[b] <= 1.0, j)[0]])
    return np.array(poses)


class Top(NamedTuple):
    """Where the way up from a pose ends."""

    mu: float
    """[m^3]"""
    q_rad: Array
    """(n,)"""
    at_limit: bool
    """Whether mu rises on, beyond a joint limit or the end of the known poses."""


def top_of(found: PoseMap, q: Array) -> Top | None:
    """Climb mu from the map's last pose next to q (n,), joint speeds aside; None where none is feasible then."""
    poses, may = found.poses(-1), found.feasible()[-1]
    if not may.any():
        return None
    away = np.where(may, np.abs(poses - q).sum(axis=2), np.inf)
    b, j = (int(i) for i in np.unravel_index(int(np.argmin(away)), away.shape))
    mu = found.mu[-1, b]
    top, side = _uphill(mu, may[b], j)
    return Top(float(mu[top]), poses[b, top], bool(mu[(top + side) % len(mu)] > mu[top]))


def _uphill(mu: Array, within: NDArray[np.bool_], j: int) -> tuple[int, int]:
    """Return the sample at which the climb from sample j ends, and the side, 1 or -1, to which it went."""
    side = 1 if _height(mu, within, j + 1) >= _height(mu, within, j - 1) else -1
    while _height(mu, within, j + side) > mu[j]:
        j = (j + side) % len(mu)
    return j, side


def _height(mu: Array, within: NDArray[np.bool_], j: int) -> float:
    j %= len(mu)
    return float(mu[j]) if within[j] else -np.inf
