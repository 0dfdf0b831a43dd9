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

from moc_opt.solvers import checks
from moc_opt.solvers.base import Solution, Status, no_answer
from moc_opt.solvers.rows import ROWS, equalities
from moc_opt.subproblem import NullSpaceQP

Array = NDArray[np.float64]

_STATUS = {
    piqp.PIQP_SOLVED: Status.SOLVED,
    piqp.PIQP_PRIMAL_INFEASIBLE: Status.INFEASIBLE,
    piqp.PIQP_MAX_ITER_REACHED: Status.MAX_ITER,
}


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
        checks.one_of(self.name, "rows", self.rows, ROWS)
        checks.positive(self.name, "cost_scale", self.cost_scale, 1e3)
        checks.positive(self.name, "eps", self.eps, 1e-9)
        checks.whole(self.name, "max_iter", self.max_iter, 250)

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
        A, b, _ = equalities(qp, self._settings.rows)
        self._shape = m, n = A.shape
        # The library wants columns; handed rows it would copy them at every call.
        self._P, self._A, self._p = np.empty((n, n), order="F"), np.empty((m, n), order="F"), np.empty(n)
        self._back = 1.0 / self._settings.cost_scale
        self._core = core = piqp.DenseSolver()
        core.settings.eps_abs, core.settings.eps_rel = self._settings.eps, 0.0
        core.settings.eps_duality_gap_abs, core.settings.eps_duality_gap_rel = self._settings.eps, 0.0
        core.settings.max_iter = self._settings.max_iter
        self._load(qp, A)
        core.setup(self._P, self._p, self._A, b, None, None, None, qp.lower, qp.upper)

    def _load(self, qp: NullSpaceQP, A: Array) -> None:
        """Copy the matrices of ``qp`` into the buffers."""
        scale = self._settings.cost_scale
        np.multiply(qp.P, scale, out=self._P)
        np.multiply(qp.p, scale, out=self._p)
        self._A[:] = A

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem; another shape than the last one's starts a new workspace."""
        A, b, lift = equalities(qp, self._settings.rows)
        if A.shape != self._shape:
            self._build(qp)
        self._load(qp, A)
        part, core = qp.fields, self._core
        core.update(self._P, self._p, self._A, b, None, None, None, part.lower, part.upper)
        status = _STATUS.get(core.solve(), Status.NUMERICAL)
        result = core.result
        if status not in (Status.SOLVED, Status.MAX_ITER):
            return no_answer(qp.n, status, result.info.iter)
        y = np.dot(result.y, lift) * self._back
        return Solution(np.array(result.x), y, status, result.info.iter)
