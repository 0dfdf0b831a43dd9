"""quadprog: the dual active-set method of Goldfarb and Idnani (1983), for strictly convex problems."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import quadprog

from moc_opt.solvers.base import Status
from moc_opt.solvers.library import Adapter, LibrarySession, Outcome


class QuadprogSession(LibrarySession):
    """Constraints C^T x >= b: first the m equality rows, which hold with =, then x >= lower and -x >= -upper."""

    dual_sign = -1.0

    def _allocate(self, m: int, n: int) -> dict[str, Any]:
        self._C, self._b = np.zeros((n, m + 2 * n), order="F"), np.empty(m + 2 * n)
        self._C[:, m : m + n] = np.eye(n)
        self._C[:, m + n :] = -np.eye(n)
        self._P, self._a = np.empty((n, n), order="F"), np.empty(n)
        return {
            "P": self._P.T, "p": self._a, "A": self._C[:, :m].T, "low": self._b[:m], "high": self._b[:m],
            "lower": self._b[m : m + n], "upper": self._b[m + n :], "signs": (-1.0, 1.0, -1.0),
        }  # fmt: skip

    def _run(self) -> Outcome:
        try:
            x, _, _, steps, multipliers, _ = quadprog.solve_qp(self._P, self._a, self._C, self._b, self._m)
        except ValueError as error:  # any failure
            infeasible = "inconsistent" in str(error)
            return Status.INFEASIBLE if infeasible else Status.NUMERICAL, 0, self._a, self._a
        return Status.SOLVED, int(steps[0]), x, multipliers[: self._m]


@dataclass(frozen=True)
class Quadprog(Adapter):
    """The settings of quadprog."""

    cost_scale: float = 1.0
    name = "quadprog"
    session = QuadprogSession
    needs = "quadprog needs a positive definite cost"
