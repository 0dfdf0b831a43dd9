"""A wrapper that makes a solver fail, for tests of the controller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import SolverError
from moc_opt.qp.problem import NullSpaceQP, fields
from moc_opt.solvers.base import Session, Solution, Solver, Status, no_answer
from moc_opt.solvers.exact import Exact

Kind = Literal["fail", "nan", "lie", "raise", "outside", "rig", "malformed"]
KINDS: tuple[Kind, ...] = get_args(Kind)


class InjectedFault(SolverError):
    """Raised on purpose."""


def draw(seed: int, rate: float, ticks: int) -> NDArray[np.bool_]:
    """Return flags (ticks,), each True with probability ``rate``."""
    return np.random.default_rng(seed).uniform(size=ticks) < rate


@dataclass(frozen=True)
class Faulty:
    """A solver that fails at random ticks.

    Args:
        inner: the wrapped solver. Its answers are used at ticks without a fault.
        kind: "fail": no answer; "nan": x is NaN; "lie": optimum for -pull; "raise": an exception;
            "outside": x outside the bounds; "rig": the subproblem is rewritten to fit x; "malformed": complex duals.
        rate: probability of a fault at a tick, 0 to 1.
        seed: seed of the draw.
    """

    inner: Solver
    kind: Kind
    rate: float = 0.05
    seed: int = 0

    @property
    def name(self) -> str:
        """The wrapped solver's name and the fault."""
        return f"{self.inner.name}+{self.kind}"

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Ask the wrapped solver."""
        return self.inner.supports(qp)

    def start(self, qp: NullSpaceQP) -> FaultySession:
        """Return a session, which fails at the ticks that `draw` flags."""
        return FaultySession(self, self.inner.start(qp), qp)


class FaultySession:
    """A session. ``faults`` counts the faulty ticks."""

    def __init__(self, settings: Faulty, inner: Session, qp: NullSpaceQP) -> None:
        self._settings, self._inner = settings, inner
        self._rng = np.random.default_rng(settings.seed)
        self._liar = Exact().start(qp)
        if hasattr(inner, "observe"):
            self.observe = inner.observe  # the controller calls ``observe`` if it exists
        self.faults = 0

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Solve one subproblem. At a faulty tick, return or raise the fault instead."""
        if self._rng.uniform() >= self._settings.rate:
            return self._inner.solve(qp)
        self.faults += 1
        match self._settings.kind:
            case "raise":
                raise InjectedFault("faulty: raised on purpose")
            case "fail":
                return no_answer(qp.n, Status.NUMERICAL)
            case "nan":
                return Solution(np.full(qp.n, np.nan), None, Status.SOLVED)
            case "outside":
                return Solution(10.0 * qp.upper + 1.0, None, Status.SOLVED)
            case "malformed":
                return self._inner.solve(qp)._replace(y=np.zeros(6, dtype=complex))
            case "rig":
                qp.row.setflags(write=True)
                part = fields(qp.row)
                part.A[:], part.b[:], part.lower[:], part.upper[:] = 0.0, 0.0, -1e3, 1e3
                return Solution(np.full(qp.n, 50.0), None, Status.SOLVED)
            case "lie":
                row = np.array(qp.row)
                fields(row).pull[:] *= -1.0
                return self._liar.solve(NullSpaceQP.from_row(row))
