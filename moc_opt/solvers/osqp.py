"""OSQP: operator splitting with one factorisation per tick.

Stellato et al. 2020, "OSQP: an operator splitting solver for quadratic programs".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from osqp import ext_builtin

from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.base import Solution, Status
from moc_opt.solvers.library import Adapter, Outcome, TruncatedSession, stacked, upper_triangle

_CODE = ext_builtin.osqp_status_type
# An "inaccurate" answer meets only a ten times larger tolerance.
_STATUS = {
    int(_CODE.OSQP_SOLVED): Status.SOLVED,
    int(_CODE.OSQP_PRIMAL_INFEASIBLE): Status.INFEASIBLE,
    int(_CODE.OSQP_SOLVED_INACCURATE): Status.MAX_ITER,
    int(_CODE.OSQP_PRIMAL_INFEASIBLE_INACCURATE): Status.MAX_ITER,
    int(_CODE.OSQP_MAX_ITER_REACHED): Status.MAX_ITER,
    int(_CODE.OSQP_TIME_LIMIT_REACHED): Status.TIME_LIMIT,
}


class OSQPSession(TruncatedSession):
    """One OSQP workspace."""

    def _allocate(self, m: int, n: int) -> dict[str, Any]:
        self._P = np.empty(n * (n + 1) // 2)
        self._A = np.ones((n, m + 1))  # the columns of [A; I], with explicit zeros
        self._q, self._l, self._u = np.empty(n), np.empty(m + n), np.empty(m + n)
        self._last = self._before = np.zeros(n), np.zeros(m + n)  # x and all multipliers
        return {
            "P": np.empty((n, n)), "packed": self._P, "p": self._q, "A": self._A[:, :m].T,
            "low": self._l[:m], "high": self._u[:m], "lower": self._l[m:], "upper": self._u[m:],
        }  # fmt: skip

    def _set_up(self, m: int, n: int) -> None:
        core, settings = ext_builtin, self._settings
        options = core.OSQPSettings()
        core.osqp_set_default_settings(options)
        options.verbose = 0
        options.eps_abs, options.eps_rel = settings.eps, settings.eps_rel
        options.max_iter, options.check_termination = settings.max_iter, settings.check_termination
        options.polishing = int(settings.polishing)
        self._options = options
        P, A = upper_triangle(self._P, n), stacked(self._A, 1)
        self._core: Any = core.OSQPSolver(core.CSC(P), self._q, core.CSC(A), self._l, self._u, m + n, n, options)

    def _hand_over(self) -> None:
        self._core.update_data_vec(q=self._q, l=self._l, u=self._u)
        self._core.update_data_mat(P_x=self._P, P_i=None, A_x=self._A.reshape(-1), A_i=None)

    def _run(self) -> Outcome:
        core = self._core
        self._before = self._last
        core.solve()
        status = _STATUS.get(core.info.status_val, Status.NUMERICAL)
        x, y = core.solution.x, core.solution.y
        if status in (Status.SOLVED, Status.MAX_ITER, Status.TIME_LIMIT):
            self._last = x, y
        return status, core.info.iter, x, y[: self._m]

    def _limit(self, iterations: int) -> None:
        self._options.max_iter = iterations
        self._core.update_settings(self._options)

    def truncated(self, qp: NullSpaceQP, iterations: int) -> Solution:
        """Repeat the previous solve from its starting point, with a limit of ``iterations`` >= 1."""
        self._core.warm_start(*self._before)
        return super().truncated(qp, iterations)


@dataclass(frozen=True)
class OSQP(Adapter):
    """OSQP through its native interface.

    Args:
        eps, eps_rel: absolute and relative tolerance on the scaled problem.
        max_iter: limit on the iterations of a solve.
        check_termination: number of iterations between checks of the residuals.
        polishing: whether OSQP guesses the active constraints at the end and solves the equations that they give.
    """

    rows: int = 5
    cost_scale: float = 1e2
    eps: float = 1e-8
    eps_rel: float = 0.0
    max_iter: int = 4000
    check_termination: int = 25
    polishing: bool = False
    name = "osqp"
    session = OSQPSession
