"""PIQP: a proximal interior-point method, dense, set up once and updated in place.

Schwan, Jiang, Kuhn and Jones 2023, "PIQP: a proximal interior-point quadratic programming solver".
An interior-point method has no warm start: what is kept from tick to tick is the workspace.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import piqp
from numpy.typing import NDArray

from moc_opt.qp.equalities import ROWS, assembled
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers import checks
from moc_opt.solvers.backends.buffers import Loader
from moc_opt.solvers.base import Solution, Status, no_answer

Array = NDArray[np.float64]

_STATUS = {
    piqp.PIQP_SOLVED: Status.SOLVED,
    piqp.PIQP_PRIMAL_INFEASIBLE: Status.INFEASIBLE,
    piqp.PIQP_MAX_ITER_REACHED: Status.MAX_ITER,
}
_HAS_X, _TROUBLE = (Status.SOLVED, Status.MAX_ITER), Status.NUMERICAL


@dataclass(frozen=True)
class PIQP:
    """PIQP's dense back-end.

    Args:
        rows: 5 or 6 equality rows.
        cost_scale: multiplies P and p; the duals are scaled back.
        eps: absolute tolerance on the scaled problem (1e-8 is the library's, with 1e-9 relative).
        max_iter: iterations.

    Raises:
        SolverError: a setting is out of range.
    """

    rows: int = 5
    cost_scale: float = 1e3
    eps: float = 1e-9
    max_iter: int = 250
    name: ClassVar[str] = "piqp"

    def __post_init__(self) -> None:
        checks.like_defaults(self, rows=ROWS)

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Every subproblem is supported."""
        return None

    def start(self, qp: NullSpaceQP) -> PIQPSession:
        """Set the workspace up with the shape and the scaling of ``qp``."""
        return PIQPSession(self, qp)


class PIQPSession:
    """One dense workspace."""

    def __init__(self, settings: PIQP, qp: NullSpaceQP) -> None:
        self._settings = settings
        self._build(qp)

    def _build(self, qp: NullSpaceQP) -> None:
        m, n = assembled(qp, self._settings.rows).A.shape
        # The library stores matrices by columns; rows it would copy at every call.
        self._P, self._A, self._p = np.empty((n, n), order="F"), np.empty((m, n), order="F"), np.empty(n)
        self._b, self._lower, self._upper = np.empty(m), np.empty(n), np.empty(n)
        self._load = Loader(
            self._settings.rows, self._settings.cost_scale, P=self._P.T, p=self._p, A=self._A,
            low=self._b, high=self._b, lower=self._lower, upper=self._upper,
        )  # fmt: skip
        self._back = 1.0 / self._settings.cost_scale
        self._core = core = piqp.DenseSolver()
        core.settings.eps_abs, core.settings.eps_rel = self._settings.eps, 0.0
        core.settings.eps_duality_gap_abs, core.settings.eps_duality_gap_rel = self._settings.eps, 0.0
        core.settings.max_iter = self._settings.max_iter
        self._load(qp)
        core.setup(self._P, self._p, self._A, self._b, None, None, None, self._lower, self._upper)

    def update(self, qp: NullSpaceQP) -> None:
        """Hand the subproblem to the library; another shape than the last one's starts a new workspace."""
        if not self._load(qp):
            self._build(qp)
        self._core.update(self._P, self._p, self._A, self._b, None, None, None, self._lower, self._upper)

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem."""
        self.update(qp)
        core = self._core
        status = _STATUS.get(core.solve(), _TROUBLE)
        result = core.result
        iterations = result.info.iter
        if status not in _HAS_X:
            return no_answer(qp.n, status, iterations)
        return Solution(result.x.copy(), self._load.lifted(result.y, self._back), status, iterations)

    def truncated(self, qp: NullSpaceQP, iterations: int) -> Solution:
        """The iterate after so many iterations: an interior-point method always begins anew."""
        options = self._core.settings
        options.max_iter = iterations
        try:
            return self.solve(qp)
        finally:
            self._core.settings.max_iter = self._settings.max_iter
