"""The interface of a solver: frozen settings that start sessions; a session owns memory and answers ticks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import Field, fields
from enum import Enum
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import SolverError, is_number, shown
from moc_opt.qp.problem import NullSpaceQP

Choices = Mapping[str, tuple[object, ...]]  # field of settings -> the values that it may have
MOST = 2**31 - 1  # the largest whole number of a setting: the libraries count in 32 bits


class Status(Enum):
    """A solver's claim about its own answer. The text says what the claim means, or what to do about it."""

    SOLVED = "the solver claims an optimum"
    INFEASIBLE = "no velocity inside the box meets the references: slow the path down or raise k0"
    MAX_ITER = "raise max_iter or loosen eps"
    TIME_LIMIT = "raise the time budget or take a faster solver"
    NUMERICAL = "numerical trouble: take rows = 5, regularization > 0 or a larger cost_scale"
    UNSUPPORTED = "ask supports(qp) why this solver cannot take this problem"

    label: str  #: Lower-case name, used in traces and tables.

    def __init__(self, cure: str) -> None:
        self.label = self.name.lower()


class Solution(NamedTuple):
    """An answer.

    Attributes:
        x: (n,) joint velocity [rad/s]; NaN where there is none.
        y: (6,) multipliers of the six equality rows with P x + p + A^T y + z = 0
            (five-row duals are lifted), or None where the solver gives none.
        status: the solver's claim.
        iterations: of the solver's own loop; 0 for closed forms.
    """

    x: Array
    y: Array | None
    status: Status
    iterations: int = 0


def no_answer(n: int, status: Status, iterations: int = 0) -> Solution:
    """Return a solution without an answer: its x is NaN, so that using it by mistake is noticed."""
    return Solution(np.full(n, np.nan), None, status, iterations)


class Session(Protocol):
    """The workspace and the warm start of one solver for one sequence of subproblems."""

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem; never raises for a problem the solver cannot solve."""


@runtime_checkable
class Solver(Protocol):
    """The settings of a solver. Its sessions share nothing. docs/extending.md has a complete solver."""

    @property
    def name(self) -> str:
        """Name in the registry."""

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return None if the solver can take the problem, else the reason why not."""

    def start(self, qp: NullSpaceQP) -> Session:
        """Return a new session with its memory sized and set up for problems like ``qp``."""


@runtime_checkable
class TruncatingSession(Protocol):
    """A session that can be stopped in the middle of a solve, as by a deadline; its iterations are counted."""

    def truncated(self, qp: NullSpaceQP, iterations: int) -> Solution:
        """Return the iterate after ``iterations`` (at least 1), from the point where the last solve began."""


@runtime_checkable
class ObservingSession(Protocol):
    """A session that needs the measured velocity before each tick; the controller calls ``observe``."""

    def observe(self, v: Array) -> None:
        """Take the measured joint velocity v (n,) [rad/s]."""


class SolverSettings:
    """Base of this package's solvers: it checks the fields, and refuses a session for an unsupported problem.

    A subclass is a frozen dataclass. The default of a field decides which values are valid: for a bool, a bool; for an
    int, an int of 1 or more; for a float, a number above 0 (for 0.0, also 0). None is valid where it is the default.
    `choices` may list a field's values. A SolverError names a field that is out of range, its value and the cure.
    """

    name: ClassVar[str]
    session: ClassVar[type[Any]]  #: Class of the sessions; its arguments are the settings and a first problem.
    choices: ClassVar[Choices] = {}

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            right, rule = self._rule(field, value)
            if not right:
                quoted = "; a number has no quotes: drop them" if isinstance(value, str) and "number" in rule else ""
                raise SolverError(f"{self.name}: {field.name} = {shown(value)} is not {rule}{quoted}")

    def _rule(self, field: Field[Any], value: Any) -> tuple[bool, str]:
        usual, flag = field.default, isinstance(value, bool)
        number = is_number(value) and abs(value) < float("inf")
        if field.name in self.choices:
            valid = self.choices[field.name]
            return value in valid and not flag, f"one of {', '.join(map(repr, valid))}"
        if isinstance(usual, bool):
            return flag, "True or False"
        if isinstance(usual, int):
            right = isinstance(value, int) and not flag and 1 <= value <= MOST
            return right, f"a whole number from 1 to {MOST}; {usual} is usual"
        if usual == 0.0:
            return number and value >= 0.0, "a number of 0 or larger; 0 is usual"
        if isinstance(usual, float) or field.type == "float | None":
            return (number and value > 0.0) or (value is None and usual is None), f"a positive number; {usual} is usual"
        return True, ""

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return None if the solver can take the problem, else the reason why not."""
        return None

    def start(self, qp: NullSpaceQP) -> Session:
        """Return a session that is set up for the shape and the scaling of ``qp``; a SolverError if not supported."""
        reason = self.supports(qp)
        if reason is not None:
            raise SolverError(f"{self.name}: {reason}")
        return self.session(self, qp)
