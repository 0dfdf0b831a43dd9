"""The equalities of one subproblem eliminated, and the closed form where one freedom (the elbow swivel) is left.

Kernels follow Golub and Van Loan, Matrix Computations, 3.4.8 (complete pivoting), and take numbers as they are: a
division by zero gives infinity, as numpy's does. Rows are padded with zeros to m numbers, a multiple of eight; kernels
are compiled into their caller, which knows m as a constant for up to 16 joints: no loop over a row is left then.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.qp.equalities import offsets
from moc_opt.qp.layout import C2, RHO
from moc_opt.qp.residuals import RANK_TOLERANCE, TIED

Indices = NDArray[np.int64]

inlined = njit(
    cache=True, nogil=True, error_model="numpy", forceinline=True, fastmath={"reassoc", "contract", "nsz"}
)
"""Compiled into its caller, where the width of a row is a constant; sums may be taken in any order."""

DOUBTFUL = 1e3  # a sixth pivot below this multiple of its tolerance is looked at more closely
LEFT = 1e-6  # |A x - b| that a dropped row may be left with [m/s]: the primal tolerance of the residual check
IDLE_COLUMN = 1e-14  # a free column smaller than this moves neither tip nor wrist

OK, EMPTY, STUCK = 0, 1, 2
OPEN, SPARE, B = 6, 7, 6  # row of W that has 1 for every row of A that is no pivot yet; scratch; place of b behind A
# Rows of V: x; how it moves along the plane; w = P x + p + A^T y; the largest entry of a column.
X, Z, FORCE, REACH = 0, 1, 2, 3


class Plane(NamedTuple):
    """A x = b while it is eliminated.

    Attributes:
        W: (8, m + 8) rows of A, and from column m on the row operations, the identity at first, and b.
        order: (n + 1,) pivot columns, then the free ones that move tip or wrist, ascending.
        pivots: (6,) rows of the pivots.
        n, m: joints; m is the multiple of eight that they fit into.
    """

    W: Array
    order: Indices
    pivots: Indices
    n: int
    m: int


@njit(cache=True, nogil=True, error_model="numpy")
def own_part(W: Array, n: int, m: int, row: Array) -> float:
    """Compute how much the last open row has of its own, in units of the tolerance on the sixth singular value.

    A pivot alone overstates that value, up to a hundredfold: the open row is e^T A with a long e, which the
    row operations hold. |e^T A| / |e| is what a singular value is the smallest of.
    """
    size, most = 0.0, 0.0
    for k in range(6 * n):
        size += row[k] * row[k]
    for i in range(6):
        if W[OPEN, i] > 0.0:
            length, operations = 0.0, 0.0
            for j in range(n):
                length += W[i, j] * W[i, j]
            for k in range(6):
                operations += W[i, m + k] * W[i, m + k]
            most = max(most, length / operations)
    return float(np.sqrt(most / size) / TIED)


@inlined
def eliminate(plane: Plane, row: Array) -> int:
    """Run Gauss-Jordan with complete pivoting on [A | b] of a flat record (10 n + 10,); returns the rank.

    The rank is -1 where a row is neither repeated nor independent: around the tolerances, where singular values and
    pivots may disagree.
    Afterwards row pivots[k] of W reads x[order[k]] + sum_free W[., j] x[j] = b, for k < rank.
    """
    W, n, m, at = plane.W, plane.n, plane.m, offsets(plane.n)
    for i in range(6):
        for c in range(m + 8):
            W[i, c] = 0.0
        for j in range(n):
            W[i, j] = row[i * n + j]
        W[i, m + i], W[i, m + B], W[OPEN, i] = 1.0, row[at.b + i], 1.0
    start = 0.0
    for k in range(6):
        for c in range(m):
            W[SPARE, c] = 0.0
        for i in range(6):
            for c in range(m):
                entry = abs(W[i, c]) * W[OPEN, i]
                W[SPARE, c] = entry if entry > W[SPARE, c] else W[SPARE, c]
        size, other, column, beside, pivot = 0.0, 0.0, 0, 0, 0
        for c in range(0, m, 2):  # in two halves, which need not wait for one another
            size, column = (W[SPARE, c], c) if W[SPARE, c] > size else (size, column)
            other, beside = (W[SPARE, c + 1], c + 1) if W[SPARE, c + 1] > other else (other, beside)
        size, column = (other, beside) if other > size else (size, column)
        start = size if k == 0 else start
        if not size > 30.0 * RANK_TOLERANCE * start:
            return k if k == 5 or not size > 0.1 * RANK_TOLERANCE * start else -1
        if k == 5 and size < TIED * DOUBTFUL * start:
            own = own_part(W, n, m, row)
            if own <= 10.0:
                return k if own <= 1.0 else -1
        for i in range(6):
            pivot = i if abs(W[i, column]) * W[OPEN, i] == size else pivot
        inverse = 1.0 / W[pivot, column]
        plane.order[k], plane.pivots[k], W[OPEN, pivot] = column, pivot, 0.0
        for c in range(m + 8):
            W[SPARE, c] = W[pivot, c]
        for i in range(6):
            scale = W[i, column] * inverse
            for c in range(m + 8):
                W[i, c] -= scale * W[SPARE, c]
        for c in range(m + 8):
            W[pivot, c] = W[SPARE, c] * inverse
    return 6


@njit(cache=True, nogil=True, error_model="numpy")
def contradicts(W: Array, n: int, m: int, i: int, row: Array, tolerance: float) -> bool:
    """Return whether no x in the box fulfils the dropped row i of W."""
    at = offsets(n)
    reach = tolerance
    for j in range(n):
        reach += abs(W[i, j]) * max(abs(row[at.lower + j]), abs(row[at.upper + j]))
    return bool(abs(W[i, m + B]) > reach)


@inlined
def left_over(plane: Plane, x: Array) -> float:
    """Compute |A x - b|_inf of the answer x (n,): the dropped rows are what is left of it."""
    W, most = plane.W, 0.0
    for i in range(6):
        if W[OPEN, i] > 0.0:
            gap = -W[i, plane.m + B]
            for j in range(plane.n):
                gap += W[i, j] * x[j]
            most = abs(gap) if abs(gap) > most else most
    return most


@inlined
def direction(plane: Plane, rank: int, free: int, M: Array, z: int) -> None:
    """Fill row z of M: how all joints move along A x = b when joint ``free`` moves by one."""
    for c in range(plane.m):
        M[z, c] = 0.0
    for k in range(rank):
        M[z, plane.order[k]] = -plane.W[plane.pivots[k], free]
    M[z, free] = 1.0


@inlined
def swivel(V: Array, row: Array, n: int, tolerance: float) -> int:
    """Solve one freedom: x + s z; the ratio test gives the interval of s, then its best point.

    Args:
        V: rows X (a point of the plane, moved to the optimum), Z and FORCE (the active bound's is written).
        row: flat record (10 n + 10,).
    """
    at = offsets(n)
    c2, rho = row[at.weights + C2], row[at.weights + RHO]
    low, high, low_joint, high_joint = -np.inf, np.inf, 0, 0
    zz, zx, zg = 0.0, 0.0, 0.0
    for j in range(n):
        x, z = V[X, j], V[Z, j]
        zz, zx, zg = zz + z * z, zx + z * x, zg + z * row[at.grad_mu + j]
        if abs(z) > IDLE_COLUMN:
            inverse = 1.0 / z
            start, end = (row[at.lower + j] - x) * inverse, (row[at.upper + j] - x) * inverse
            start, end = (start, end) if z > 0.0 else (end, start)
            low, low_joint = (start, j) if start > low else (low, low_joint)
            high, high_joint = (end, j) if end < high else (high, high_joint)
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
    slope = 0.0
    for j in range(n):
        V[X, j] += best * V[Z, j]
        slope += V[Z, j] * (rho * V[X, j] - c2 * row[at.grad_mu + j])
    if joint >= 0:
        V[FORCE, joint] = slope / V[Z, joint]
    return OK


@inlined
def answer(plane: Plane, rank: int, V: Array, row: Array, x: Array, y: Array) -> float:
    """Write x (n,) and y (6,) from rows X and FORCE of V; returns by how much x had to be put into its box [rad/s].

    A^T y = w - (rho x - c2 grad_mu), and the row operations turn A^T into the identity on the pivots.
    """
    n, m = plane.n, plane.m
    at = offsets(n)
    c2, rho = row[at.weights + C2], row[at.weights + RHO]
    beyond = 0.0
    for j in range(n):
        lower, upper = row[at.lower + j], row[at.upper + j]
        point = V[X, j]
        beyond = lower - point if lower - point > beyond else beyond
        beyond = point - upper if point - upper > beyond else beyond
        point = lower if point < lower else upper if point > upper else point
        x[j] = point
        V[FORCE, j] += c2 * row[at.grad_mu + j] - rho * point
    for i in range(6):
        multiplier = 0.0
        for k in range(rank):
            multiplier += plane.W[plane.pivots[k], m + i] * V[FORCE, plane.order[k]]
        y[i] = multiplier
    return beyond
