"""CasADi's own active-set QP solver, as ``casadi:qrqp``.

CasADi's other conic plug-ins bring a second copy of a library that has an adapter of its own here, and two copies in
one process share symbols, or fail on these problems: docs/solvers.md lists them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from moc_opt.errors import SolverError
from moc_opt.solvers.base import Status
from moc_opt.solvers.library import Adapter, LibrarySession, Outcome
from moc_opt.solvers.nlp import BufferedCall
from moc_opt.solvers.options import checked

_QUIET = {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": True}


class QRQPSession(LibrarySession):
    """One conic function and the arrays it reads and writes."""

    def _allocate(self, m: int, n: int) -> dict[str, Any]:
        h, g, a, lba, uba, lbx, ubx = (np.zeros(size) for size in (n * n, n, m * n, m, m, n, n))
        self._in = {"h": h, "g": g, "a": a, "lba": lba, "uba": uba, "lbx": lbx, "ubx": ubx}
        self._start = {"x0": np.zeros(n), "lam_a0": np.zeros(m), "lam_x0": np.zeros(n)}
        self._end = {"x": np.zeros(n), "lam_a": np.zeros(m), "lam_x": np.zeros(n)}
        P, A = h.reshape((n, n)), a.reshape((m, n), order="F")  # by columns, as CasADi stores them
        return {"P": P, "p": g, "A": A, "low": lba, "high": uba, "lower": lbx, "upper": ubx}

    def _set_up(self, m: int, n: int) -> None:
        form = {"h": ca.Sparsity.dense(n, n), "a": ca.Sparsity.dense(m, n)}
        options = {**_QUIET, "max_iter": 100, **self._settings.options}
        try:
            function = ca.conic("subproblem", "qrqp", form, options)
        except RuntimeError as error:
            raise SolverError(f"{self._settings.name}: options = {options} are refused: {error}") from error
        self._call = BufferedCall(function, {**self._in, **self._start}, self._end)

    def _run(self) -> Outcome:
        status = Status.SOLVED
        try:
            self._call.run()
        except RuntimeError:  # how CasADi reports a failure; asking for statistics every time costs 15 us
            text = str(self._call.stats().get("return_status", "")).lower()
            status = Status.MAX_ITER if "max" in text else Status.NUMERICAL
        keep = status is Status.SOLVED and self._settings.warm
        for start, end in zip(self._start.values(), self._end.values(), strict=True):
            start[:] = end if keep else 0.0
        return status, 0, self._end["x"].copy(), self._end["lam_a"]


@dataclass(frozen=True)
class QRQP(Adapter):
    """CasADi's qrqp.

    Args:
        rows: 5 or 6 equality rows; it fails on six.
        options: those of `moc_opt.solvers.options.ALLOWED`.
        warm: start from the last tick's answer and multipliers; after a jump of the data it can then
            claim success for a wrong answer.
    """

    rows: int = 5
    cost_scale: float = 1e3
    options: Mapping[str, Any] = field(default_factory=dict, hash=False)
    warm: bool = False
    name = "casadi:qrqp"
    session = QRQPSession
    needs = "casadi's qrqp cycles without regularization"

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "options", checked(self.name, self.options))
