"""Several freedoms: the best point of a box cut by the plane A x = b, as a projection.

Pi is the orthogonal projector on ker A, x_p the shortest point of the plane, s = x - x_p. Over the box,
damping/2 |x|^2 - c2 g^T x is smallest at the point nearest to s = c2 Pi g / damping. The dual active-set method of
Goldfarb and Idnani (Math. Programming 27, 1983, algorithm 1) goes there from that unconstrained optimum, adding
violated bounds one by one; it needs no feasible start and proves infeasibility. All it has to know is Pi swept on
the active joints (Goodnight, The American Statistician 33, 1979): row p then says how the other joints yield when
joint p is pushed, and how the active bounds' multipliers change. For damping = 0 the proximal point iteration
(finite for linear programs: Ferris 1991) repeats the projection.

All numbers lie in one array M: views into it would cost more than the arithmetic on them. A row has n numbers and
zeros up to m, a multiple of four, so that four can be taken at a time without a rest. Below the rows that are named
here come Pi (n rows from PI on) and an orthogonal basis of ker A (r rows).
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
DELICATE = 1e-6  # of Pi[j, j]: after pushing a joint with less than that left by the active ones, rounding shows
DEPENDENT = 1e-12  # of Pi[j, j]: with no more than that left by them, joint j cannot be pushed

S, LOW, HIGH, PULL = 0, 1, 2, 3  # s and its bounds [rad/s]; c2 Pi g
SIDE, FORCE = 4, 5  # +1 at an active lower bound, -1 at an upper one, 0 elsewhere; multiplier of that bound
SIZE, INVERSE = 6, 7  # the diagonal of Pi; 1 / |z|^2 of every row z of the basis
STEP, BEFORE = 8, 9  # scratch for one kernel; what is kept over calls of several
PI = 10

FAST = {"reassoc", "contract", "nsz"}  # sums in any order, products added at once; NaN and infinity keep their meaning


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def orthogonalise(M: Array, n: int, m: int, r: int) -> None:
    """Gram-Schmidt on the r rows of the basis, without making them unit vectors."""
    Z = PI + n
    for c in range(r):
        square = 0.0
        for j in range(m):
            square += M[Z + c, j] * M[Z + c, j]
        M[INVERSE, c] = 1.0 / square
        for b in range(Z + c + 1, Z + r):
            along = 0.0
            for j in range(m):
                along += M[b, j] * M[Z + c, j]
            along *= M[INVERSE, c]
            for j in range(m):
                M[b, j] -= along * M[Z + c, j]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def projector(M: Array, n: int, m: int, r: int) -> None:
    """Pi = sum of z z^T / |z|^2 over the basis, not swept."""
    Z = PI + n
    for i in range(n):
        scale = M[Z, i] * M[INVERSE, 0]
        for j in range(m):
            M[PI + i, j] = scale * M[Z, j]
        for c in range(1, r):
            scale = M[Z + c, i] * M[INVERSE, c]
            for j in range(m):
                M[PI + i, j] += scale * M[Z + c, j]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def sweep(M: Array, n: int, m: int, p: int, sign: float) -> None:
    """Exchange joint p's s for its multiplier in Pi (sign 1), or back again (sign -1)."""
    inverse = 1.0 / M[PI + p, p]
    for j in range(m):
        M[STEP, j] = M[PI + p, j]
    for i in range(n):
        scale = M[STEP, i] * inverse
        for j in range(m):
            M[PI + i, j] -= scale * M[STEP, j]
    for j in range(n):
        M[PI + p, j] = M[PI + j, p] = sign * inverse * M[STEP, j]
    M[PI + p, p] = -inverse


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def settle(M: Array, n: int, m: int, r: int) -> None:
    """Take the rounding of the way out of s: back into ker A, and the active joints onto their bounds."""
    Z = PI + n
    for j in range(m):
        M[STEP, j] = 0.0
    for c in range(r):
        along = 0.0
        for j in range(m):
            along += M[Z + c, j] * M[S, j]
        along *= M[INVERSE, c]
        for j in range(m):
            M[STEP, j] += along * M[Z + c, j]
    for j in range(m):
        M[S, j] = M[STEP, j]
    for a in range(n):
        if M[SIDE, a] != 0.0:
            bound = M[LOW, a] if M[SIDE, a] > 0.0 else M[HIGH, a]
            gap = bound - M[STEP, a]
            for j in range(m):
                M[S, j] += gap * (1.0 - abs(M[SIDE, j])) * M[PI + a, j]
            M[S, a] = bound


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def project(M: Array, n: int, m: int, r: int, tolerance: float, far: bool) -> int:
    """Move s to the nearest point of LOW <= s <= HIGH along the r dimensions of Pi, which is not swept yet.

    Afterwards s - s_start = Pi FORCE; FORCE is above zero at a lower bound, below at an upper one, zero elsewhere.
    Where the start is ``far``, the rounding of the way is taken out at the end.
    Returns OK, EMPTY where no s is within its bounds by ``tolerance``, or STUCK.
    """
    count = 0
    for j in range(m):
        M[FORCE, j] = M[SIDE, j] = 0.0
    for _ in range(20 * n):
        p, worst = -1, tolerance
        for j in range(n):
            below, above = M[LOW, j] - M[S, j], M[S, j] - M[HIGH, j]
            beyond = below if below > above else above
            p = j if beyond > worst else p
            worst = beyond if beyond > worst else worst
        if p < 0:
            if far:
                settle(M, n, m, r)
            return OK
        side = 1.0 if M[S, p] < M[LOW, p] else -1.0
        bound = M[LOW, p] if side > 0.0 else M[HIGH, p]
        while True:
            # How far joint p can be pushed: until an active bound lets go (step), or until it is there (full).
            for j in range(n):
                fading = side * M[SIDE, j] * M[PI + p, j]
                M[STEP, j] = abs(M[FORCE, j]) / fading if fading > 1e-12 else np.inf
            drop, step = -1, np.inf
            for j in range(n):
                drop = j if M[STEP, j] < step else drop
                step = M[STEP, j] if M[STEP, j] < step else step
            full, gives = np.inf, M[PI + p, p]
            if count < r and gives > DEPENDENT * M[SIZE, p]:
                full = side * (bound - M[S, p]) / gives
            elif drop < 0:
                return EMPTY
            length = side * min(step, full)
            move = length if full < np.inf else 0.0
            for j in range(m):
                active = abs(M[SIDE, j])
                M[FORCE, j] -= length * active * M[PI + p, j]
                M[S, j] += move * (1.0 - active) * M[PI + p, j]
            M[FORCE, p] += length
            if full <= step:
                far |= gives < DELICATE * M[SIZE, p]
                sweep(M, n, m, p, 1.0)
                M[S, p], M[SIDE, p] = bound, side
                count += 1
                break
            M[FORCE, drop] = M[SIDE, drop] = 0.0
            count -= 1
            sweep(M, n, m, drop, -1.0)
    return STUCK


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
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
    m = (n + 3) // 4 * 4
    M, Z = np.empty((PI + n + r, m)), PI + n
    for c in range(r):
        free = order[rank + c]
        for j in range(m):
            M[Z + c, j] = 0.0
        M[Z + c, free] = 1.0
        for k in range(rank):
            M[Z + c, order[k]] = -W[6 * free + k]
    orthogonalise(M, n, m, r)
    projector(M, n, m, r)
    for j in range(m):
        M[BEFORE, j] = M[PULL, j] = M[S, j] = 0.0
    for c in range(r):
        along, uphill = 0.0, 0.0
        for j in range(n):
            along += M[Z + c, j] * x[j]
            uphill += M[Z + c, j] * row[g + j]
        along, uphill = M[INVERSE, c] * along, c2 * M[INVERSE, c] * uphill
        for j in range(m):
            M[BEFORE, j] += along * M[Z + c, j]
            M[PULL, j] += uphill * M[Z + c, j]
    largest, width = 0.0, 0.0
    for j in range(n):
        x[j] -= M[BEFORE, j]
        M[SIZE, j], M[LOW, j], M[HIGH, j] = M[PI + j, j], row[lo + j] - x[j], row[up + j] - x[j]
        largest += M[PULL, j] * M[PULL, j]
        if M[SIZE, j] > UNMOVED:
            width = max(width, row[up + j] - row[lo + j])
        else:
            M[LOW, j], M[HIGH, j] = -np.inf, np.inf
    largest = np.sqrt(largest)
    small, weight = 1e-14 * max(1.0, width), rho
    if rho > 0.0 and largest <= FAR * width * rho:
        for j in range(n):
            M[S, j] = M[PULL, j] / rho
        status = project(M, n, m, r, small, largest > NEAR * width * rho)
    else:
        status = project(M, n, m, r, small, True)
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
                projector(M, n, m, r)
                status = project(M, n, m, r, small * max(1.0, 1e-3 * scale), True)
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
