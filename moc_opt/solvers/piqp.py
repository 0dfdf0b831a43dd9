"""PIQP: a dense proximal interior-point method without a warm start.

Schwan, Jiang, Kuhn and Jones 2023, "PIQP: a proximal interior-point quadratic programming solver".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import piqp

from moc_opt.solvers.base import Status
from moc_opt.solvers.library import Adapter, Outcome, TruncatedSession

_STATUS = {
    piqp.PIQP_SOLVED: Status.SOLVED,
    piqp.PIQP_PRIMAL_INFEASIBLE: Status.INFEASIBLE,
    piqp.PIQP_MAX_ITER_REACHED: Status.MAX_ITER,
}


class PIQPSession(TruncatedSession):
    """One dense PIQP workspace."""

    def _allocate(self, m: int, n: int) -> dict[str, Any]:
        # Stored by columns, because the library copies row-major matrices.
        P, A, p = np.empty((n, n), order="F"), np.empty((m, n), order="F"), np.empty(n)
        b, lower, upper = np.empty(m), np.empty(n), np.empty(n)
        self._data = (P, p, A, b, None, None, None, lower, upper)
        return {"P": P.T, "p": p, "A": A, "low": b, "high": b, "lower": lower, "upper": upper}

    def _set_up(self, m: int, n: int) -> None:
        self._core, eps = piqp.DenseSolver(), self._settings.eps
        options = self._core.settings
        options.eps_abs, options.eps_rel = eps, 0.0
        options.eps_duality_gap_abs, options.eps_duality_gap_rel = eps, 0.0
        options.max_iter = self._settings.max_iter
        self._core.setup(*self._data)

    def _hand_over(self) -> None:
        self._core.update(*self._data)

    def _run(self) -> Outcome:
        status = _STATUS.get(self._core.solve(), Status.NUMERICAL)
        result = self._core.result
        return status, result.info.iter, result.x.copy(), result.y

    def _limit(self, iterations: int) -> None:
        self._core.settings.max_iter = iterations


@dataclass(frozen=True)
class PIQP(Adapter):
    """PIQP's dense back-end.

    Args:
        eps: absolute tolerance on the scaled problem.
        max_iter: limit on the iterations of a solve.
    """

    rows: int = 5
    cost_scale: float = 1e3
    eps: float = 1e-9
    max_iter: int = 250
    name = "piqp"
    session = PIQPSession
