"""The exact answer by null-space elimination: the yardstick of every other solver.

On A x = b the c0, c1 terms vanish, and what remains is damping/2 |x|^2 - c2 grad_mu^T x over the
box. Elimination with complete pivoting writes x = particular + (free columns) w; joints whose
column is zero (joint 7 under a tool on its axis) move nothing and are solved on their own. One
remaining freedom (the elbow swivel) is a ratio test in closed form; several are a projection
onto a polytope (``moc_opt.solvers.polytope``).
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from moc_opt.errors import SolverError
from moc_opt.solvers.base import Solution, Status, no_answer
from moc_opt.solvers.polytope import maximise_over_box
from moc_opt.subproblem import NullSpaceQP

Array = NDArray[np.float64]

PIVOT_TOLERANCE = 1e-12  # relative to the largest pivot: below it a row repeats the others
IDLE_COLUMN = 1e-14  # a free column smaller than this moves neither tip nor wrist

ROUNDING = 1e-9  # of the largest entry of grad_mu

OK, EMPTY, STUCK = 0, 1, 2


@njit(cache=True, nogil=True)
def eliminate(W: Array, n: int, pivots: NDArray[np.int64]) -> int:
    """Gauss-Jordan with complete pivoting on W = [A | b | I], (6, n + 7), in place.

    Row k of the result reads x[pivots[k]] + sum_free W[k, j] x[j] = W[k, n]; the last six
    columns hold the row operations. Returns the rank.
    """
    columns = W.shape[1]
    taken = np.zeros(n, dtype=np.bool_)
    first = 0.0
    for k in range(6):
        size, row, column = 0.0, k, 0
        for i in range(k, 6):
            for j in range(n):
                if not taken[j] and abs(W[i, j]) > size:
                    size, row, column = abs(W[i, j]), i, j
        if k == 0:
            first = size
        if size <= PIVOT_TOLERANCE * first:
            return k
        taken[column] = True
        pivots[k] = column
        if row != k:
            for j in range(columns):
                W[k, j], W[row, j] = W[row, j], W[k, j]
        inverse = 1.0 / W[k, column]
        for j in range(columns):
            W[k, j] *= inverse
        for i in range(6):
            factor = W[i, column]
            if i != k and factor != 0.0:
                for j in range(columns):
                    W[i, j] -= factor * W[k, j]
                W[i, column] = 0.0
    return 6


@njit(cache=True, nogil=True)
def solve_row(row: Array, n: int, tolerance: float, x: Array, y: Array) -> int:
    """Solve one flat record into x (n,) and y (6,); returns OK, EMPTY (infeasible) or STUCK."""
    o = 6 * n
    b, grad_mu = row[o : o + 6], row[o + 6 : o + 6 + n]
    lower, upper = row[o + 6 + n : o + 6 + 2 * n], row[o + 6 + 2 * n : o + 6 + 3 * n]
    c2, rho = row[o + 8 + 3 * n], row[o + 9 + 3 * n]

    W = np.zeros((6, n + 7))
    for i in range(6):
        for j in range(n):
            W[i, j] = row[i * n + j]
        W[i, n] = b[i]
        W[i, n + 1 + i] = 1.0
    pivots = np.empty(6, dtype=np.int64)
    rank = eliminate(W, n, pivots)
    for i in range(rank, 6):
        if abs(W[i, n]) > tolerance:
            return EMPTY  # a repeated row asks for another velocity than its twin

    # Particular solution, and the free columns that move the tip or the wrist.
    basic = np.zeros(n, dtype=np.bool_)
    x[:] = 0.0
    for k in range(rank):
        basic[pivots[k]] = True
        x[pivots[k]] = W[k, n]
    moving = np.empty(n, dtype=np.int64)
    count = 0
    largest_grad = np.max(np.abs(grad_mu))
    bound_dual = np.zeros(n)  # w = P x + p + A^T y: >= 0 at a lower bound, <= 0 at an upper one
    for j in range(n):
        if basic[j]:
            continue
        largest = 0.0
        for k in range(rank):
            largest = max(largest, abs(W[k, j]))
        if largest > IDLE_COLUMN:
            moving[count] = j
            count += 1
        else:
            # a gradient at rounding level must not throw an idle joint to its bound
            pull = c2 * grad_mu[j] if abs(grad_mu[j]) > ROUNDING * largest_grad else 0.0
            wish = pull / rho if rho > 0.0 else np.sign(pull) * np.inf if pull != 0.0 else 0.0
            x[j] = min(max(wish, lower[j]), upper[j])
            bound_dual[j] = rho * x[j] - pull

    status = OK
    if count == 1:
        status = swivel(
            W, n, rank, pivots, moving[0], grad_mu, lower, upper, c2, rho, tolerance, x, bound_dual
        )
    elif count > 1:
        Z = np.zeros((count, n))
        for c in range(count):
            Z[c, moving[c]] = 1.0
            for k in range(rank):
                Z[c, pivots[k]] = -W[k, moving[c]]
        status = maximise_over_box(Z, grad_mu, lower, upper, c2, rho, tolerance, x, bound_dual)
    for j in range(n):
        if x[j] < lower[j] - tolerance or x[j] > upper[j] + tolerance:
            return EMPTY if status == OK else status
        x[j] = min(max(x[j], lower[j]), upper[j])

    # A^T y = w - (rho x - c2 grad_mu): row operations turn A^T into the identity on the pivots.
    y[:] = 0.0
    for k in range(rank):
        j = pivots[k]
        right = bound_dual[j] - rho * x[j] + c2 * grad_mu[j]
        for i in range(6):
            y[i] += W[k, n + 1 + i] * right
    return status


@njit(cache=True, nogil=True)
def swivel(
    W: Array,
    n: int,
    rank: int,
    pivots: NDArray[np.int64],
    free: int,
    grad_mu: Array,
    lower: Array,
    upper: Array,
    c2: float,
    rho: float,
    tolerance: float,
    x: Array,
    bound_dual: Array,
) -> int:
    """One freedom: x + w z with z[free] = 1; the ratio test gives the interval of w, then its best point."""
    low, high = lower[free], upper[free]
    low_joint, high_joint = free, free
    zz, zx, zg = 1.0, 0.0, grad_mu[free]
    for k in range(rank):
        j = pivots[k]
        z = -W[k, free]
        zz += z * z
        zx += z * x[j]
        zg += z * grad_mu[j]
        if abs(z) <= IDLE_COLUMN:
            continue
        at_lower, at_upper = (lower[j] - x[j]) / z, (upper[j] - x[j]) / z
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
    slope = rho * best - c2 * grad_mu[free]
    lever = 1.0
    for k in range(rank):
        j = pivots[k]
        z = -W[k, free]
        x[j] += best * z
        slope += z * (rho * x[j] - c2 * grad_mu[j])
        if j == joint:
            lever = z
    if joint >= 0:
        bound_dual[joint] = slope / lever
    return OK


@njit(cache=True, nogil=True)
def solve_rows(rows: Array, n: int, tolerance: float, X: Array, Y: Array, status: NDArray[np.int64]) -> None:
    """``solve_row`` over a batch."""
    for i in range(rows.shape[0]):
        status[i] = solve_row(rows[i], n, tolerance, X[i], Y[i])


_STATUS = {OK: Status.SOLVED, EMPTY: Status.INFEASIBLE, STUCK: Status.NUMERICAL}


@dataclass(frozen=True)
class Exact:
    """Null-space elimination.

    Args:
        tolerance: box and consistency violation that still counts as feasible [rad/s, m/s].
    """

    tolerance: float = 1e-9
    name: ClassVar[str] = "exact"

    def __post_init__(self) -> None:
        if not 0.0 < self.tolerance < 1.0:
            raise SolverError(f"exact: tolerance = {self.tolerance} is not in (0, 1); 1e-9 is usual")

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Every subproblem is supported."""
        return None

    def start(self, qp: NullSpaceQP) -> ExactSession:
        """A session; there is nothing to warm up but the compiler."""
        session = ExactSession(self.tolerance)
        session.solve(qp)
        return session

    def solve_batch(self, rows: Array) -> tuple[Array, Array, list[Status]]:
        """Solve flat records (k, 10 n + 10) in threads: x (k, n), y (k, 6), statuses.

        x and y are NaN where the status is not SOLVED.
        """
        rows = np.ascontiguousarray(rows, dtype=float)
        n = (rows.shape[1] - 10) // 10
        X, Y, codes = np.empty((len(rows), n)), np.empty((len(rows), 6)), np.empty(len(rows), dtype=np.int64)
        parts = np.array_split(
            np.arange(len(rows)), os.cpu_count() or 1
        )  # the kernel holds no lock: threads do
        with ThreadPoolExecutor(len(parts)) as pool:
            jobs = [
                pool.submit(
                    solve_rows,
                    rows[p[0] : p[-1] + 1],
                    n,
                    self.tolerance,
                    X[p[0] : p[-1] + 1],
                    Y[p[0] : p[-1] + 1],
                    codes[p[0] : p[-1] + 1],
                )
                for p in parts
                if p.size
            ]
            for job in jobs:
                job.result()
        X[codes != OK] = np.nan
        Y[codes != OK] = np.nan
        return X, Y, [_STATUS[int(code)] for code in codes]


class ExactSession:
    """Keeps nothing between ticks: warm equals cold."""

    __slots__ = ("tolerance",)

    def __init__(self, tolerance: float) -> None:
        self.tolerance = tolerance

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem."""
        n = qp.n
        out = np.empty(n + 6)
        x, y = out[:n], out[n:]
        code = solve_row(qp.row, n, self.tolerance, x, y)
        return Solution(x, y, Status.SOLVED) if code == OK else no_answer(n, _STATUS[code])
