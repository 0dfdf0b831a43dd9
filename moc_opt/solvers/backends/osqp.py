"""OSQP: operator splitting with one factorisation a tick, set up once and updated in place.

Stellato et al. 2020, "OSQP: an operator splitting solver for quadratic programs". OSQP knows only
l <= A x <= u, so the box becomes n rows below the equalities.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from osqp import ext_builtin

from moc_opt.qp.equalities import ROWS, assembled
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers import checks
from moc_opt.solvers.backends.buffers import Loader
from moc_opt.solvers.base import Solution, Status, no_answer

Array = NDArray[np.float64]

_CODE = ext_builtin.osqp_status_type
# "Inaccurate" means that a ten times looser tolerance was met when the iterations ran out: not solved.
_STATUS = {
    int(_CODE.OSQP_SOLVED): Status.SOLVED,
    int(_CODE.OSQP_PRIMAL_INFEASIBLE): Status.INFEASIBLE,
    int(_CODE.OSQP_SOLVED_INACCURATE): Status.MAX_ITER,
    int(_CODE.OSQP_PRIMAL_INFEASIBLE_INACCURATE): Status.MAX_ITER,
    int(_CODE.OSQP_MAX_ITER_REACHED): Status.MAX_ITER,
    int(_CODE.OSQP_TIME_LIMIT_REACHED): Status.TIME_LIMIT,
}
_HAS_X = (Status.SOLVED, Status.MAX_ITER, Status.TIME_LIMIT)


@dataclass(frozen=True)
class OSQP:
    """OSQP through its native interface.

    The library's own tolerance of 1e-3 is ten times the whole gradient of this problem
    (c2 |grad_mu| is about 1e-4): it then claims success, and nineteen answers in twenty are not optimal.
    eps = 1e-8 with costs times 100 left no wrong claim on some thousand random problems, for twice the
    iterations; one in two hundred is left unsolved at max_iter.
    ``OSQP(eps=1e-3, eps_rel=1e-3, cost_scale=1.0)`` is the library as it comes.

    Args:
        rows: 5 or 6 equality rows.
        cost_scale: multiplies P and p; the duals are scaled back.
        eps: absolute tolerance on the scaled problem; eps_rel: the relative one.
        max_iter: iterations a tick.
        check_termination: iterations between two looks at the residuals.
        polishing: solve the active set's equations once more at the end.
        warm: start from the last tick's answer.

    Raises:
        SolverError: a setting is out of range.
    """

    rows: int = 5
    cost_scale: float = 1e2
    eps: float = 1e-8
    eps_rel: float = 0.0
    max_iter: int = 4000
    check_termination: int = 25
    polishing: bool = False
    warm: bool = True
    name: ClassVar[str] = "osqp"

    def __post_init__(self) -> None:
        checks.like_defaults(self, rows=ROWS)

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Every subproblem is supported."""
        return None

    def start(self, qp: NullSpaceQP) -> OSQPSession:
        """Set the workspace up with the shape and the scaling of ``qp``."""
        return OSQPSession(self, qp)


class OSQPSession:
    """One OSQP workspace: dense sparsity patterns, so that every tick only replaces values."""

    def __init__(self, settings: OSQP, qp: NullSpaceQP) -> None:
        self._settings = settings
        self._build(qp)

    def _build(self, qp: NullSpaceQP) -> None:
        self._shape = m, n = assembled(qp, self._settings.rows).A.shape
        # The upper triangle of P and the columns of [A; I], column by column: explicit zeros stay.
        upper = np.concatenate([np.arange(j + 1) * n + j for j in range(n)])
        self._P = np.empty(len(upper))
        self._A = np.ones((n, m + 1))
        self._q, self._l, self._u = np.empty(n), np.empty(m + n), np.empty(m + n)
        self._back = 1.0 / self._settings.cost_scale
        self._zeros = self._last = self._before = np.zeros(n), np.zeros(m + n)  # x and all multipliers
        self._load = Loader(
            self._settings.rows, self._settings.cost_scale, P=np.empty((n, n)), packed=self._P, p=self._q,
            A=self._A[:, :m].T, low=self._l[:m], high=self._u[:m], lower=self._l[m:], upper=self._u[m:],
        )  # fmt: skip
        self._load(qp)
        ends = np.cumsum(np.arange(n + 1))
        P_csc = sparse.csc_matrix((self._P, upper // n, ends), shape=(n, n))
        below = np.concatenate([np.append(np.arange(m), m + j) for j in range(n)])
        A_csc = sparse.csc_matrix((self._A.ravel(), below, (m + 1) * np.arange(n + 1)), shape=(m + n, n))
        core = ext_builtin
        options = core.OSQPSettings()
        core.osqp_set_default_settings(options)
        options.verbose = 0
        options.eps_abs, options.eps_rel = self._settings.eps, self._settings.eps_rel
        options.max_iter = self._settings.max_iter
        options.check_termination = self._settings.check_termination
        options.polishing = int(self._settings.polishing)
        self._options, self._rho = options, options.rho
        self._core: Any = core.OSQPSolver(
            core.CSC(P_csc), self._q, core.CSC(A_csc), self._l, self._u, m + n, n, options
        )

    def update(self, qp: NullSpaceQP) -> None:
        """Hand the subproblem to the library; another shape than the last one's starts a new workspace."""
        if not self._load(qp):
            self._build(qp)
        core = self._core
        core.update_data_vec(q=self._q, l=self._l, u=self._u)
        core.update_data_mat(P_x=self._P, P_i=None, A_x=self._A.reshape(-1), A_i=None)

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem."""
        self.update(qp)
        core, (m, n) = self._core, self._shape
        self._before = self._last
        if not self._settings.warm:
            core.update_rho(self._rho)
            core.warm_start(*self._zeros)
        core.solve()
        info = core.info
        status = _STATUS.get(info.status_val, Status.NUMERICAL)
        if status not in _HAS_X:
            return no_answer(n, status, info.iter)
        found = core.solution
        self._last = x, y = found.x, found.y
        return Solution(x, self._load.lifted(y[:m], self._back), status, info.iter)

    def truncated(self, qp: NullSpaceQP, iterations: int) -> Solution:
        """The iterate after so many iterations, from where the last solve began; the next one goes on from here."""
        core, options = self._core, self._options
        core.warm_start(*self._before)
        options.max_iter = iterations
        core.update_settings(options)
        try:
            return self.solve(qp)
        finally:
            options.max_iter = self._settings.max_iter
            self._core.update_settings(options)
