"""The equalities of one subproblem eliminated, and the closed form where one freedom (the elbow swivel) is left.

All kernels take rows in pieces of eight numbers (``moc_opt.numerics.simd``). They follow Golub and Van Loan, Matrix
Computations, 3.4.8 (complete pivoting), and take numbers as they are: a division by zero gives infinity, as numpy's
does. They are compiled into their caller: to hand a matrix over costs as much as to add two rows, and where the
caller knows how wide a row is, no loop over it is left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.numerics.cache import njit
from moc_opt.numerics.simd import (
    above,
    first,
    keep,
    larger,
    largest,
    least,
    lesser,
    load,
    magnitude,
    part,
    store,
    total,
    unit,
    zeros,
)
from moc_opt.qp.equalities import offsets
from moc_opt.qp.layout import C2, RHO
from moc_opt.qp.residuals import RANK_TOLERANCE, TIED

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

DOUBTFUL = 1e3  # a sixth pivot below this multiple of its tolerance is looked at more closely
LEFT = 1e-6  # |A x - b| that a dropped row may be left with [m/s]: the judge's primal tolerance
IDLE_COLUMN = 1e-14  # a free column smaller than this moves neither tip nor wrist

OK, EMPTY, STUCK = 0, 1, 2
OPEN, B = 6, 6  # row of W that has 1 for every row of A that is no pivot yet; place of b behind A
# Rows of V: x; how it moves along the plane; w = P x + p + A^T y; the largest entry of a column.
X, Z, FORCE, REACH = 0, 1, 2, 3


class Plane(NamedTuple):
    """A x = b while it is eliminated.

    Attributes:
        W: (7, m + 8) rows of A, and from column m on the row operations, the identity at first, and b.
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
    """How much the last open row has of its own, in units of the tolerance on the sixth singular value.

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


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def eliminate(plane: Plane, row: Array) -> int:
    """Gauss-Jordan with complete pivoting on [A | b] of a flat record (10 n + 10,); returns the rank.

    The rank is -1 where a row is neither repeated nor independent: around the tolerances, where singular values and
    pivots may disagree.
    Afterwards row pivots[k] of W reads x[order[k]] + sum_free W[., j] x[j] = b, for k < rank.
    """
    W, n, m, at = plane.W, plane.n, plane.m, offsets(plane.n)
    for i in range(6):
        for c in range(0, m, 8):
            store(W, i, c, part(row, i * n + c, n - c))
        store(W, i, m, unit(i) + unit(B) * row[at.b + i])
    store(W, OPEN, 0, 1.0)
    start = 0.0
    for k in range(6):
        most = zeros()
        for i in range(6):
            for c in range(0, m, 8):
                most = larger(magnitude(load(W, i, c)) * W[OPEN, i], most)
        size = largest(most)
        start = size if k == 0 else start
        if not size > 30.0 * RANK_TOLERANCE * start:
            return k if k == 5 or not size > 0.1 * RANK_TOLERANCE * start else -1
        if k == 5 and size < TIED * DOUBTFUL * start:
            own = own_part(W, n, m, row)
            if own <= 10.0:
                return k if own <= 1.0 else -1
        inverse = 1.0 / size  # its sign is seen to when the pivot is found: the division takes as long
        pivot, column = 0, 0
        for i in range(6):
            for c in range(0, m, 8):
                place = first(magnitude(load(W, i, c)) * W[OPEN, i], size)
                pivot = i if place < 8 else pivot
                column = c + place if place < 8 else column
        inverse = inverse if W[pivot, column] > 0.0 else -inverse
        plane.order[k], plane.pivots[k], W[OPEN, pivot] = column, pivot, 0.0
        for i in range(6):
            scale = W[i, column] * inverse if i != pivot else 0.0
            for c in range(0, m + 8, 8):
                store(W, i, c, load(W, i, c) - scale * load(W, pivot, c))
        for c in range(0, m + 8, 8):
            store(W, pivot, c, load(W, pivot, c) * inverse)
    return 6


@njit(cache=True, nogil=True, error_model="numpy")
def contradicts(W: Array, n: int, m: int, i: int, row: Array, tolerance: float) -> bool:
    """Whether no x in the box brings the dropped row i of W to what it asks for."""
    at = offsets(n)
    reach = tolerance
    for j in range(n):
        reach += abs(W[i, j]) * max(abs(row[at.lower + j]), abs(row[at.upper + j]))
    return bool(abs(W[i, m + B]) > reach)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def left_over(plane: Plane, x: Array) -> float:
    """|A x - b|_inf of the answer x (n,): the dropped rows are what is left of it."""
    W, most = plane.W, 0.0
    for i in range(6):
        if W[OPEN, i] > 0.0:
            gap = -W[i, plane.m + B]
            for j in range(plane.n):
                gap += W[i, j] * x[j]
            most = max(most, abs(gap))
    return most


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def direction(plane: Plane, rank: int, free: int, M: Array, z: int) -> None:
    """Row z of M: how all joints move along A x = b when joint ``free`` moves by one."""
    for c in range(0, plane.m, 8):
        store(M, z, c, 0.0)
    for k in range(rank):
        M[z, plane.order[k]] = -plane.W[plane.pivots[k], free]
    M[z, free] = 1.0


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def swivel(V: Array, row: Array, n: int, m: int, tolerance: float) -> int:
    """One freedom: x + s z; the ratio test gives the interval of s, then its best point.

    Args:
        V: rows X (a point of the plane, moved to the optimum), Z and FORCE (the active bound's is written).
        row: flat record (10 n + 10,).
    """
    at = offsets(n)
    c2, rho = row[at.weights + C2], row[at.weights + RHO]
    low, high, low_joint, high_joint = -np.inf, np.inf, 0, 0
    zz, zx, zg = 0.0, 0.0, 0.0
    for c in range(0, m, 8):
        x, z = load(V, X, c), load(V, Z, c)
        zz, zx, zg = zz + total(z * z), zx + total(z * x), zg + total(z * part(row, at.grad_mu + c, n - c))
        at_lower, at_upper = (part(row, at.lower + c, n - c) - x) / z, (part(row, at.upper + c, n - c) - x) / z
        starts = above(magnitude(z), IDLE_COLUMN, lesser(at_lower, at_upper), -np.inf)
        ends = above(magnitude(z), IDLE_COLUMN, larger(at_lower, at_upper), np.inf)
        start, end = largest(starts), least(ends)
        low_joint = c + first(starts, start) if start > low else low_joint
        high_joint = c + first(ends, end) if end < high else high_joint
        low, high = max(low, start), min(high, end)
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
    for c in range(0, m, 8):
        z = load(V, Z, c)
        x = load(V, X, c) + best * z
        store(V, X, c, x)
        slope += total(z * (rho * x - c2 * part(row, at.grad_mu + c, n - c)))
    if joint >= 0:
        V[FORCE, joint] = slope / V[Z, joint]
    return OK


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def answer(plane: Plane, rank: int, V: Array, row: Array, x: Array, y: Array) -> float:
    """Write x (n,) and y (6,) from rows X and FORCE of V; returns by how much x had to be put into its box [rad/s].

    A^T y = w - (rho x - c2 grad_mu), and the row operations turn A^T into the identity on the pivots.
    """
    n, m = plane.n, plane.m
    at = offsets(n)
    c2, rho = row[at.weights + C2], row[at.weights + RHO]
    beyond = 0.0
    for c in range(0, m, 8):
        lower, upper, point = part(row, at.lower + c, n - c), part(row, at.upper + c, n - c), load(V, X, c)
        beyond = max(beyond, largest(larger(lower - point, point - upper)))
        point = lesser(larger(point, lower), upper)
        keep(x, c, n - c, point)
        store(V, FORCE, c, load(V, FORCE, c) - rho * point + c2 * part(row, at.grad_mu + c, n - c))
    multipliers = zeros()
    for k in range(rank):
        multipliers = multipliers + load(plane.W, plane.pivots[k], m) * V[FORCE, plane.order[k]]
    keep(y, 0, 6, multipliers)
    return beyond
