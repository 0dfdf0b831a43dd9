"""Clarabel: an interior-point method for conic programs.

Goulart and Chen 2024, "Clarabel: an interior-point solver for conic programs with quadratic objectives".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import clarabel
import numpy as np

from moc_opt.solvers.base import Status
from moc_opt.solvers.library import Adapter, Outcome, TruncatedSession, stacked, upper_triangle

_CODE = clarabel.SolverStatus
_STATUS = (
    (_CODE.Solved, Status.SOLVED),
    (_CODE.PrimalInfeasible, Status.INFEASIBLE),
    (_CODE.AlmostSolved, Status.MAX_ITER),
    (_CODE.AlmostPrimalInfeasible, Status.MAX_ITER),
    (_CODE.MaxIterations, Status.MAX_ITER),
    (_CODE.MaxTime, Status.TIME_LIMIT),
)  # not a dict: the status codes cannot be hashed


class ClarabelSession(TruncatedSession):
    """One workspace of Clarabel."""

    def _allocate(self, m: int, n: int) -> dict[str, Any]:
        self._P, self._q, self._b = np.empty(n * (n + 1) // 2), np.empty(n), np.empty(m + 2 * n)
        self._A = np.ones((n, m + 2))
        self._A[:, m + 1] = -1.0
        return {
            "P": np.empty((n, n)), "packed": self._P, "p": self._q, "A": self._A[:, :m].T, "low": self._b[:m],
            "high": self._b[:m], "lower": self._b[m + n :], "upper": self._b[m : m + n], "signs": (1.0, -1.0, 1.0),
        }  # fmt: skip

    def _set_up(self, m: int, n: int) -> None:
        self._options = options = clarabel.DefaultSettings()
        options.verbose, options.presolve_enable, options.max_threads = False, False, 1
        options.tol_feas = options.tol_gap_abs = options.tol_gap_rel = self._settings.eps
        options.max_iter = self._settings.max_iter
        cones = [clarabel.ZeroConeT(m), clarabel.NonnegativeConeT(2 * n)]
        P, A = upper_triangle(self._P, n), stacked(self._A, 2)
        self._core: Any = clarabel.DefaultSolver(P, self._q, A, self._b, cones, options)

    def _hand_over(self) -> None:
        self._core.update(P=self._P, q=self._q, A=self._A.ravel(), b=self._b)

    def _run(self) -> Outcome:
        found = self._core.solve()
        status = next((ours for theirs, ours in _STATUS if found.status == theirs), Status.NUMERICAL)
        return status, found.iterations, np.array(found.x), np.array(found.z[: self._m])

    def _limit(self, iterations: int) -> None:
        self._options.max_iter = iterations
        self._core.update(settings=self._options)


@dataclass(frozen=True)
class Clarabel(Adapter):
    """Clarabel's native interface, with slacks s and the constraints [A; I; -I] x + s = [b; upper; -lower].

    Args:
        cost_scale: factor of P and p.
        eps: value of the library's tol_feas, tol_gap_abs and tol_gap_rel.
        max_iter: limit on the iterations of a solve.
    """

    rows: int = 5
    cost_scale: float = 1e3
    eps: float = 1e-9
    max_iter: int = 100
    name = "clarabel"
    session = ClarabelSession
