"""Compiled kernels of the dynamic programming: the best way into every pose of one time from those before it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit

BLOCK = 16
"""Poses beside each other that are passed over together where their box is out of reach."""


@njit(cache=True, nogil=True)
def boxes(q: Array, slack: Array) -> tuple[Array, Array]:
    """Return the least and the largest of each joint, (b,blocks,n) each, of poses (b,m,n) and their slack."""
    branches, m, n = q.shape
    blocks = (m + BLOCK - 1) // BLOCK
    low, high = np.full((branches, blocks, n), math.inf), np.full((branches, blocks, n), -math.inf)
    for b in range(branches):
        for j in range(m):
            if not np.isnan(q[b, j, 0]):
                for a in range(n):
                    low[b, j // BLOCK, a] = min(low[b, j // BLOCK, a], q[b, j, a] - slack[b, j, a])
                    high[b, j // BLOCK, a] = max(high[b, j // BLOCK, a], q[b, j, a] + slack[b, j, a])
    return low, high


@njit(cache=True, nogil=True)
def out_of_reach(low: Array, high: Array, pose: Array, slack: Array, step: Array) -> bool:
    """Return whether a box (n,), (n,) is farther than a step and the slack (n,) from a pose, beyond rounding."""
    for a in range(pose.shape[0]):
        way = (step[a] + slack[a]) * (1.0 + 1e-9) + 1e-12
        if not (low[a] <= pose[a] + way and pose[a] - way <= high[a]):
            return True
    return False


@njit(cache=True, nogil=True)
def advance(
    q_before: Array, slack_before: Array, value_before: Array, q: Array, slack: Array, gain: Array,
    step: Array, crossing: NDArray[np.int64], worst: bool, value: Array, back: NDArray[np.int32],
) -> None:
    """Fill value (b,m) and back (b,m): where the pose before it stands, flat in (b,m0); -1: it cannot be reached.

    A pose is reached from one if no joint turns by more than its step between them, the slack of both poses added;
    from its own branch, or from one next to it near a singular pose.

    Args:
        q_before: (b,m0,n) poses of the time before [rad], NaN where there is none.
        slack_before: (b,m0,n) [rad].
        value_before: (b,m0) of the best way there; -inf: none.
        q, slack: (b,m,n); gain: (b,m) what the pose adds; -inf: forbidden.
        step: (n,) most that a joint turns in one period [rad].
        crossing: (m,) bits of the branch's number that may be others at the time before.
        worst: the value is the least gain on the way, in place of their sum.
    """  # fmt: skip
    branches, m, n = q.shape
    m0 = q_before.shape[1]
    low, high = boxes(q_before, slack_before)
    blocks = low.shape[1]
    most = np.full((branches, blocks), -math.inf)
    for b in range(branches):
        for j0 in range(m0):
            most[b, j0 // BLOCK] = max(most[b, j0 // BLOCK], value_before[b, j0])
    for b in range(branches):
        for j in range(m):
            value[b, j], back[b, j] = -math.inf, -1
            if gain[b, j] == -math.inf:
                continue
            best, at = -math.inf, -1
            flips = crossing[j]
            while True:  # over all subsets of the bits, the empty one last
                b0 = b ^ flips
                for block in range(blocks):
                    if not most[b0, block] > best:
                        continue
                    if out_of_reach(low[b0, block], high[b0, block], q[b, j], slack[b, j], step):
                        continue
                    for j0 in range(block * BLOCK, min(m0, (block + 1) * BLOCK)):
                        if not value_before[b0, j0] > best:
                            continue
                        near = True
                        for a in range(n):
                            away = abs(q[b, j, a] - q_before[b0, j0, a])
                            if not away <= step[a] + slack[b, j, a] + slack_before[b0, j0, a]:
                                near = False
                                break
                        if near:
                            best, at = value_before[b0, j0], b0 * m0 + j0
                if flips == 0:
                    break
                flips = (flips - 1) & crossing[j]
            if at >= 0:
                back[b, j] = at
                value[b, j] = min(best, gain[b, j]) if worst else best + gain[b, j]


@njit(cache=True, nogil=True)
def nearest_share(
    q_before: Array, from_: NDArray[np.bool_], q: Array, to: NDArray[np.bool_], step: Array
) -> tuple[float, int]:
    """Find the smallest share of the joints' steps from any pose of one time to any of the next, and its joint.

    Args:
        q_before, from_: (b,m0,n) poses and (b,m0) which of them count.
        q, to: (b,m,n) and (b,m) likewise.
        step: (n,) [rad].
    """
    least, joint = math.inf, -1
    for b in range(q.shape[0]):
        for j in range(q.shape[1]):
            if not to[b, j]:
                continue
            for j0 in range(q_before.shape[1]):
                if not from_[b, j0]:
                    continue
                share, which = 0.0, 0
                for a in range(step.shape[0]):
                    part = abs(q[b, j, a] - q_before[b, j0, a]) / step[a]
                    if part > share:
                        share, which = part, a
                if share < least:
                    least, joint = share, which
    return least, joint
