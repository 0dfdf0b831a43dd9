"""Several freedoms: the best point of a box cut by the plane A x = b, as a projection.

Pi is the orthogonal projector on ker A, x_p the shortest point of the plane, s = x - x_p. Over the box,
damping/2 |x|^2 - c2 g^T x is smallest at the point nearest to s = c2 Pi g / damping. The dual active-set method of
Goldfarb and Idnani (Math. Programming 27, 1983, algorithm 1) goes there from that unconstrained optimum, adding
violated bounds one by one; it needs no feasible start and proves infeasibility. For damping = 0 the proximal point
iteration (finite for linear programs: Ferris 1991) repeats the projection.

All numbers lie in one array M, a row of n each: views into it would cost more than the arithmetic on them. Below the
rows that are named here come Pi (n rows from PI on) and the factor L (r + 1 rows from PI + n on) of Pi over the
active joints, whose diagonal holds reciprocals: a division there would be waited for at every step.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

OK, EMPTY, STUCK = 0, 1, 2
NEAR = 10.0  # box widths within which the way to the optimum leaves no rounding worth taking out
FAR = 1e3  # box widths beyond which the unconstrained optimum is approached in proximal steps
UNMOVED = 1e-26  # Pi[j, j], the square of how far joint j goes on a step of length one: below it, it does not

S, LOW, HIGH, PULL = 0, 1, 2, 3  # s and its bounds [rad/s]; c2 Pi g
SIDE, FORCE = 4, 5  # +1 at an active lower bound, -1 at an upper one; multiplier of that bound
D, BACK, PRESSURE = 6, 7, 8  # a step and its price, see `steer`; size of the active joints' multipliers
BEFORE = 9
PI = 10


@njit(cache=True, nogil=True, error_model="numpy")
def projector(M: Array, n: int, r: int) -> None:
    """Pi = Z^T Z after Gram-Schmidt on the r rows of Z, which stand where L will be."""
    Z = PI + n
    for c in range(Z, Z + r):
        for b in range(Z, c):
            along = 0.0
            for j in range(n):
                along += M[b, j] * M[c, j]
            for j in range(n):
                M[c, j] -= along * M[b, j]
        square = 0.0
        for j in range(n):
            square += M[c, j] * M[c, j]
        scale = 1.0 / np.sqrt(square)
        for j in range(n):
            M[c, j] *= scale
    for i in range(n):
        for j in range(n):
            M[PI + i, j] = M[Z, i] * M[Z, j]
        for c in range(Z + 1, Z + r):
            for j in range(n):
                M[PI + i, j] += M[c, i] * M[c, j]


@njit(cache=True, nogil=True, error_model="numpy")
def extend(M: Array, n: int, active: Indices, k: int, p: int) -> None:
    """Row k of L, without its diagonal, for joint p beside the first k active ones."""
    L = PI + n
    for i in range(k):
        total = M[PI + p, active[i]]
        for c in range(i):
            total -= M[L + i, c] * M[L + k, c]
        M[L + k, i] = total * M[L + i, i]


@njit(cache=True, nogil=True, error_model="numpy")
def solve_transposed(M: Array, n: int, k: int, source: int, target: int) -> None:
    """Solve L^T target = source for k numbers; both are rows of M."""
    L = PI + n
    for i in range(k - 1, -1, -1):
        total = M[source, i]
        for c in range(i + 1, k):
            total -= M[L + c, i] * M[target, c]
        M[target, i] = total * M[L + i, i]


@njit(cache=True, nogil=True, error_model="numpy")
def steer(M: Array, n: int, active: Indices, k: int, p: int) -> None:
    """Split Pi e_p into the step D, which moves none of the k active joints, and BACK times their columns of Pi."""
    extend(M, n, active, k, p)
    solve_transposed(M, n, k, PI + n + k, BACK)
    for j in range(n):
        M[D, j] = M[PI + p, j]
    for i in range(k):
        for j in range(n):
            M[D, j] -= M[BACK, i] * M[PI + active[i], j]


@njit(cache=True, nogil=True, error_model="numpy")
def let_go(M: Array, n: int, active: Indices, k: int, drop: int) -> None:
    """Strike number ``drop`` out of the k active joints, and factorise again from there on."""
    L = PI + n
    M[SIDE, active[drop]] = 0.0
    for i in range(drop, k - 1):
        active[i], M[PRESSURE, i] = active[i + 1], M[PRESSURE, i + 1]
        extend(M, n, active, i, active[i])
        square = M[PI + active[i], active[i]]
        for c in range(i):
            square -= M[L + i, c] * M[L + i, c]
        M[L + i, i] = 1.0 / np.sqrt(max(square, 1e-300))


@njit(cache=True, nogil=True, error_model="numpy")
def settle(M: Array, n: int, active: Indices, k: int) -> None:
    """Take the rounding of a long way out of s: back into ker A, and the k active joints onto their bounds."""
    L = PI + n
    for i in range(n):
        M[D, i] = 0.0
        for j in range(n):
            M[D, i] += M[PI + i, j] * M[S, j]
    for j in range(n):
        M[S, j] = M[D, j]
    for i in range(k):
        j = active[i]
        gap = (M[LOW, j] if M[SIDE, j] > 0.0 else M[HIGH, j]) - M[S, j]
        for c in range(i):
            gap -= M[L + i, c] * M[D, c]
        M[D, i] = gap * M[L + i, i]
    solve_transposed(M, n, k, D, BACK)
    for i in range(k):
        for j in range(n):
            M[S, j] += M[BACK, i] * M[PI + active[i], j]


@njit(cache=True, nogil=True, error_model="numpy")
def project(M: Array, n: int, r: int, active: Indices, tolerance: float, far: bool) -> int:
    """Move s to the nearest point of LOW <= s <= HIGH along the r dimensions of Pi.

    Afterwards s - s_start = Pi FORCE; FORCE is above zero at a lower bound, below at an upper one, zero elsewhere.
    Where the start is ``far``, the rounding of the way is taken out at the end.
    Returns OK, EMPTY where no s is within its bounds by ``tolerance``, or STUCK.
    """
    k = 0
    for j in range(n):
        M[FORCE, j] = M[SIDE, j] = 0.0
    for _ in range(20 * n):
        p, worst, side = -1, tolerance, 0.0
        for j in range(n):
            if M[SIDE, j] == 0.0 and M[PI + j, j] > UNMOVED:
                if M[LOW, j] - M[S, j] > worst:
                    p, worst, side = j, M[LOW, j] - M[S, j], 1.0
                if M[S, j] - M[HIGH, j] > worst:
                    p, worst, side = j, M[S, j] - M[HIGH, j], -1.0
        if p < 0:
            if far:
                settle(M, n, active, k)
            for i in range(k):
                M[FORCE, active[i]] = M[SIDE, active[i]] * M[PRESSURE, i]
            return OK
        own = 0.0
        while True:
            steer(M, n, active, k, p)
            drop, step = -1, np.inf
            for i in range(k):
                fading = side * M[SIDE, active[i]] * M[BACK, i]
                if fading > 1e-12 and M[PRESSURE, i] < step * fading:
                    drop, step = i, M[PRESSURE, i] / fading
            full = np.inf
            if k < r and M[D, p] > 1e-12 * M[PI + p, p]:
                full = (M[LOW, p] - M[S, p] if side > 0.0 else M[S, p] - M[HIGH, p]) / M[D, p]
            if drop < 0 and full == np.inf:
                return EMPTY
            length = side * min(step, full)
            if full < np.inf:
                for j in range(n):
                    M[S, j] += length * M[D, j]
            for i in range(k):
                M[PRESSURE, i] -= length * M[SIDE, active[i]] * M[BACK, i]
            own += min(step, full)
            if full <= step:
                M[PI + n + k, k] = 1.0 / np.sqrt(M[D, p])
                active[k], M[PRESSURE, k], M[SIDE, p] = p, own, side
                k += 1
                break
            let_go(M, n, active, k, drop)
            k -= 1
    return STUCK


@njit(cache=True, nogil=True, error_model="numpy")
def maximise_over_box(
    W: Array, n: int, rank: int, order: Indices, r: int, row: Array, x: Array, w: int
) -> int:
    """Move x (n,) along the plane to the optimum.

    Args:
        W, order: as ``elimination.eliminate`` leaves them, the r free joints that move tip or wrist first.
        row: flat record (10 n + 10,).
        x: any point of the plane; joints that do not move along it stay.
        w: where in W the n numbers P x + p + A^T y stand; the active bounds' multipliers are added.
    """
    g, lo, up = 6 * n + 6, 7 * n + 6, 8 * n + 6
    c2, rho = row[9 * n + 8], row[9 * n + 9]
    M, active = np.empty((PI + n + r + 1, n)), np.empty(r, dtype=np.int64)
    for c in range(r):
        free, z = order[rank + c], PI + n + c
        for j in range(n):
            M[z, j] = 0.0
        M[z, free] = 1.0
        for k in range(rank):
            M[z, order[k]] = -W[6 * free + k]
    projector(M, n, r)
    largest, width = 0.0, 0.0
    for i in range(n):
        along, uphill = 0.0, 0.0
        for j in range(n):
            along += M[PI + i, j] * x[j]
            uphill += M[PI + i, j] * row[g + j]
        M[BEFORE, i], M[PULL, i] = along, c2 * uphill
        largest += M[PULL, i] * M[PULL, i]
        if M[PI + i, i] > UNMOVED:
            width = max(width, row[up + i] - row[lo + i])
    for j in range(n):
        x[j] -= M[BEFORE, j]
        M[LOW, j], M[HIGH, j], M[S, j] = row[lo + j] - x[j], row[up + j] - x[j], 0.0
    largest = np.sqrt(largest)
    small, weight = 1e-14 * max(1.0, width), rho
    if rho > 0.0 and largest <= FAR * width * rho:
        for j in range(n):
            M[S, j] = M[PULL, j] / rho
        status = project(M, n, r, active, small, largest > NEAR * width * rho)
    else:
        status = project(M, n, r, active, small, True)
        weight = 0.0
        base = 10.0 * max(width, 1e-6) / largest if largest > 0.0 else 0.0
        # Long steps first: they also travel where the cost is almost flat. The short one at the end stays
        # at the vertex and takes the rounding of the long ones out.
        for scale in (1e8, 1e4, 1.0):
            step = scale * base
            for _ in range(50):
                if status != OK or step == 0.0:
                    break
                for j in range(n):
                    M[BEFORE, j] = M[S, j]
                    M[S, j] = (M[S, j] + step * M[PULL, j]) / (1.0 + rho * step)
                status = project(M, n, r, active, small * max(1.0, 1e-3 * scale), True)
                weight = rho + 1.0 / step
                moved = 0.0
                for j in range(n):
                    moved = max(moved, abs(M[S, j] - M[BEFORE, j]))
                if moved <= small * scale:
                    break
    for j in range(n):
        x[j] += M[S, j]
        W[w + j] += weight * M[FORCE, j]
    return status
