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
from sys import getrefcount
from typing import ClassVar

import numpy as np
from numba import float64, njit
from numpy.typing import NDArray

from moc_opt.compiled import VECTOR, Entry
from moc_opt.errors import SolverError
from moc_opt.solvers.base import Solution, Status, no_answer
from moc_opt.solvers.elimination import EMPTY, IDLE_COLUMN, OK, STUCK, eliminate, swivel
from moc_opt.solvers.polytope import maximise_over_box
from moc_opt.subproblem import NullSpaceQP

Array = NDArray[np.float64]

ROUNDING = 1e-9  # of the largest entry of grad_mu


@njit(cache=True, nogil=True, error_model="numpy")
def solve_row(row: Array, tolerance: float, x: Array, y: Array) -> int:
    """Solve one flat record (10 n + 10,) into x (n,) and y (6,); returns OK, EMPTY (infeasible) or STUCK."""
    n = x.shape[0]
    b, g, lo, up = 6 * n, 6 * n + 6, 7 * n + 6, 8 * n + 6
    c2, rho = row[9 * n + 8], row[9 * n + 9]
    # One block each for numbers and indices: at this size, asking for memory costs as much as the elimination, and
    # so do views. W is A and b by columns, then scratch, then w = P x + p + A^T y.
    W, order, w, rows = np.empty(7 * n + 12), np.empty(n + 6, dtype=np.int64), 6 * n + 12, n
    for i in range(6):
        for j in range(n):
            W[6 * j + i] = row[i * n + j]
        W[6 * n + i] = row[b + i]
    rank = eliminate(W, n, order)
    for i in range(rank, 6):
        if abs(W[6 * n + i]) > tolerance:
            return EMPTY  # a repeated row asks for another velocity than its twin

    # Particular solution, and the free columns that move the tip or the wrist.
    largest_grad = 0.0
    for j in range(n):
        x[j] = W[w + j] = 0.0  # w is >= 0 at a lower bound, <= 0 at an upper one
        largest_grad = max(largest_grad, abs(row[g + j]))
    for k in range(rank):
        x[order[k]] = W[6 * n + k]
    count = 0
    for p in range(rank, n):
        j = order[p]
        largest = 0.0
        for k in range(rank):
            largest = max(largest, abs(W[6 * j + k]))
        if largest > IDLE_COLUMN:
            order[rank + count] = j
            count += 1
        else:
            # a gradient at rounding level must not throw an idle joint to its bound
            pull = c2 * row[g + j] if abs(row[g + j]) > ROUNDING * largest_grad else 0.0
            wish = pull / rho if rho > 0.0 else np.sign(pull) * np.inf if pull != 0.0 else 0.0
            x[j] = min(max(wish, row[lo + j]), row[up + j])
            W[w + j] = rho * x[j] - pull

    status = OK
    if count == 1:
        status = swivel(W, n, rank, order, row, tolerance, x, w)
    elif count > 1:
        status = maximise_over_box(W, n, rank, order, count, row, x, w)
    for j in range(n):
        if x[j] < row[lo + j] - tolerance or x[j] > row[up + j] + tolerance:
            return EMPTY if status == OK else status
        x[j] = min(max(x[j], row[lo + j]), row[up + j])

    # A^T y = w - (rho x - c2 grad_mu): row operations turn A^T into the identity on the pivots.
    for k in range(rank):
        j = order[k]
        W[w + j] = W[w + j] - rho * x[j] + c2 * row[g + j]
    for i in range(6):
        total = 0.0
        if i < rank:
            for k in range(rank):
                total += W[6 * order[i] + k] * W[w + order[k]]
        y[order[rows + i]] = total
    return status


@njit(cache=True, nogil=True)
def solve_rows(rows: Array, tolerance: float, X: Array, Y: Array, status: NDArray[np.int64]) -> None:
    """``solve_row`` over a batch."""
    for i in range(rows.shape[0]):
        status[i] = solve_row(rows[i], tolerance, X[i], Y[i])


_SOLVE = Entry(solve_row, VECTOR, float64, VECTOR, VECTOR)
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
        session = ExactSession(self.tolerance, qp.n)
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
    """Keeps nothing between ticks but memory: warm equals cold.

    An answer that nobody holds any more is written again two calls later: to make and to free two arrays and a
    tuple costs as much as to solve.
    """

    __slots__ = ("_kernel", "_last", "_spare", "_unheld", "tolerance")

    def __init__(self, tolerance: float, n: int) -> None:
        self.tolerance = tolerance
        self._kernel = _SOLVE.code
        self._last, self._spare = _blank(n), _blank(n)
        self._unheld = self._count()

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem."""
        entry = self._spare
        answer, x, y = entry
        if getrefcount(answer) + getrefcount(x) + getrefcount(y) != self._unheld or len(x) != qp.n:
            entry = answer, x, y = _blank(qp.n)
        self._spare, self._last = self._last, entry
        code = self._kernel(qp.row, self.tolerance, x, y)
        return answer if code == OK else no_answer(qp.n, _STATUS[code])

    def _count(self) -> int:
        # The same steps as in `solve`: how many references they take themselves differs between Python versions.
        entry = self._spare
        answer, x, y = entry
        return getrefcount(answer) + getrefcount(x) + getrefcount(y)


def _blank(n: int) -> tuple[Solution, Array, Array]:
    x, y = np.empty(n), np.empty(6)
    return Solution(x, y, Status.SOLVED, 0), x, y
