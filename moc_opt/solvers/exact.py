"""``exact``: the subproblem's optimum by elimination. docs/method.md derives the method."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat

import numpy as np

from moc_opt import core
from moc_opt.arrays import Array
from moc_opt.errors import SolverError
from moc_opt.qp.problem import NullSpaceQP, joints_of, row_length
from moc_opt.solvers.base import Solution, SolverSettings, Status, no_answer

STATUS = {core.OK: Status.SOLVED, core.INFEASIBLE: Status.INFEASIBLE, core.DOUBTFUL: Status.NUMERICAL}
# looked up once, for speed
_solve, _new, _SOLVED, _OK = core.solve_exact, tuple.__new__, Status.SOLVED, core.OK


class ExactSession:
    """A session that keeps nothing between ticks."""

    __slots__ = ("tolerance",)

    def __init__(self, settings: Exact, qp: NullSpaceQP) -> None:
        self.tolerance = settings.tolerance

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Solve one subproblem."""
        code, x, y = _solve(qp.row, self.tolerance)
        return _new(Solution, (x, y, _SOLVED, 0)) if code == _OK else no_answer(qp.n, STATUS[code])


@dataclass(frozen=True)
class Exact(SolverSettings):
    """Null-space elimination.

    Args:
        tolerance: accepted violation of the bounds [rad/s].
    """

    tolerance: float = 1e-9
    name = "exact"
    session = ExactSession

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return None, or a message if there are too many joints."""
        return None if qp.n <= core.MAX_JOINTS else f"{qp.n} joints: `exact` takes at most {core.MAX_JOINTS}"

    def solve_batch(self, rows: Array, threads: int | None = None) -> tuple[Array, Array, list[Status]]:
        """Solve the subproblems ``rows`` (k, 11 n + 10). Return x (k, n), multipliers y (k, 6) and k statuses.

        x and y are NaN if the status is not SOLVED. ``threads`` None: one per core. A wrong shape raises a SolverError.
        """
        if threads is not None and threads < 1:
            raise SolverError(f"exact: threads = {threads}: give 1 or more, or None for one per core")
        rows = np.ascontiguousarray(rows, dtype=np.float64)
        n = joints_of(rows.shape[-1])
        if rows.ndim != 2 or rows.shape[1] != row_length(n) or not 1 <= n <= core.MAX_JOINTS:
            raise SolverError(f"exact: rows has shape {rows.shape}: give (k, 11 n + 10), n at most {core.MAX_JOINTS}")
        X, Y, codes = np.empty((len(rows), n)), np.empty((len(rows), 6)), np.empty(len(rows))
        threads = threads or os.cpu_count() or 1
        pieces = min(8 * threads, 1 + len(rows) // 1000)  # several per thread, so that all threads end together
        parts = [np.array_split(array, pieces) for array in (rows, X, Y, codes)]
        with ThreadPoolExecutor(threads) as pool:  # the core releases the GIL
            list(pool.map(core.solve_exact_rows, parts[0], repeat(self.tolerance), *parts[1:]))
        statuses, unsolved = [Status.SOLVED] * len(rows), np.flatnonzero(codes != _OK)
        X[unsolved] = Y[unsolved] = np.nan
        for k in unsolved:
            statuses[k] = STATUS[codes[k]]
        return X, Y, statuses
