"""DAQP: a dual active-set method.

Arnstrom, Bemporad and Axehill 2022, "A dual active-set solver for embedded quadratic programming
using recursive LDL^T updates".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from daqp import Model

from moc_opt.solvers.base import Status
from moc_opt.solvers.library import Adapter, LibrarySession, Outcome

EQUALITY = 5
_STATUS = {1: Status.SOLVED, 2: Status.SOLVED, -1: Status.INFEASIBLE, -4: Status.MAX_ITER, -7: Status.TIME_LIMIT}


class DAQPSession(LibrarySession):
    """One workspace of DAQP. In its arrays, the bounds come before the equality rows."""

    def _allocate(self, m: int, n: int) -> dict[str, Any]:
        self._P, self._p, self._A = np.empty((n, n)), np.empty(n), np.empty((m, n))
        self._lower, self._upper = lower, upper = np.empty(n + m), np.empty(n + m)
        self._fresh = np.concatenate([np.zeros(n, dtype=np.int32), np.full(m, EQUALITY, dtype=np.int32)])
        self._sense = self._fresh.copy()
        return {
            "P": self._P, "p": self._p, "A": self._A,
            "low": lower[n:], "high": upper[n:], "lower": lower[:n], "upper": upper[:n],
        }  # fmt: skip

    def _set_up(self, m: int, n: int) -> None:
        self._core, settings = Model(), self._settings
        tolerances = {"primal_tol": settings.primal_tol, "dual_tol": settings.dual_tol}
        self._core.settings = {**tolerances, "iter_limit": settings.max_iter}
        # After a failed set-up (a negative flag), `update` is impossible.
        self._flag, _ = self._core.setup(self._P, self._p, self._A, self._upper, self._lower, self._sense)

    def _hand_over(self) -> None:
        if self._flag < 0:
            self._sense[:] = self._fresh
            self._set_up(self._m, self._n)
        else:
            self._flag = self._core.update(self._P, self._p, self._A, self._upper, self._lower, None)

    def _run(self) -> Outcome:
        if self._flag < 0:
            return _STATUS.get(self._flag, Status.NUMERICAL), 0, self._p, self._p
        x, _, code, info = self._core.solve()
        return _STATUS.get(code, Status.NUMERICAL), info["iterations"], x, info["lam"][self._n :]


@dataclass(frozen=True)
class DAQP(Adapter):
    """DAQP with a persistent workspace.

    Args:
        rows: 6 equality rows (tip and wrist), or 5 independent ones. With 6, daqp fails on 1 % of the problems.
        cost_scale: factor of P and p.
        primal_tol, dual_tol: tolerances of the library.
        max_iter: limit on the iterations of a solve.
    """

    rows: int = 5
    cost_scale: float = 1e3
    primal_tol: float = 1e-9
    dual_tol: float = 1e-12
    max_iter: int = 1000
    name = "daqp"
    session = DAQPSession
