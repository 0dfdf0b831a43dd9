"""The exact answer by null-space elimination: the yardstick of every other solver.

On A x = b the c0, c1 terms vanish, and what remains is regularization/2 |x|^2 - c2 grad_mu^T x over the
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
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import VECTOR, CompiledKernel, borrowed
from moc_opt.numerics.simd import larger, load, magnitude, stack, stack_indices, store, width, zeros
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
    Plane,
    X,
    Z,
    answer,
    direction,
)
from moc_opt.solvers.exact.polytope import maximise_over_box

Array = NDArray[np.float64]

ROUNDING = 1e-9  # of the largest entry of grad_mu


@njit(cache=True, nogil=True, error_model="numpy")
def rest(V: Array, row: Array, n: int) -> None:
    """Joints that move neither tip nor wrist go where the cost alone takes them."""
    at = offsets(n)
    c2, rho = row[at.weights + C2], row[at.weights + RHO]
    largest_grad = 0.0
    for j in range(n):
        largest_grad = max(largest_grad, abs(row[at.grad_mu + j]))
    for j in range(n):
        if 0.0 <= V[REACH, j] <= elimination.IDLE_COLUMN:
            # a gradient at rounding level must not throw an idle joint to its bound
            pull = c2 * row[at.grad_mu + j] if abs(row[at.grad_mu + j]) > ROUNDING * largest_grad else 0.0
            wish = pull / rho if rho > 0.0 else np.sign(pull) * np.inf if pull != 0.0 else 0.0
            V[X, j] = min(max(wish, row[at.lower + j]), row[at.upper + j])


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def solve_within(row: Array, tolerance: float, x: Array, y: Array, m: int) -> int:
    """``solve_row`` with m >= n numbers to a row, m a multiple of eight."""
    n = x.shape[0]
    V, W = stack(4, m), stack(7, m + 8)
    plane = Plane(W, stack_indices(n + 1), stack_indices(6), n, m)
    rank = elimination.eliminate(plane, row)
    if rank < 0:
        return STUCK
    for i in range(6):
        if W[OPEN, i] * abs(W[i, m + B]) > LEFT and elimination.contradicts(W, n, m, i, row, LEFT):
            return EMPTY  # a repeated row asks for another velocity than its twin

    # Particular solution, and the free columns that move the tip or the wrist.
    for c in range(0, m, 8):
        reach = zeros()
        for i in range(6):
            reach = larger(reach, (1.0 - W[OPEN, i]) * magnitude(load(W, i, c)))
        store(V, REACH, c, reach)
        store(V, X, c, 0.0)
        store(V, FORCE, c, 0.0)
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
        status = elimination.swivel(V, row, n, m, tolerance)
    elif freedoms > 1:
        status = maximise_over_box(plane, rank, freedoms, V, row, tolerance)
    beyond = answer(plane, rank, V, row, x, y)
    if status == OK and beyond > tolerance:
        return EMPTY
    # Rows that are neither independent nor repeated: which velocities they allow cannot be told.
    return STUCK if status == OK and elimination.left_over(plane, x) > LEFT else status


@njit(cache=True, nogil=True, error_model="numpy")
def solve_row(row: Array, tolerance: float, x: Array, y: Array) -> int:
    """Solve one flat record (10 n + 10,) into x (n,) and y (6,); returns OK, EMPTY (infeasible) or STUCK."""
    n = x.shape[0]
    row, x, y = borrowed(row), borrowed(x), borrowed(y)
    # int64(8) is a constant to LLVM alone; numba would compile everything once more for 8.
    if n <= 8:
        return solve_within(row, tolerance, x, y, int64(8))
    if n <= 16:
        return solve_within(row, tolerance, x, y, int64(16))
    return solve_within(row, tolerance, x, y, width(n))


@njit(cache=True, nogil=True)
def solve_rows(rows: Array, tolerance: float, X: Array, Y: Array, status: NDArray[np.int64]) -> None:
    """``solve_row`` over a batch."""
    for i in range(rows.shape[0]):
        status[i] = solve_row(rows[i], tolerance, X[i], Y[i])


_SOLVE = CompiledKernel(solve_row, VECTOR, float64, VECTOR, VECTOR)
_empty, _solution, _SOLVED = np.empty, Solution._make, Status.SOLVED  # looked up once: the loop does it at every tick
_STATUS = {OK: Status.SOLVED, EMPTY: Status.INFEASIBLE, STUCK: Status.NUMERICAL}


@dataclass(frozen=True)
class Exact:
    """Null-space elimination.

    Args:
        tolerance: box violation that still counts as feasible [rad/s].

    Repeated rows may contradict each other by ``elimination.LEFT`` [m/s], the judge's own tolerance on A x = b: data
    that are rounded to eight decimals contradict themselves by 1e-8.
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

    def solve_batch(self, rows: Array, threads: int | None = None) -> tuple[Array, Array, list[Status]]:
        """Solve flat records (k, 10 n + 10): x (k, n), y (k, 6), statuses.

        x and y are NaN where the status is not SOLVED.

        Args:
            rows: the records.
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

    __slots__ = ("_kernel", "tolerance")

    def __init__(self, tolerance: float) -> None:
        self.tolerance = tolerance
        self._kernel = _SOLVE.code

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem; the answer's arrays are the caller's."""
        x, y = _empty(qp.n), _empty(6)
        code = self._kernel(qp.row, self.tolerance, x, y)
        return _solution((x, y, _SOLVED, 0)) if code == OK else no_answer(qp.n, _STATUS[code])
