"""The supervisor checks every answer of level 3's solver before the arm follows it."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from time import perf_counter_ns
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from moc_opt import core
from moc_opt.arrays import Array
from moc_opt.errors import ControlError, MocOptError, located
from moc_opt.inputs.settings import Settings
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.base import Session, Solution, Status, TruncatingSession, no_answer
from moc_opt.solvers.exact import STATUS as EXACT_STATUS
from moc_opt.solvers.isolated import Unanswered


class Fault(Enum):
    """The faults of a solver's answer."""

    NONE = "no fault"
    INFEASIBLE = "the solver found the subproblem infeasible"
    FAILED = "the solver gave no answer"
    RAISED = "the solver raised an exception"
    MALFORMED = "the answer does not have the form of a Solution"
    NOT_FINITE = "the answer holds NaN or infinity"
    OUTSIDE = "the answer violates A x = b or the bounds by more than the check allows"
    FALSE_OPTIMUM = "the solver claimed an optimum, but the residuals refute it"
    LATE = "the solver took longer than its budget"
    LOST = "the solver's process hung or ended; a new process replaces it"

    label: str  #: Name in traces and reports.

    def __init__(self, meaning: str) -> None:
        # The label "lied" is kept from older versions.
        self.label = "lied" if self.name == "FALSE_OPTIMUM" else self.name.lower()


def _raise_interrupt(error: BaseException) -> None:
    found: BaseException | None = error
    for _ in range(10):  # the chain may be cyclic
        if found is None or isinstance(found, KeyboardInterrupt):
            break
        found = found.__context__ if found.__cause__ is None else found.__cause__
    if isinstance(found, KeyboardInterrupt):
        raise found


class SupervisorSettings(Settings):
    """Checks and replacements of the solver's answers x. If A x = b, tip and wrist have their reference velocities."""

    KIND: ClassVar[str] = "[control.supervisor]"
    ERROR: ClassVar[type[MocOptError]] = ControlError

    check: bool = True
    """whether answers are checked against `primal_limit`, `box_limit`, `relative_limit` and `opposite_limit`"""
    primal_limit: float = Field(1e-2, gt=0.0)
    """largest violation of A x = b [m/s] or of the bounds on x [rad/s] by an answer reported as optimal"""
    box_limit: float = Field(0.1, gt=0.0)
    """like `primal_limit` (A x = b and bounds), for answers not reported as optimal"""
    relative_limit: float = Field(0.05, gt=0.0)
    """largest natural residual of an answer reported as optimal [rad/s]. At an optimum the residual is 0. The cost is
    scaled so that the largest entry of its gradient at x = 0 is 1"""
    opposite_limit: float = Field(1e-3, gt=0.0)
    """distance [rad/s]. An answer reported as optimal is refused if it is both farther than this from the optimum and
    nearer to the optimum for -`c2` than to the optimum"""
    hold_ticks: int = Field(10, ge=0)
    """number of consecutive control periods in which the last good answer replaces refused answers. After these,
    x = 0 damps the elbow motion, except near joint limits (`keep_off_limits`)"""
    keep_off_limits: bool = True
    """whether the elbow moves away from a joint limit after `hold_ticks`, if the bounds on x exclude x = 0"""
    budget_us: float | None = Field(None, gt=0.0, description="longest time of a solve. By default, there is no limit")
    late: Literal["hold", "zero", "iterate"] = "hold"
    """replacement for an answer later than `budget_us`. 'hold': the last good answer; 'zero': no elbow motion;
    'iterate': the solver's iterate at that time, or the late answer if the solver gives no iterate"""


_FAULTS = tuple(Fault)  # in the order of the core's enum
_CLAIMS = {Status.SOLVED: 0, Status.INFEASIBLE: 1, Status.MAX_ITER: 2, Status.TIME_LIMIT: 2}
_NO_ANSWER = 3
_NAN = float("nan")


MOST_ITERATIONS = 2**31 - 1  #: The largest number of iterations that a trace can hold.


def received(given: object, n: int) -> tuple[Solution, str]:
    """Return (copy of a solver's answer, message). The message is empty if the answer is well-formed.

    If any part is malformed, x (n,) is NaN.
    """
    if not isinstance(given, Solution):
        return no_answer(n, Status.NUMERICAL), f"solve returned a {type(given).__name__}: return a Solution"
    x, y, status, iterations = given
    if not isinstance(status, Status):
        return no_answer(n, Status.NUMERICAL), f"the status is a {type(status).__name__}: give a Status"
    wrong = _unlike("x", x, (n,)) or ("" if y is None else _unlike("y", y, (6,)))
    whole = isinstance(iterations, int | np.integer) and not isinstance(iterations, bool)
    if not wrong and not (whole and 0 <= iterations <= MOST_ITERATIONS):
        wrong = f"iterations = {iterations!r:.50}: give an int from 0 to {MOST_ITERATIONS}"
    if wrong:
        return no_answer(n, status), wrong
    return Solution(x.copy(), None if y is None else y.copy(), status, int(iterations)), ""


def _unlike(name: str, value: object, shape: tuple[int, ...]) -> str:
    if not isinstance(value, np.ndarray) or value.dtype != np.float64:
        kind = f"an array of {value.dtype}" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"
        return f"{name} is {kind}: give an array of float64"
    return "" if value.shape == shape else f"{name} has shape {value.shape}: give {shape}"


class Supervisor:
    """Check the answers of a solver's session, replace refused answers, and count the faults.

    ``period`` is the control period [s]. Recorded ``times_us`` replace measured solve times. ``faults`` maps the label
    of a fault to a dict of ``count``, ``first_at_s`` and ``first`` (the first message).
    """

    def __init__(
        self, settings: SupervisorSettings, law: core.Law, n: int, period: float,
        times_us: Iterator[float] | None = None,
    ) -> None:  # fmt: skip
        self.settings, self._law, self._n, self._period, self._times = settings, law, n, period, times_us
        self._stop_late = settings.late == "iterate"
        self._budget_us = float("inf") if settings.budget_us is None else settings.budget_us
        self.forget()

    def forget(self) -> None:
        """Reset the fault, the solve time and the counts."""
        self.fault, self.solve_us, self._asked = Fault.NONE, float("nan"), 0
        self.faults: dict[str, dict[str, Any]] = {}

    def solve(self, session: Session, qp: NullSpaceQP, v: Array | None = None) -> tuple[Solution, Array, Array]:
        """Let the session solve ``qp``, check the answer, and compute the torque.

        Return (solution, x, tau): the solver's answer, the x (n,) [rad/s] that the arm follows, the torque (n,) [Nm].
        ``v`` (n,) [rad/s] is the measured velocity, which an `ObservingSession` needs.
        """
        solution, known, text = self._ask(session, qp, v)
        number, x, tau = self._law.finish(
            0 if known is None else _FAULTS.index(known), _CLAIMS.get(solution.status, _NO_ANSWER), solution.x,
            self.solve_us,
        )  # fmt: skip
        self._note(number, solution.status, text)
        return solution, x, tau

    def step(
        self, q: Array, v: Array, tip_ref: Array, trocar: Array, x_d: Array | None, tolerance: float
    ) -> tuple[Status, Array, Array]:
        """Do the whole tick in the core, with the core's solver `exact` at this ``tolerance`` [rad/s].

        q and v (n,) are measured. tip_ref (3, 3) has the rows X_d, dX_d, ddX_d, and trocar (2, 3) the rows P_t, dP_t.
        x_d (n,) [rad/s] is the joint velocity that the elbow follows; with None, the elbow raises mu.
        Return (status, record of a `RobotState`, out). ``out`` (14 n + 16,) has, in this order, `NullSpaceQP.row`
        (11 n + 10,), the solver's x (n,) and y (6,), the x (n,) that the arm follows, and the torque (n,) [Nm].
        """
        given_us = _NAN if self._times is None else next(self._times, _NAN)
        code, number, self.solve_us, record, out = self._law.step(q, v, tip_ref, trocar, x_d, tolerance, given_us)
        status = EXACT_STATUS[code]
        self._note(number, status, "")
        return status, record, out

    def _note(self, number: int, status: Status, text: str) -> None:
        self.fault = fault = _FAULTS[number]
        if number:
            cure = f" ({status.value})" if fault is Fault.FAILED else ""
            first = {"count": 0, "first_at_s": self._period * self._asked, "first": text or fault.value + cure}
            self.faults.setdefault(fault.label, first)["count"] += 1
        self._asked += 1

    def _ask(self, session: Session, qp: NullSpaceQP, v: Array | None) -> tuple[Solution, Fault | None, str]:
        shown, given, text = qp.copy(), None, ""
        fault: Fault | None = None
        begin = perf_counter_ns()
        try:
            if v is not None:
                session.observe(v.copy())  # type: ignore[attr-defined]
            given = session.solve(shown)
        except Unanswered as error:
            fault, text = Fault[error.kind.upper()], error.text
        except BaseException as error:  # noqa: BLE001 - the run goes on whatever a solver raises
            _raise_interrupt(error)
            fault, text = Fault.RAISED, located(error)
        self.solve_us = (perf_counter_ns() - begin) * 1e-3
        if self._times is not None:
            self.solve_us = next(self._times, self.solve_us)
        if fault is not None:
            return no_answer(qp.n, Status.TIME_LIMIT if fault is Fault.LATE else Status.NUMERICAL), fault, text
        try:
            solution, wrong = received(given, qp.n)
            if self._stop_late and self.solve_us > self._budget_us and not wrong:
                solution, wrong = received(self._stopped(session, shown, solution), qp.n)
        except BaseException as error:  # noqa: BLE001 - the run goes on
            _raise_interrupt(error)
            return no_answer(qp.n, Status.NUMERICAL), Fault.RAISED, located(error)
        return solution, Fault.MALFORMED if wrong else None, wrong

    def _stopped(self, session: Session, qp: NullSpaceQP, solution: Solution) -> Solution:
        if not isinstance(session, TruncatingSession) or solution.iterations < 1:
            return solution
        share = self._budget_us / self.solve_us
        return session.truncated(qp, max(1, int(share * solution.iterations)))
