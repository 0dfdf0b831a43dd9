"""The interface of a solver: a frozen set of settings that starts sessions. A session solves one run's subproblems."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import Field, fields
from enum import Enum
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import SolverError, is_number, shown
from moc_opt.qp.problem import NullSpaceQP

Choices = Mapping[str, tuple[object, ...]]  # the valid values of each setting, by its name
MOST = 2**31 - 1  # largest integer of a setting: the libraries count in 32 bits


class Status(Enum):
    """The status that a solver reports with its answer. Each value says what it means, or what to do about it."""

    SOLVED = "the solver claims an optimum"
    INFEASIBLE = "no velocity within the bounds meets the references: slow the path down or raise k0"
    MAX_ITER = "raise max_iter or loosen eps"
    TIME_LIMIT = "raise the time budget or take a faster solver"
    NUMERICAL = "numerical trouble: take rows = 5, regularization > 0 or a larger cost_scale"
    UNSUPPORTED = "ask supports(qp) why this solver cannot take this problem"

    label: str  #: Lower-case name, used in traces and tables.

    def __init__(self, cure: str) -> None:
        self.label = self.name.lower()


class Solution(NamedTuple):
    """A solver's answer.

    Attributes:
        x: (n,) joint velocity [rad/s]; NaN if the solver found none.
        y: (6,) multipliers of the six equality rows, or None if the solver gives none. With the multipliers z of the
            bounds, P x + p + A^T y + z = 0. If a solver uses five rows, its adapter computes six multipliers.
        status: the status that the solver reports.
        iterations: number of iterations of the solver; 0 if it does not iterate.
    """

    x: Array
    y: Array | None
    status: Status
    iterations: int = 0


def no_answer(n: int, status: Status, iterations: int = 0) -> Solution:
    """Return a Solution for a failed solve. Its x is NaN, so that using x by mistake is noticed, and its y is None."""
    return Solution(np.full(n, np.nan), None, status, iterations)


class Session(Protocol):
    """A solver's workspace and warm start for one sequence of subproblems."""

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Solve one subproblem. A failure is reported by the status of the answer, not by an exception."""


@runtime_checkable
class Solver(Protocol):
    """The settings of a solver. `start` returns an independent session. docs/extending.md has a complete example."""

    @property
    def name(self) -> str:
        """Name in the registry."""

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return None if the solver accepts the problem, else the reason why not."""

    def start(self, qp: NullSpaceQP) -> Session:
        """Return a new session whose memory is set up for problems of the shape and size of ``qp``."""


@runtime_checkable
class TruncatingSession(Protocol):
    """A session that can be stopped after a number of iterations, as a deadline would stop it."""

    def truncated(self, qp: NullSpaceQP, iterations: int) -> Solution:
        """Return the iterate after ``iterations`` (at least 1) from the previous solve's initial point."""


@runtime_checkable
class ObservingSession(Protocol):
    """A session that needs the measured velocity: the controller calls ``observe`` before each ``solve``."""

    def observe(self, v: Array) -> None:
        """Store the measured joint velocity v (n,) [rad/s]."""


class SolverSettings:
    """Base of this package's solvers, which are frozen dataclasses of settings. It checks the settings.

    `choices` may list the valid values of a field. Otherwise the type of the default decides: bool allows bools, int
    allows integers of at least 1, and float allows numbers above 0. A default of 0.0 or None is also a valid value.
    """

    name: ClassVar[str]
    session: ClassVar[type[Any]]  #: Class of the sessions; it is called with the settings and a first problem.
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
        """Return None if the solver accepts the problem, else the reason why not."""
        return None

    def start(self, qp: NullSpaceQP) -> Session:
        """Return a session for problems of the shape and size of ``qp``; a SolverError if ``qp`` is refused."""
        reason = self.supports(qp)
        if reason is not None:
            raise SolverError(f"{self.name}: {reason}")
        return self.session(self, qp)
