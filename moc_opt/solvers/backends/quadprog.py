"""quadprog: the dual active-set method of Goldfarb and Idnani (1983), for strictly convex problems."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import quadprog
from numpy.typing import NDArray

from moc_opt.qp.equalities import assembled
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers import checks
from moc_opt.solvers.backends.buffers import Loader
from moc_opt.solvers.base import Solution, Status, no_answer

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Quadprog:
    """quadprog on five rows: on six dependent ones it fails from an inconsistency of 1e-12 on.

    It keeps nothing between calls; the session owns the buffers.

    Args:
        cost_scale: multiplies P and p; the duals are scaled back.

    Raises:
        SolverError: a setting is out of range.
    """

    cost_scale: float = 1.0
    name: ClassVar[str] = "quadprog"

    def __post_init__(self) -> None:
        checks.like_defaults(self)

    def supports(self, qp: NullSpaceQP) -> str | None:
        """It factorises P, which is singular without regularization."""
        if qp.regularization <= 1e-10 * (qp.c0 + qp.c1):
            return (
                f"quadprog needs a positive definite cost and regularization is {qp.regularization:g}: "
                "set regularization > 0"
            )
        return None

    def start(self, qp: NullSpaceQP) -> QuadprogSession:
        """Buffers of the shape of ``qp``."""
        return QuadprogSession(self, qp)


class QuadprogSession:
    """The constraint matrix C^T x >= b: equalities, then x >= lower, then -x >= -upper."""

    def __init__(self, settings: Quadprog, qp: NullSpaceQP) -> None:
        self._settings = settings
        self._build(qp)

    def _build(self, qp: NullSpaceQP) -> None:
        self._shape = m, n = assembled(qp, 5).A.shape
        self._C, self._b = np.zeros((n, m + 2 * n), order="F"), np.empty(m + 2 * n)
        self._C[:, m : m + n] = np.eye(n)
        self._C[:, m + n :] = -np.eye(n)
        self._P, self._a = np.empty((n, n), order="F"), np.empty(n)
        self._load = Loader(
            5, self._settings.cost_scale, P=self._P.T, p=self._a, A=self._C[:, :m].T, low=self._b[:m],
            high=self._b[:m], lower=self._b[m : m + n], upper=self._b[m + n :], signs=(-1.0, 1.0, -1.0),
        )  # fmt: skip
        self._load(qp)

    def update(self, qp: NullSpaceQP) -> None:
        """Write the subproblem into the arrays that the library reads; another shape takes new ones."""
        if not self._load(qp):
            self._build(qp)

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem."""
        if self._settings.supports(qp) is not None:
            return no_answer(qp.n, Status.UNSUPPORTED)
        self.update(qp)
        m, n = self._shape
        try:
            x, _, _, steps, multipliers, _ = quadprog.solve_qp(self._P, self._a, self._C, self._b, m)
        except ValueError as error:  # its only way to say so
            infeasible = "inconsistent" in str(error)
            return no_answer(n, Status.INFEASIBLE if infeasible else Status.NUMERICAL)
        y = self._load.lifted(multipliers[:m], -1.0 / self._settings.cost_scale)
        return Solution(x, y, Status.SOLVED, int(steps[0]))
