"""The equalities of one subproblem eliminated, and the closed form where one freedom (the elbow swivel) is left.

W = [A | b] is held column by column, six numbers each, so that every row operation is the same six steps on each
column. All kernels follow Golub and Van Loan, Matrix Computations, 3.4.8 (complete pivoting) and take numbers as
they are: a division by zero gives infinity, as numpy's does.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

PIVOT_TOLERANCE = 1e-12  # relative to the largest pivot: below it a row repeats the others
IDLE_COLUMN = 1e-14  # a free column smaller than this moves neither tip nor wrist

OK, EMPTY, STUCK = 0, 1, 2


@njit(cache=True, nogil=True, error_model="numpy")
def eliminate(W: Array, n: int, order: Indices) -> int:
    """Gauss-Jordan with complete pivoting on the columns of [A | b] in W (6 (n + 2),), in place; returns the rank.

    Row k of the result reads x[order[k]] + sum_free W[6 j + k] x[j] = W[6 n + k]; the free columns are order[rank:],
    ascending. The pivots' own columns, which would be those of the identity, hold the row operations instead, as in
    an inversion in place: W[6 order[m] + k] is what row order[n + m] of A contributed to row k. The last
    six numbers of W are scratch.
    """
    for j in range(n):
        order[j] = j
    for i in range(6):
        order[n + i] = i
    first, largest = 0.0, 6 * n + 6
    for k in range(6):
        # The largest entry of each row without a branch (its guess would be wrong too often), then the place.
        for i in range(6):
            W[largest + i] = 0.0
        for p in range(k, n):
            column = 6 * order[p]
            for i in range(6):
                entry = abs(W[column + i])
                W[largest + i] = entry if entry > W[largest + i] else W[largest + i]
        size, row, place = W[largest + k], k, k
        for i in range(k + 1, 6):
            if W[largest + i] > size:
                size, row = W[largest + i], i
        if k == 0:
            first = size
        if size <= PIVOT_TOLERANCE * first:
            return k
        while abs(W[6 * order[place] + row]) != size:
            place += 1
        pivot = order[place]
        for p in range(place, k, -1):
            order[p] = order[p - 1]
        order[k] = pivot
        if row != k:
            order[n + k], order[n + row] = order[n + row], order[n + k]
            for j in range(n + 1):
                W[6 * j + k], W[6 * j + row] = W[6 * j + row], W[6 * j + k]
        column = 6 * pivot
        f0, f1, f2, f3, f4, f5 = (
            W[column], W[column + 1], W[column + 2], W[column + 3], W[column + 4], W[column + 5],
        )  # fmt: skip
        inverse = 1.0 / W[column + k]
        for i in range(6):
            W[column + i] = 0.0
        W[column + k] = 1.0  # of the identity beside A, which is not stored
        for j in range(n + 1):
            c = 6 * j
            t = W[c + k] * inverse
            W[c] -= f0 * t
            W[c + 1] -= f1 * t
            W[c + 2] -= f2 * t
            W[c + 3] -= f3 * t
            W[c + 4] -= f4 * t
            W[c + 5] -= f5 * t
            W[c + k] = t
    return 6


@njit(cache=True, nogil=True, error_model="numpy")
def swivel(
    W: Array, n: int, rank: int, order: Indices, row: Array, tolerance: float, x: Array, w: int
) -> int:
    """One freedom: x + s z with z[free] = 1; the ratio test gives the interval of s, then its best point.

    Args:
        W, order: as `eliminate` leaves them; order[rank] is the joint that is left.
        row: flat record (10 n + 10,).
        x: (n,) particular solution, moved to the optimum.
        w: where in W the n numbers P x + p + A^T y stand; the active bound's is written.
    """
    g, lo, up = 6 * n + 6, 7 * n + 6, 8 * n + 6
    c2, rho = row[9 * n + 8], row[9 * n + 9]
    free = order[rank]
    low, high = row[lo + free], row[up + free]
    low_joint, high_joint = free, free
    zz, zx, zg = 1.0, 0.0, row[g + free]
    for k in range(rank):
        j = order[k]
        z = -W[6 * free + k]
        zz += z * z
        zx += z * x[j]
        zg += z * row[g + j]
        if abs(z) <= IDLE_COLUMN:
            continue
        at_lower, at_upper = (row[lo + j] - x[j]) / z, (row[up + j] - x[j]) / z
        if z < 0.0:
            at_lower, at_upper = at_upper, at_lower
        if at_lower > low:
            low, low_joint = at_lower, j
        if at_upper < high:
            high, high_joint = at_upper, j
    if low > high + tolerance:
        return EMPTY
    if rho > 0.0:
        best = (c2 * zg - rho * zx) / (rho * zz)
    elif c2 * zg != 0.0:
        best = np.inf if zg > 0.0 else -np.inf
    else:
        best = -zx / zz  # every point is optimal: take the slowest
    joint = -1
    if best > high:
        best, joint = high, high_joint
    elif best < low:
        best, joint = low, low_joint
    x[free] = best
    slope = rho * best - c2 * row[g + free]
    lever = 1.0
    for k in range(rank):
        j = order[k]
        z = -W[6 * free + k]
        x[j] += best * z
        slope += z * (rho * x[j] - c2 * row[g + j])
        if j == joint:
            lever = z
    if joint >= 0:
        W[w + joint] = slope / lever
    return OK
