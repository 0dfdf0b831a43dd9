"""The supervisor of the third level: every answer is checked before the arm follows it.

Tip and RCM control never depend on a solver. An answer that raised, is missing, is not finite, came
too late, or is claimed to be optimal and is not, is replaced: by the last good one for a few ticks,
then by null-space damping alone. Every such tick is counted and named in the trace, and the first of each
kind is kept in words.

A solver gets a copy of the subproblem, and its answer is copied before the check: what it writes into
either afterwards reaches neither the check nor the torque.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from enum import Enum
from time import perf_counter_ns
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from moc_opt.control.interpreter import Interpreter
from moc_opt.control.null_space import into_the_box, least_violation
from moc_opt.control.solution_check import RESIDUALS, received
from moc_opt.errors import ControlError, MocOptError, describe
from moc_opt.inputs.settings import Settings
from moc_opt.numerics.arrays import Array
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.base import Session, Solution, Status, TruncatingSession, no_answer


class Fault(Enum):
    """The fault of an answer; the text is its meaning."""

    NONE = "the answer was taken"
    INFEASIBLE = "the solver found the subproblem infeasible"
    FAILED = "the solver gave no answer"
    RAISED = "the solver raised an exception"
    MALFORMED = "the answer has not the form of a Solution"
    NOT_FINITE = "the answer holds NaN or infinity"
    OUTSIDE = "the answer leaves the box or misses the references by more than the check allows"
    FALSE_OPTIMUM = "the solver claimed an optimum and the residual check disagrees"
    LATE = "the solver took longer than its budget"
    LOST = "the solver's process hung or ended, and is replaced"

    label: str
    """Name in traces and reports."""

    def __init__(self, meaning: str) -> None:
        # Traces keep the label that readers of older ones know.
        self.label = "lied" if self.name == "FALSE_OPTIMUM" else self.name.lower()


class Unanswered(Exception):
    """Raised by a session in another process that has no answer; holds the fault and a message.

    ``status`` is the solver's claim, if there was one.
    """

    def __init__(self, fault: Fault, text: str, status: Status | None = None) -> None:
        super().__init__(text)
        self.fault, self.text = fault, text
        self.status = status or (Status.TIME_LIMIT if fault is Fault.LATE else Status.NUMERICAL)


def _raise_interrupt(error: BaseException) -> None:
    """Raise KeyboardInterrupt again if it caused the error: a library may wrap it in its own exception."""
    found: BaseException | None = error
    for _ in range(10):  # no chain is as long, but foreign code may close one to a ring
        if found is None or isinstance(found, KeyboardInterrupt):
            break
        found = found.__cause__ or found.__context__
    if isinstance(found, KeyboardInterrupt):
        raise found


class First(NamedTuple):
    """The first fault of a kind: the number of answers requested before, and the message."""

    tick: int
    text: str


class SupervisorSettings(Settings):
    """When an answer is refused, and what replaces it."""

    KIND: ClassVar[str] = "[control.supervisor]"
    ERROR: ClassVar[type[MocOptError]] = ControlError

    check: bool = Field(True, description="whether the residuals of answers that are claimed optimal are checked")
    primal_limit: float = Field(
        1e-2, gt=0.0, description="largest |A x - b| or box violation of an answer claimed optimal [m/s, rad/s]"
    )
    box_limit: float = Field(
        0.1, gt=0.0, description="largest |A x - b| or box violation of an answer without that claim [m/s, rad/s]"
    )
    relative_limit: float = Field(
        0.05, gt=0.0,
        description="largest natural residual along the self-motion, with the cost scaled to slope one [rad/s]",
    )  # fmt: skip
    opposite_limit: float = Field(
        1e-3, gt=0.0,
        description="a claim is false if its x is farther than this from the optimum, and nearer to the optimum of the "
        "opposite gradient [rad/s]",
    )  # fmt: skip
    hold_ticks: int = Field(
        10, ge=0, description="ticks for which the last good answer is held, before the self-motion is damped"
    )
    keep_off_limits: bool = Field(
        True, description="after these ticks, move the elbow as far as the box asks for; False: damping only"
    )
    budget_us: float | None = Field(None, gt=0.0, description="time that a solve may take; None: no limit")
    late: Literal["hold", "zero", "iterate"] = Field(
        "hold",
        description="what replaces a late answer: the last good one, zero, or ('iterate') what the solver has when the "
        "budget ends, which is its whole answer where it cannot be interrupted",
    )


ANSWER_EVERY = 500
"""Answers after which the handlers of Ctrl-C and similar signals are restored, since a solver may change them."""

_SOLVED, _NO_FAULT = Status.SOLVED, Fault.NONE


class Supervisor:
    """Check the answers of a session, and replace those that are refused.

    Args:
        settings: limits of the check, and the replacement.
        fallback: replaces the answer to an infeasible subproblem: "damping", "hold" or "least-violation".
        times_us: recorded solve times that replace the clock, so that a run with deadlines can be
            repeated exactly; None: the clock decides. After the last recorded time the clock decides too.

    Since the start, by a fault's label: ``counts`` holds the number of occurrences, ``firsts`` the first one and
    its message (that of the exception, if the solver raised one).
    """

    def __init__(
        self, settings: SupervisorSettings, fallback: str, n: int, times_us: Iterator[float] | None = None
    ) -> None:
        self.settings, self._fallback, self._times = settings, fallback, times_us
        self._rest = np.zeros(n)
        self._residuals = RESIDUALS.code
        # Read once: access to a setting costs as much as a comparison, and every tick needs it.
        self._check, self._stop_late = settings.check, settings.late == "iterate"
        self._budget_us = float("inf") if settings.budget_us is None else settings.budget_us
        self._limits = (
            settings.box_limit, settings.primal_limit, settings.relative_limit, settings.opposite_limit
        )  # fmt: skip
        self.forget()

    def forget(self) -> None:
        """Forget the last good answer, and all counts."""
        self._good, self._age = np.zeros(self._rest.size), 0
        self.fault, self.solve_us = Fault.NONE, float("nan")
        self.counts: Counter[str] = Counter()
        self.firsts: dict[str, First] = {}
        self._asked, self._interpreter = 0, Interpreter()  # of the thread in which the controller starts

    def warm_up(self, qp: NullSpaceQP, Z: Array) -> None:
        """Run every compiled fallback once, before the loop."""
        if self._fallback == "least-violation":
            self._least_violation(qp)
        self._retreat(qp, Z)

    def solve(
        self, session: Session, qp: NullSpaceQP, Z: Array, v: Array | None = None
    ) -> tuple[Solution, Array]:
        """Ask the session, check its answer, and return one in any case.

        Args:
            qp: the subproblem; the session gets a copy.
            Z: (r, n) basis of ker A.
            v: (n,) measured velocity [rad/s] for a session that observes it, which gets a copy; None: it does not.

        Returns:
            the solver's answer, and the x (n,) that the arm follows.
        """
        solution, fault, text = self._ask(session, qp, v)
        self.fault = fault or self._fault_of(solution, qp, Z)
        self._asked += 1
        if self._asked % ANSWER_EVERY == 0:
            self._interpreter.answer_signals()
        if self.fault is _NO_FAULT:
            self._good, self._age = solution.x.copy(), 0  # a copy: the caller has the solution as well
            return solution, self._good
        label = self.fault.label
        self.counts[label] += 1
        if label not in self.firsts:
            cure = f" ({solution.status.value})" if self.fault is Fault.FAILED else ""
            self.firsts[label] = First(self._asked - 1, text or self.fault.value + cure)
        return solution, self._replace(solution, qp, Z)

    def _ask(self, session: Session, qp: NullSpaceQP, v: Array | None) -> tuple[Solution, Fault | None, str]:
        """Return a private copy of the answer, and the fault known before the check, in words; set ``solve_us``."""
        shown, given, text = qp.copy(), None, ""
        fault: Fault | None = None
        status = Status.NUMERICAL
        begin = perf_counter_ns()
        try:
            try:
                if v is not None:
                    session.observe(v.copy())  # type: ignore[attr-defined]
                given = session.solve(shown)
            finally:
                self._interpreter.calm()
        except Unanswered as error:
            fault, text, status = error.fault, error.text, error.status
        except BaseException as error:  # noqa: BLE001 - whatever a solver throws, the run goes on
            _raise_interrupt(error)
            fault, text = Fault.RAISED, describe(error)
        self.solve_us = (perf_counter_ns() - begin) * 1e-3
        if self._times is not None:
            self.solve_us = next(self._times, self.solve_us)
        if fault is not None:
            return no_answer(qp.n, status), fault, text
        try:
            solution, wrong = received(given, qp.n)
            if self._stop_late and self._late and not wrong:
                solution, wrong = received(self._stopped(session, shown, solution), qp.n)
        except BaseException as error:  # noqa: BLE001 - as above
            _raise_interrupt(error)
            return no_answer(qp.n, Status.NUMERICAL), Fault.RAISED, describe(error)
        return solution, Fault.MALFORMED if wrong else None, wrong

    def _fault_of(self, solution: Solution, qp: NullSpaceQP, Z: Array) -> Fault:
        status = solution.status
        if status is not _SOLVED:
            if status is Status.INFEASIBLE:
                return Fault.INFEASIBLE
            if status is not Status.MAX_ITER and status is not Status.TIME_LIMIT:
                return Fault.FAILED
        primal, outside, relative, off, opposite = self._residuals(qp.row, qp.n, Z, solution.x)
        if primal != primal:
            return Fault.NOT_FINITE
        if self._check:
            box, claim, natural, turned = self._limits
            if status is not _SOLVED:
                if primal > box or outside > box:
                    return Fault.OUTSIDE
            elif primal > claim or outside > claim:
                return Fault.OUTSIDE
            elif relative > natural or (off > turned and opposite < off):
                return Fault.FALSE_OPTIMUM
        return Fault.LATE if self._late else _NO_FAULT

    @property
    def _late(self) -> bool:
        return self.solve_us > self._budget_us

    def _stopped(self, session: Session, qp: NullSpaceQP, solution: Solution) -> Solution:
        """Return the iterate at the end of the budget; all iterations are assumed to last equally long.

        A solver that cannot be stopped is waited for, and its whole answer is used.
        """
        if not isinstance(session, TruncatingSession) or solution.iterations < 1:
            return solution
        share = self._budget_us / self.solve_us
        return session.truncated(qp, max(1, int(share * solution.iterations)))

    def _replace(self, solution: Solution, qp: NullSpaceQP, Z: Array) -> Array:
        self._age += 1
        if self.fault is Fault.INFEASIBLE and self._fallback != "hold":
            if self._fallback == "damping":
                return self._rest
            return self._least_violation(qp)
        late = self.settings.late if self.fault is Fault.LATE else "hold"
        if late == "zero":
            return self._rest
        if late == "iterate" and np.isfinite(solution.x).all():  # of a process that is cut off nothing is there
            return np.array(solution.x)
        if self._age <= self.settings.hold_ticks:
            return self._good
        return self._retreat(qp, Z) if self.settings.keep_off_limits else self._rest

    def _retreat(self, qp: NullSpaceQP, Z: Array) -> Array:
        part = qp.fields
        x: Array = into_the_box(part.A, part.b, Z, part.lower, part.upper, 50)
        return x

    def _least_violation(self, qp: NullSpaceQP) -> Array:
        part = qp.fields
        x: Array = least_violation(part.A, part.b, part.lower, part.upper, 50)
        return x
