"""ProxQP: a proximal augmented Lagrangian, dense, set up once and updated in place.

Bambade et al. 2022, "PROX-QP: yet another quadratic programming solver for robotics and beyond".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from proxsuite import proxqp

from moc_opt.qp.equalities import ROWS, assembled
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers import checks
from moc_opt.solvers.backends.buffers import Loader
from moc_opt.solvers.base import Solution, Status, no_answer

Array = NDArray[np.float64]

_CODE = proxqp.QPSolverOutput
_STATUS = {
    _CODE.PROXQP_SOLVED: Status.SOLVED,
    _CODE.PROXQP_PRIMAL_INFEASIBLE: Status.INFEASIBLE,
    _CODE.PROXQP_MAX_ITER_REACHED: Status.MAX_ITER,
}
_NO_X = (Status.INFEASIBLE, Status.NUMERICAL)
_SOLVED, _TROUBLE = Status.SOLVED, Status.NUMERICAL
_GUESS = proxqp.InitialGuess
_COLD = _GUESS.EQUALITY_CONSTRAINED_INITIAL_GUESS
# The last answer with fresh step sizes. WARM_START_WITH_PREVIOUS_RESULT also keeps the last active set
# and penalties, and after a jump of the data it can claim success at the opposite bound.
_WARM = _GUESS.COLD_START_WITH_PREVIOUS_RESULT


@dataclass(frozen=True)
class ProxQP:
    """ProxQP's dense back-end.

    With the library's eps_primal_inf = 1e-4 a third of these feasible problems are called infeasible
    (three quarters where regularization = 0: their cost is smaller than that); with 1e-12 many infeasible ones run
    into max_iter. With costs times 10 everything from 1e-10 to 1e-7 told 4800 feasible from 4800
    infeasible ones without an error; with costs times 1e3 a rare feasible one is called infeasible.

    Args:
        rows: 5 or 6 equality rows.
        box: "bounds" hands the box over as bounds, "rows" as n inequality rows.
        cost_scale: multiplies P and p; the duals are scaled back.
        eps: absolute tolerance on the scaled problem (1e-5 is the library's).
        eps_primal_inf: tolerance of the proof of infeasibility (1e-4 is the library's).
        max_iter: outer iterations; max_iter_in: inner ones in each. Feasible problems take about ten
            in all; the library's 10000 and 1500 make an undecided one run for minutes.
        warm: start from the last tick's answer where that was solved.

    Raises:
        SolverError: a setting is out of range.
    """

    rows: int = 5
    box: Literal["bounds", "rows"] = "bounds"
    cost_scale: float = 10.0
    eps: float = 1e-9
    eps_primal_inf: float = 1e-9
    max_iter: int = 100
    max_iter_in: int = 50
    warm: bool = True
    name: ClassVar[str] = "proxqp"

    def __post_init__(self) -> None:
        checks.like_defaults(self, rows=ROWS, box=("bounds", "rows"))

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Every subproblem is supported."""
        return None

    def start(self, qp: NullSpaceQP) -> ProxQPSession:
        """Set the workspace up with the shape and the preconditioner of ``qp``."""
        return ProxQPSession(self, qp)


class ProxQPSession:
    """One dense ProxQP workspace."""

    def __init__(self, settings: ProxQP, qp: NullSpaceQP) -> None:
        self._settings = settings
        self._build(qp)

    def _build(self, qp: NullSpaceQP) -> None:
        settings = self._settings
        m, n = assembled(qp, settings.rows).A.shape
        P, p, A, b, lower, upper = (np.empty(shape) for shape in ((n, n), n, (m, n), m, n, n))
        self._load = Loader(
            settings.rows, settings.cost_scale, P=P, p=p, A=A, low=b, high=b, lower=lower, upper=upper
        )
        self._load(qp)
        bounds = settings.box == "bounds"
        box = (None, None, None) if bounds else (np.eye(n),)
        self._data = (P, p, A, b, *box, lower, upper)
        self._back = 1.0 / settings.cost_scale
        core = proxqp.dense.QP(n, m, 0 if bounds else n, bounds)
        options = core.settings
        options.eps_abs, options.eps_rel = settings.eps, 0.0
        options.eps_primal_inf = settings.eps_primal_inf
        options.max_iter, options.max_iter_in = settings.max_iter, settings.max_iter_in
        options.initial_guess = _COLD
        self._core, self._warm = core, False
        core.init(*self._data)

    def update(self, qp: NullSpaceQP) -> None:
        """Hand the subproblem to the library; another shape than the last one's starts a new workspace."""
        if not self._load(qp):
            self._build(qp)
        self._core.update(*self._data)

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem."""
        self.update(qp)
        core = self._core
        core.solve()
        result = core.results
        info = result.info
        status = _STATUS.get(info.status, _TROUBLE)
        iterations = info.iter
        if status is not _SOLVED and self._warm:
            # A stale start must not decide that a problem has no answer: ask again from scratch. The
            # data go in again because a failed run leaves the box scaled.
            self._guess(False)
            core.update(*self._data)
            core.solve()
            status = _STATUS.get(info.status, _TROUBLE)
            iterations += info.iter
        if self._settings.warm and self._warm is not (status is _SOLVED):
            self._guess(status is _SOLVED)
        if status in _NO_X:
            return no_answer(qp.n, status, iterations)
        return Solution(result.x.copy(), self._load.lifted(result.y, self._back), status, iterations)

    def _guess(self, warm: bool) -> None:
        self._core.settings.initial_guess = _WARM if warm else _COLD
        self._warm = warm
