"""DAQP: a dual active-set method, set up once and updated in place.

Arnstrom, Bemporad and Axehill 2022, "A dual active-set solver for embedded quadratic programming
using recursive LDL^T updates". Where the cost is only semi-definite it takes proximal steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from daqp import Model
from numpy.typing import NDArray

from moc_opt.qp.equalities import ROWS, assembled
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers import checks
from moc_opt.solvers.backends.buffers import Loader
from moc_opt.solvers.base import Solution, Status, no_answer

Array = NDArray[np.float64]

EQUALITY = 5
_STATUS = {
    1: Status.SOLVED,
    2: Status.SOLVED,
    -1: Status.INFEASIBLE,
    -4: Status.MAX_ITER,
    -7: Status.TIME_LIMIT,
}
_HAS_X = (Status.SOLVED, Status.MAX_ITER, Status.TIME_LIMIT)


@dataclass(frozen=True)
class DAQP:
    """DAQP's reusable workspace.

    Args:
        rows: 5 or 6 equality rows; six dependent ones fail about one problem in a hundred.
        cost_scale: multiplies P and p; the duals are scaled back. Without it, and without regularization, one
            answer in twenty stops at the wrong end of the self-motion.
        primal_tol, dual_tol: the library's 1e-6 and 1e-12.
        max_iter: iterations.
        warm: start from the last tick's active set.

    Raises:
        SolverError: a setting is out of range.
    """

    rows: int = 5
    cost_scale: float = 1e3
    primal_tol: float = 1e-9
    dual_tol: float = 1e-12
    max_iter: int = 1000
    warm: bool = True
    name: ClassVar[str] = "daqp"

    def __post_init__(self) -> None:
        checks.like_defaults(self, rows=ROWS)

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Every subproblem is supported."""
        return None

    def start(self, qp: NullSpaceQP) -> DAQPSession:
        """Set the workspace up with the shape of ``qp``."""
        return DAQPSession(self, qp)


class DAQPSession:
    """One workspace and its buffers: bounds first, then the equality rows."""

    def __init__(self, settings: DAQP, qp: NullSpaceQP) -> None:
        self._settings = settings
        self._build(qp)

    def _build(self, qp: NullSpaceQP) -> None:
        self._shape = m, n = assembled(qp, self._settings.rows).A.shape
        self._P, self._p, self._A = np.empty((n, n)), np.empty(n), np.empty((m, n))
        self._lower, self._upper = np.empty(n + m), np.empty(n + m)
        self._fresh = np.concatenate([np.zeros(n, dtype=np.int32), np.full(m, EQUALITY, dtype=np.int32)])
        self._sense = self._fresh.copy()
        self._back = 1.0 / self._settings.cost_scale
        lower, upper = self._lower, self._upper
        self._load = Loader(
            self._settings.rows, self._settings.cost_scale, P=self._P, p=self._p, A=self._A,
            low=lower[n:], high=upper[n:], lower=lower[:n], upper=upper[:n],
        )  # fmt: skip
        self._load(qp)
        self._core = Model()
        settings = self._settings
        self._core.settings = {
            "primal_tol": settings.primal_tol, "dual_tol": settings.dual_tol, "iter_limit": settings.max_iter,
        }  # fmt: skip
        # Below zero where the library could not set the problem up: it raises at whatever follows but another setup.
        self._flag, _ = self._core.setup(self._P, self._p, self._A, self._upper, self._lower, self._sense)

    def update(self, qp: NullSpaceQP) -> None:
        """Hand the subproblem to the library; another shape than the last one's starts a new workspace.

        So does one that follows a problem the library could not set up.
        """
        if self._flag < 0 or not self._load(qp):
            self._build(qp)
            return
        sense = None
        if not self._settings.warm:
            self._sense[:] = self._fresh
            sense = self._sense
        self._flag = self._core.update(self._P, self._p, self._A, self._upper, self._lower, sense)

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem."""
        self.update(qp)
        core, n = self._core, self._shape[1]
        if self._flag < 0:
            return no_answer(n, _STATUS.get(self._flag, Status.NUMERICAL))
        x, _, code, info = core.solve()
        status = _STATUS.get(code, Status.NUMERICAL)
        if status not in _HAS_X:
            return no_answer(n, status, info["iterations"])
        return Solution(x, self._load.lifted(info["lam"][n:], self._back), status, info["iterations"])
