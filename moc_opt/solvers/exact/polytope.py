"""Several freedoms: the best point of a box cut by the plane A x = b, as a projection.

Pi is the orthogonal projector on ker A, x_p the shortest point of the plane, s = x - x_p. Over the box,
rho/2 |x|^2 - c2 g^T x is smallest at the point nearest to s = c2 Pi g / rho. The dual active-set method of
Goldfarb and Idnani (Math. Programming 27, 1983, algorithm 1) goes there from that unconstrained optimum, adding
violated bounds one by one; it needs no feasible start and proves infeasibility. All it has to know is Pi swept on
the active joints (Goodnight, The American Statistician 33, 1979): row p then says how the other joints yield when
joint p is pushed, and how the active bounds' multipliers change. For rho = 0 the proximal point iteration
(finite for linear programs: Ferris 1991) repeats the projection.

Pi and all else lie in one matrix M, see ``moc_opt.solvers.exact.projector``. Kernels are compiled into their caller,
as in ``moc_opt.solvers.exact.elimination``; the proximal point iteration is not.
"""

from __future__ import annotations

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.qp.equalities import offsets
from moc_opt.qp.layout import C2, RHO
from moc_opt.solvers.exact.elimination import EMPTY, OK, STUCK, Plane, X, direction, inlined
from moc_opt.solvers.exact.elimination import FORCE as TOTAL
from moc_opt.solvers.exact.projector import (
    BEFORE,
    FORCE,
    HIGH,
    LOW,
    PI,
    PULL,
    SIDE,
    SIZE,
    STEP,
    TARGET,
    S,
    along,
    onto_basis,
    orthogonalise,
    projector,
    sweep,
)

NEAR = 10.0  # box widths within which the way to the optimum leaves no rounding worth taking out
FAR = 1e3  # box widths beyond which the unconstrained optimum is approached in proximal steps
UNMOVED = 1e-26  # Pi[j, j], the square of how far joint j goes on a step of length one: below it, it does not
DELICATE = 1e-6  # of Pi[j, j]: pushing a joint with less than that left by the active ones makes rounding show
DEPENDENT = 1e-12  # of Pi[j, j]: with no more than that left by them, joint j cannot be pushed


@inlined
def settle(M: Array, n: int, m: int, r: int) -> None:
    """Take the rounding of the way out of s: back into ker A, and the active joints onto their bounds."""
    onto_basis(M, n, m, r, S, STEP, 1.0)
    for c in range(m):
        M[S, c] = M[STEP, c]
    for a in range(n):
        if M[SIDE, a] != 0.0:
            bound = M[LOW, a] if M[SIDE, a] > 0.0 else M[HIGH, a]
            gap = bound - M[STEP, a]
            for c in range(m):
                M[S, c] += gap * (1.0 - abs(M[SIDE, c])) * M[PI + a, c]
            M[S, a] = bound


@inlined
def furthest_out(M: Array, m: int, tolerance: float) -> int:
    """Return the joint that is furthest beyond its bounds; -1 where none is by more than the tolerance."""
    joint, most = -1, tolerance
    for c in range(m):
        below, over = M[LOW, c] - M[S, c], M[S, c] - M[HIGH, c]
        beyond = below if below > over else over
        joint, most = (c, beyond) if beyond > most else (joint, most)
    return joint


@inlined
def first_to_let_go(M: Array, m: int, p: int, side: float) -> tuple[int, float]:
    """Return the active bound whose multiplier vanishes first when joint p is pushed, and after how much push."""
    joint, step = -1, np.inf
    for c in range(m):
        fading = side * M[SIDE, c] * M[PI + p, c]
        until = abs(M[FORCE, c]) / fading if fading > 1e-12 else np.inf
        joint, step = (c, until) if until < step else (joint, step)
    return joint, step


@inlined
def project(M: Array, n: int, m: int, r: int, tolerance: float, far: bool) -> int:
    """Move s to the nearest point of LOW <= s <= HIGH along the r dimensions of Pi, which is not swept yet.

    Afterwards s - s_start = Pi FORCE; FORCE is above zero at a lower bound, below at an upper one, zero elsewhere.
    Where the start is ``far``, the rounding of the way is taken out at the end.
    Returns OK, EMPTY where no s is within its bounds by ``tolerance``, or STUCK.
    """
    count = 0
    for c in range(m):
        M[FORCE, c] = M[SIDE, c] = 0.0
    for _ in range(20 * n):
        p = furthest_out(M, m, tolerance)
        if p < 0:
            if far:
                settle(M, n, m, r)
            return OK
        side = 1.0 if M[S, p] < M[LOW, p] else -1.0
        bound = M[LOW, p] if side > 0.0 else M[HIGH, p]
        while True:
            # How far joint p can be pushed: until an active bound lets go (step), or until it is there (full).
            drop, step = first_to_let_go(M, m, p, side)
            full, gives = np.inf, M[PI + p, p]
            if count < r and gives > DEPENDENT * M[SIZE, p]:
                full = side * (bound - M[S, p]) / gives
            elif drop < 0:
                return EMPTY
            length = side * min(step, full)
            move = length if full < np.inf else 0.0
            for c in range(m):
                push, active = M[PI + p, c], abs(M[SIDE, c])
                M[FORCE, c] -= length * active * push
                M[S, c] += move * (1.0 - active) * push
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


@inlined
def nearest(M: Array, n: int, m: int, r: int, slack: float, tolerance: float, far: bool) -> int:
    """Do as ``project``, to within the slack; where rounding decides if there is such a point, a tenth of it.

    The plane may touch the box in one point only.
    """
    for c in range(m):
        M[TARGET, c] = M[S, c]
    while True:
        status = project(M, n, m, r, slack, far)
        if status != EMPTY or slack >= 0.1 * tolerance:
            return status
        slack = 0.1 * tolerance
        projector(M, n, m, r)
        for c in range(m):
            M[S, c] = M[TARGET, c]


@njit(cache=True, nogil=True, error_model="numpy")
def approach(
    M: Array, n: int, m: int, r: int, rho: float, slack: float, tolerance: float, base: float
) -> tuple[int, float]:
    """Run the proximal point iteration from a point of the box: status, and the weight of the multipliers."""
    # Long steps first: they also travel where the cost is almost flat. The short one at the end stays
    # at the vertex and takes the rounding of the long ones out.
    status, weight = OK, 0.0
    for scale in (1e8, 1e4, 1.0):
        step = scale * base
        for _ in range(50):
            for c in range(m):
                M[BEFORE, c] = M[S, c]
                M[S, c] = (M[S, c] + step * M[PULL, c]) / (1.0 + rho * step)
            projector(M, n, m, r)
            status = nearest(M, n, m, r, slack * max(1.0, 1e-3 * scale), tolerance, True)
            weight = rho + 1.0 / step
            moved = 0.0
            for c in range(m):
                if status != OK:  # there is a point in the box, but its rounding is too large from here
                    M[S, c] = M[BEFORE, c]
                moved = max(moved, abs(M[S, c] - M[BEFORE, c]))
            if moved <= slack * scale:
                break
    return OK if status == OK else STUCK, weight


@inlined
def maximise_over_box(plane: Plane, rank: int, r: int, V: Array, row: Array, tolerance: float) -> int:
    """Move row X of V along the plane to the optimum; the active bounds' multipliers are added to row TOTAL.

    Args:
        plane: eliminated; its r free joints move tip or wrist.
        V: X is any point of the plane; joints that do not move along it stay.
        row: flat record (10 n + 10,).
        tolerance: violation of the box that still counts as feasible [rad/s].
    """
    n, m = plane.n, plane.m
    at = offsets(n)
    c2, rho = row[at.weights + C2], row[at.weights + RHO]
    M = np.empty((PI + n + r, m))
    for k in range(r):
        direction(plane, rank, plane.order[rank + k], M, PI + n + k)
    orthogonalise(M, n, m, r)
    projector(M, n, m, r)
    for c in range(m):
        M[S, c], M[STEP, c], M[SIZE, c] = V[X, c], 0.0, 0.0
    for j in range(n):
        M[STEP, j], M[SIZE, j] = row[at.grad_mu + j], M[PI + j, j]
    onto_basis(M, n, m, r, S, BEFORE, 1.0)
    onto_basis(M, n, m, r, STEP, PULL, c2)
    pull, room = np.sqrt(along(M, m, PULL, PULL)), 0.0
    for c in range(m):
        M[LOW, c], M[HIGH, c] = -np.inf, np.inf
    for j in range(n):
        V[X, j] -= M[BEFORE, j]
        if M[SIZE, j] > UNMOVED:
            lower, upper = row[at.lower + j], row[at.upper + j]
            M[LOW, j], M[HIGH, j] = lower - V[X, j], upper - V[X, j]
            room = max(room, upper - lower)
    direct = rho > 0.0 and pull <= FAR * room * rho
    slack = 1e-14 * max(1.0, room)
    for c in range(m):
        M[S, c] = M[PULL, c] / rho if direct else 0.0
    status, weight = nearest(M, n, m, r, slack, tolerance, not direct or pull > NEAR * room * rho), rho
    if not direct:
        weight = 0.0
        if status == OK and pull > 0.0:
            status, weight = approach(M, n, m, r, rho, slack, tolerance, 10.0 * max(room, 1e-6) / pull)
    for c in range(m):
        V[X, c] += M[S, c]
        V[TOTAL, c] += weight * M[FORCE, c]
    return status
