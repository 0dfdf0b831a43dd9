"""Clarabel: an interior-point method for cones, set up once and updated in place.

Goulart and Chen 2024, "Clarabel: an interior-point solver for conic programs with quadratic
objectives". Dense sparsity patterns keep explicit zeros, so that every tick only replaces values.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import clarabel
import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from moc_opt.qp.equalities import ROWS, assembled
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers import checks
from moc_opt.solvers.backends.buffers import Loader
from moc_opt.solvers.base import Solution, Status, no_answer

Array = NDArray[np.float64]

_CODE = clarabel.SolverStatus
_STATUS = (
    (_CODE.Solved, Status.SOLVED),
    (_CODE.PrimalInfeasible, Status.INFEASIBLE),
    (_CODE.AlmostSolved, Status.MAX_ITER),
    (_CODE.AlmostPrimalInfeasible, Status.MAX_ITER),
    (_CODE.MaxIterations, Status.MAX_ITER),
    (_CODE.MaxTime, Status.TIME_LIMIT),
)


@dataclass(frozen=True)
class Clarabel:
    """Clarabel's native interface, constraints [A; I; -I] x + s = [b; upper; -lower].

    Args:
        rows: 5 or 6 equality rows.
        cost_scale: multiplies P and p; the duals are scaled back. Without it about one answer in a
            hundred has a relative residual above 1e-3.
        eps: its three tolerances (1e-8 is the library's).
        max_iter: iterations.

    Raises:
        SolverError: a setting is out of range.
    """

    rows: int = 5
    cost_scale: float = 1e3
    eps: float = 1e-9
    max_iter: int = 100
    name: ClassVar[str] = "clarabel"

    def __post_init__(self) -> None:
        checks.like_defaults(self, rows=ROWS)

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Every subproblem is supported."""
        return None

    def start(self, qp: NullSpaceQP) -> ClarabelSession:
        """Set the workspace up with the shape and the equilibration of ``qp``."""
        return ClarabelSession(self, qp)


class ClarabelSession:
    """One workspace, and the values in its column-compressed order."""

    def __init__(self, settings: Clarabel, qp: NullSpaceQP) -> None:
        self._settings = settings
        self._build(qp)

    def _build(self, qp: NullSpaceQP) -> None:
        self._shape = m, n = assembled(qp, self._settings.rows).A.shape
        upper = np.concatenate([np.arange(j + 1) * n + j for j in range(n)])  # upper triangle of P
        self._P, self._q, self._b = np.empty(len(upper)), np.empty(n), np.empty(m + 2 * n)
        self._A = np.ones((n, m + 2))
        self._A[:, m + 1] = -1.0
        self._back = 1.0 / self._settings.cost_scale
        self._load = Loader(
            self._settings.rows, self._settings.cost_scale, P=np.empty((n, n)), packed=self._P, p=self._q,
            A=self._A[:, :m].T, low=self._b[:m], high=self._b[:m], lower=self._b[m + n :], upper=self._b[m : m + n],
            signs=(1.0, -1.0, 1.0),
        )  # fmt: skip
        self._load(qp)
        below = np.concatenate([np.append(np.arange(m), [m + j, m + n + j]) for j in range(n)])
        P = sparse.csc_matrix((self._P, upper // n, np.cumsum(np.arange(n + 1))), shape=(n, n))
        stacked = (self._A.ravel(), below, (m + 2) * np.arange(n + 1))
        options = clarabel.DefaultSettings()
        options.verbose, options.presolve_enable, options.max_threads = False, False, 1
        options.tol_feas = options.tol_gap_abs = options.tol_gap_rel = self._settings.eps
        options.max_iter = self._settings.max_iter
        cones = [clarabel.ZeroConeT(m), clarabel.NonnegativeConeT(2 * n)]
        matrix = sparse.csc_matrix(stacked, shape=(m + 2 * n, n))
        self._core: Any = clarabel.DefaultSolver(P, self._q, matrix, self._b, cones, options)

    def update(self, qp: NullSpaceQP) -> None:
        """Hand the subproblem to the library; another shape than the last one's starts a new workspace."""
        if not self._load(qp):
            self._build(qp)
        self._core.update(P=self._P, q=self._q, A=self._A.ravel(), b=self._b)

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem."""
        self.update(qp)
        found = self._core.solve()
        status = next((ours for theirs, ours in _STATUS if found.status == theirs), Status.NUMERICAL)
        if status not in (Status.SOLVED, Status.MAX_ITER, Status.TIME_LIMIT):
            return no_answer(qp.n, status, found.iterations)
        y = self._load.lifted(np.array(found.z[: self._shape[0]]), self._back)
        return Solution(np.array(found.x), y, status, found.iterations)

    def truncated(self, qp: NullSpaceQP, iterations: int) -> Solution:
        """The iterate after so many iterations: an interior-point method always begins anew."""
        options = self._core.get_settings()
        options.max_iter = iterations
        self._core.update(settings=options)
        try:
            return self.solve(qp)
        finally:
            options.max_iter = self._settings.max_iter
            self._core.update(settings=options)
