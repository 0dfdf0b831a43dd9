"""The exact answer by null-space elimination: the yardstick of every other solver.

On A x = b the c0, c1 terms are constant, and the rest is regularization/2 |x|^2 - c2 grad_mu^T x over the
box. Elimination with complete pivoting writes x = particular + (free columns) w; joints whose
column is zero (joint 7 under a tool on its axis) move nothing and are solved on their own. One
remaining freedom (the elbow swivel) is a ratio test in closed form; several are a projection
onto a polytope (``moc_opt.solvers.exact.polytope``).
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import float64, int64
from numpy.typing import NDArray

from moc_opt.errors import SolverError
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import INDICES, MATRIX, VECTOR, CompiledKernel, borrowed
from moc_opt.qp.equalities import offsets
from moc_opt.qp.layout import C2, RHO
from moc_opt.qp.problem import NullSpaceQP, fields
from moc_opt.solvers.base import Solution, Status, no_answer
from moc_opt.solvers.exact import elimination
from moc_opt.solvers.exact.elimination import (
    EMPTY,
    FORCE,
    LEFT,
    OK,
    OPEN,
    REACH,
    STUCK,
    B,
    Indices,
    Plane,
    X,
    Z,
    answer,
    direction,
)
from moc_opt.solvers.exact.polytope import maximise_over_box

ROUNDING = 1e-9  # of the largest entry of grad_mu
ANOTHER_SIZE = 3
GROWTH = 4e-12
"""2^14 roundings: what cancels in six steps of elimination between columns that differ a thousandfold."""
WIDEST = 1e-5  # of these tolerances [rad/s]


@njit(cache=True, nogil=True)
def workspace(n: int) -> tuple[Array, Indices]:
    """Make the scratch memory of `solve_row` for n joints: V and W with rows of a multiple of eight, and orders."""
    return np.empty((12, (n + 7) // 8 * 8 + 8)), np.empty(n + 7, dtype=np.int64)


@njit(cache=True, nogil=True, error_model="numpy")
def rest(V: Array, row: Array, n: int) -> None:
    """Move the joints that move neither tip nor wrist to where the cost alone takes them."""
    at = offsets(n)
    c2, rho = row[at.weights + C2], row[at.weights + RHO]
    largest_grad = 0.0
    for j in range(n):
        largest_grad = max(largest_grad, abs(row[at.grad_mu + j]))
    for j in range(n):
        if 0.0 <= V[REACH, j] <= elimination.IDLE_COLUMN:
            # a gradient at rounding level must not throw an idle joint to its bound
            pull = c2 * row[at.grad_mu + j] if abs(row[at.grad_mu + j]) > ROUNDING * largest_grad else 0.0
            desired = pull / rho if rho > 0.0 else np.sign(pull) * np.inf if pull != 0.0 else 0.0
            V[X, j] = min(max(desired, row[at.lower + j]), row[at.upper + j])


@elimination.inlined
def solve_within(row: Array, tolerance: float, x: Array, y: Array, work: Array, indices: Indices, m: int) -> int:
    """Do as ``solve_row``, with m >= n numbers to a row, m a multiple of eight."""
    n = x.shape[0]
    V, W = work[:4], work[4:]
    plane = Plane(W, indices[6:], indices[:6], n, m)
    rank = elimination.eliminate(plane, row)
    if rank < 0:
        return STUCK
    for i in range(6):
        if W[OPEN, i] * abs(W[i, m + B]) > LEFT and elimination.contradicts(W, n, m, i, row, LEFT):
            return EMPTY  # a repeated row asks for another velocity than its twin

    # Particular solution, and the free columns that move the tip or the wrist.
    for c in range(m):
        V[REACH, c] = V[X, c] = V[FORCE, c] = 0.0
    for i in range(6):
        for c in range(m):
            reach = (1.0 - W[OPEN, i]) * abs(W[i, c])
            V[REACH, c] = reach if reach > V[REACH, c] else V[REACH, c]
    for k in range(rank):
        V[X, plane.order[k]], V[REACH, plane.order[k]] = W[plane.pivots[k], m + B], -1.0
    freedoms = int64(0)
    for j in range(n):
        plane.order[rank + freedoms] = j
        freedoms += V[REACH, j] > elimination.IDLE_COLUMN
    if rank + freedoms < n:
        rest(V, row, n)

    status = OK
    if freedoms == 1:
        direction(plane, rank, plane.order[rank], V, Z)
        status = elimination.swivel(V, row, n, tolerance)
    elif freedoms > 1:
        status = maximise_over_box(plane, rank, freedoms, V, row, tolerance)
    beyond = answer(plane, rank, V, row, x, y)
    if status == OK and beyond > tolerance:
        return EMPTY
    # Rows that are neither independent nor repeated: which velocities they allow cannot be told.
    return STUCK if status == OK and elimination.left_over(plane, x) > LEFT else status


@njit(cache=True, nogil=True, error_model="numpy")
def solve_once(row: Array, tolerance: float, x: Array, y: Array, work: Array, indices: Indices) -> int:
    """Solve with one tolerance; arguments as for `solve_row`."""
    n = x.shape[0]
    # int64(8) is a constant to LLVM alone; numba would compile everything once more for 8.
    if n <= 8:
        return solve_within(row, tolerance, x, y, work, indices, int64(8))
    if n <= 16:
        return solve_within(row, tolerance, x, y, work, indices, int64(16))
    return solve_within(row, tolerance, x, y, work, indices, work.shape[1] - 8)


@njit(cache=True, nogil=True, error_model="numpy")
def rounding(row: Array, n: int) -> float:
    """Compute how far rounding of A x = b may put a joint out of its box [rad/s].

    A rounding error of the largest |A| |x| in the box, carried over to the joint that moves tip and wrist least; the
    elimination's own growth is in `GROWTH`.
    """
    at = offsets(n)
    largest, least = 0.0, np.inf
    for i in range(6):
        sum_of = 0.0
        for j in range(n):
            sum_of += abs(row[i * n + j]) * max(abs(row[at.lower + j]), abs(row[at.upper + j]))
        largest = max(largest, sum_of)
    for j in range(n):
        column = 0.0
        for i in range(6):
            column = max(column, abs(row[i * n + j]))
        least = min(least, column) if column > elimination.IDLE_COLUMN else least
    return float(GROWTH * largest / least)


@njit(cache=True, nogil=True, error_model="numpy")
def off_the_plane(row: Array, x: Array) -> float:
    """Compute |A x - b|_inf [m/s]."""
    n, most = x.shape[0], 0.0
    for i in range(6):
        gap = -row[offsets(n).b + i]
        for j in range(n):
            gap += row[i * n + j] * x[j]
        most = max(most, abs(gap))
    return most


@njit(cache=True, nogil=True, error_model="numpy")
def solve_row(row: Array, tolerance: float, x: Array, y: Array, work: Array, indices: Indices) -> int:
    """Solve one flat record (10 n + 10,) into x (n,) and y (6,); returns OK, EMPTY (infeasible) or STUCK.

    Where that fails and columns of A differ so much that rounding may have decided it, the tolerance on the way is
    raised to what rounding explains; the answer lies in its box all the same, and has to meet A x = b to within `LEFT`.

    ``work`` and ``indices`` are of `workspace`; where they are for another n nothing is done: ANOTHER_SIZE.
    """
    n = x.shape[0]
    if indices.shape[0] != n + 7:
        return ANOTHER_SIZE
    row, x, y, work, indices = borrowed(row), borrowed(x), borrowed(y), borrowed(work), borrowed(indices)
    status = solve_once(row, tolerance, x, y, work, indices)
    if status != OK:
        explained = rounding(row, n)
        for wider in (explained, 100.0 * explained):
            found = solve_once(row, min(wider, WIDEST), x, y, work, indices) if tolerance < explained else status
            if found == OK and off_the_plane(row, x) <= LEFT:
                return OK
    return status


@njit(cache=True, nogil=True)
def solve_rows(rows: Array, tolerance: float, X: Array, Y: Array, status: NDArray[np.int64]) -> None:
    """Call ``solve_row`` for every row of a batch."""
    work, indices = workspace(X.shape[1])
    for i in range(rows.shape[0]):
        status[i] = solve_row(rows[i], tolerance, X[i], Y[i], work, indices)


_SOLVE = CompiledKernel(solve_row, VECTOR, float64, VECTOR, VECTOR, MATRIX, INDICES)
_empty, _new, _SOLVED = np.empty, tuple.__new__, Status.SOLVED  # looked up once: the loop does it at every tick
_STATUS = {OK: Status.SOLVED, EMPTY: Status.INFEASIBLE, STUCK: Status.NUMERICAL}


@dataclass(frozen=True)
class Exact:
    """Null-space elimination.

    Args:
        tolerance: box violation that still counts as feasible [rad/s]; more where rounding alone explains more.

    Repeated rows may contradict each other by ``elimination.LEFT`` [m/s], the tolerance on A x = b of the residual
    check: data that are rounded to eight decimals contradict themselves by 1e-8.
    """

    tolerance: float = 1e-9
    name: ClassVar[str] = "exact"

    def __post_init__(self) -> None:
        if not isinstance(self.tolerance, int | float) or not 0.0 < self.tolerance < 1.0:
            raise SolverError(f"exact: tolerance = {self.tolerance} is not in (0, 1); 1e-9 is usual")

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return None: every subproblem is supported."""
        return None

    def start(self, qp: NullSpaceQP) -> ExactSession:
        """Return a session; there is nothing to warm up but the compiler."""
        session = ExactSession(self.tolerance, qp.n)
        session.solve(qp)
        return session

    def solve_batch(self, rows: Array, threads: int | None = None) -> tuple[Array, Array, list[Status]]:
        """Solve flat records (k, 10 n + 10): x (k, n), y (k, 6), statuses.

        x and y are NaN where the status is not SOLVED.

        Args:
            threads: how many share the work; None: one a core.

        Raises:
            SolverError: fewer than one thread.
        """
        if threads is not None and threads < 1:
            raise SolverError(f"exact: threads = {threads}: give 1 or more, or None for one a core")
        rows = np.ascontiguousarray(rows, dtype=float)
        n = fields(rows).q.shape[-1]
        X, Y, codes = np.empty((len(rows), n)), np.empty((len(rows), 6)), np.empty(len(rows), dtype=np.int64)
        parts = np.array_split(
            np.arange(len(rows)), threads or os.cpu_count() or 1
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
    """Keeps nothing between ticks: warm equals cold."""

    __slots__ = ("_indices", "_kernel", "_work", "tolerance")

    def __init__(self, tolerance: float, n: int) -> None:
        self.tolerance = tolerance
        self._work, self._indices = workspace(n)
        self._kernel = _SOLVE.code

    def __repr__(self) -> str:
        return f"<session of {Exact(self.tolerance)!r}>"

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem; the answer's arrays are the caller's."""
        x, y = _empty(qp.n), _empty(6)
        code = self._kernel(qp.row, self.tolerance, x, y, self._work, self._indices)
        if code == ANOTHER_SIZE:
            self._work, self._indices = workspace(qp.n)
            return self.solve(qp)
        return _new(Solution, (x, y, _SOLVED, 0)) if code == OK else no_answer(qp.n, _STATUS[code])
