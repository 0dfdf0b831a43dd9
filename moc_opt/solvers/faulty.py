"""Any solver, made to fail at random ticks: for testing what stands behind it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import SolverError, is_number
from moc_opt.qp.problem import NullSpaceQP, fields
from moc_opt.solvers.base import Session, ShownBySettings, Solution, Solver, Status, no_answer
from moc_opt.solvers.exact import Exact

Kind = Literal["fail", "nan", "lie", "raise", "outside", "rig", "malformed"]
KINDS: tuple[Kind, ...] = get_args(Kind)


class InjectedFault(SolverError):
    """Raised on purpose by a solver of kind "raise"."""


@dataclass(frozen=True)
class Faulty:
    """A solver that answers wrongly at a seeded share of the ticks.

    Args:
        inner: the solver that answers otherwise.
        kind: "fail" gives no answer and says so, "nan" claims success for NaN, "lie" claims success for
            the best answer to the opposite gradient (feasible: only an optimality check finds it),
            "outside" for an answer beyond the box, "raise" raises, "rig" answers 50 rad/s and rewrites the subproblem
            so that this fits, "malformed" gives duals of another kind. The solver inside is not asked then.
        rate: share of faulty ticks, 0 to 1.
        seed: of the draw; the same seed corrupts the same ticks.
    """

    inner: Solver
    kind: Kind
    rate: float = 0.05
    seed: int = 0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise SolverError(f"faulty: kind = {self.kind!r} is not one of {', '.join(KINDS)}")
        if not (is_number(self.rate) and 0.0 <= self.rate <= 1.0):
            raise SolverError(f"faulty: rate = {self.rate!r} is a share of the ticks: give 0 to 1")

    @property
    def name(self) -> str:
        """Name of the wrapped solver, and its fault."""
        return f"{self.inner.name}+{self.kind}"

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return what the solver inside supports."""
        return self.inner.supports(qp)

    def start(self, qp: NullSpaceQP) -> FaultySession:
        """Return a session; `draw` says which of its answers are replaced."""
        return FaultySession(self, self.inner.start(qp), qp)


def draw(seed: int, rate: float, ticks: int) -> NDArray[np.bool_]:
    """Return a seeded share of the ticks, (ticks,); a longer draw begins like a shorter one."""
    return np.random.default_rng(seed).uniform(size=ticks) < rate


class FaultySession(ShownBySettings):
    """``faults`` counts the answers that were replaced."""

    def __init__(self, settings: Faulty, inner: Session, qp: NullSpaceQP) -> None:
        self._settings, self._inner = settings, inner
        self._rng = np.random.default_rng(settings.seed)
        self._false = Exact().start(qp)
        if hasattr(inner, "observe"):
            self.observe = inner.observe  # the controller calls ``observe`` if it exists
        self.faults = 0

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem, or corrupt the answer."""
        if self._rng.uniform() >= self._settings.rate:
            return self._inner.solve(qp)
        self.faults += 1
        kind = self._settings.kind
        if kind == "raise":
            raise InjectedFault("faulty: raised on purpose")
        if kind == "fail":
            return no_answer(qp.n, Status.NUMERICAL)
        if kind == "nan":
            return Solution(np.full(qp.n, np.nan), None, Status.SOLVED)
        if kind == "outside":
            return Solution(10.0 * qp.upper + 1.0, None, Status.SOLVED)
        if kind == "malformed":
            return self._inner.solve(qp)._replace(y=np.zeros(6, dtype=complex))
        if kind == "rig":
            qp.row.setflags(write=True)
            part = fields(qp.row)
            part.A[:], part.b[:], part.lower[:], part.upper[:] = 0.0, 0.0, -1e3, 1e3
            return Solution(np.full(qp.n, 50.0), None, Status.SOLVED)
        row = np.array(qp.row)
        fields(row).pull[:] *= -1.0
        return self._false.solve(NullSpaceQP.from_row(row))
