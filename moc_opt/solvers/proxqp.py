"""ProxQP: a dense proximal augmented Lagrangian method.

Bambade et al. 2022, "PROX-QP: yet another quadratic programming solver for robotics and beyond".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from proxsuite import proxqp

from moc_opt.solvers.base import Status
from moc_opt.solvers.library import Adapter, LibrarySession, Outcome

_CODE = proxqp.QPSolverOutput
_STATUS = {
    _CODE.PROXQP_SOLVED: Status.SOLVED,
    _CODE.PROXQP_PRIMAL_INFEASIBLE: Status.INFEASIBLE,
    _CODE.PROXQP_MAX_ITER_REACHED: Status.MAX_ITER,
}
_COLD = proxqp.InitialGuess.EQUALITY_CONSTRAINED_INITIAL_GUESS
# After a jump of the data, WARM_START_WITH_PREVIOUS_RESULT can report success with x at the wrong bound.
_WARM = proxqp.InitialGuess.COLD_START_WITH_PREVIOUS_RESULT


class ProxQPSession(LibrarySession):
    """One dense ProxQP workspace."""

    def _allocate(self, m: int, n: int) -> dict[str, Any]:
        P, p, A, b, lower, upper = (np.empty(shape) for shape in ((n, n), n, (m, n), m, n, n))
        self._data = (P, p, A, b, None, None, None, lower, upper)
        return {"P": P, "p": p, "A": A, "low": b, "high": b, "lower": lower, "upper": upper}

    def _set_up(self, m: int, n: int) -> None:
        settings = self._settings
        self._core, self._warm = proxqp.dense.QP(n, m, 0, True), False
        options = self._core.settings
        options.eps_abs, options.eps_rel = settings.eps, 0.0
        options.eps_primal_inf = settings.eps_primal_inf
        options.max_iter, options.max_iter_in = settings.max_iter, settings.max_iter_in
        options.initial_guess = _COLD
        self._core.init(*self._data)

    def _hand_over(self) -> None:
        self._core.update(*self._data)

    def _run(self) -> Outcome:
        core, result = self._core, self._core.results
        core.solve()
        status, iterations = _STATUS.get(result.info.status, Status.NUMERICAL), result.info.iter
        if status is not Status.SOLVED and self._warm:
            # A failed solve leaves the bounds scaled, so the data are passed again.
            self._guess(False)
            self._hand_over()
            core.solve()
            status = _STATUS.get(result.info.status, Status.NUMERICAL)
            iterations += result.info.iter
        self._guess(status is Status.SOLVED)
        return status, iterations, result.x.copy(), result.y

    def _guess(self, warm: bool) -> None:
        self._core.settings.initial_guess = _WARM if warm else _COLD
        self._warm = warm


@dataclass(frozen=True)
class ProxQP(Adapter):
    """ProxQP's dense back-end.

    Args:
        eps: absolute tolerance on the scaled problem.
        eps_primal_inf: tolerance of the proof of infeasibility.
        max_iter, max_iter_in: limits on the outer iterations, and on the inner iterations of each outer one.
    """

    rows: int = 5
    cost_scale: float = 10.0
    eps: float = 1e-9
    eps_primal_inf: float = 1e-9
    max_iter: int = 100
    max_iter_in: int = 50
    name = "proxqp"
    session = ProxQPSession
