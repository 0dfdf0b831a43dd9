"""The interface of a solver. A `Solver` holds settings, and its sessions solve subproblems."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import Field, fields
from enum import Enum
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import SolverError, is_number, shown
from moc_opt.qp.problem import NullSpaceQP

Choices = Mapping[str, tuple[object, ...]]  # the valid values of each setting
MOST = 2**31 - 1  # upper limit of an integer setting (32 bits)


class Status(Enum):
    """The status of an answer. Each member's value explains the status or names a remedy."""

    SOLVED = "the solver claims an optimum"
    INFEASIBLE = "no velocity within the bounds meets the references: slow the path down or raise k0"
    MAX_ITER = "raise max_iter or loosen eps"
    TIME_LIMIT = "raise the time budget or use a faster solver"
    NUMERICAL = "numerical trouble: use rows = 5, regularization > 0 or a larger cost_scale"
    UNSUPPORTED = "this solver does not accept this problem: supports(qp) returns the reason"

    label: str  #: lower-case name

    def __init__(self, cure: str) -> None:
        self.label = self.name.lower()


class Solution(NamedTuple):
    """A solver's answer.

    Attributes:
        x: (n,) joint velocity [rad/s]; NaN if the solver found none.
        y: (6,) multipliers of the equality rows, or None. With multipliers z of the bounds, P x + p + A^T y + z = 0.
        status: the status that the solver reports.
        iterations: number of iterations; 0 for a direct method.
    """

    x: Array
    y: Array | None
    status: Status
    iterations: int = 0


def no_answer(n: int, status: Status, iterations: int = 0) -> Solution:
    """Return the Solution of a failed solve, with NaN as x and None as y."""
    return Solution(np.full(n, np.nan), None, status, iterations)


class Session(Protocol):
    """A solver's workspace for one sequence of subproblems."""

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Solve one subproblem. A failure is reported by the answer's status, not by an exception."""


@runtime_checkable
class Solver(Protocol):
    """The settings of a solver. docs/extending.md has an example."""

    @property
    def name(self) -> str:
        """Name in the registry."""

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return None if the solver accepts the problem, else the reason why it does not."""

    def start(self, qp: NullSpaceQP) -> Session:
        """Return a new session for problems of the size of ``qp``."""


@runtime_checkable
class TruncatingSession(Protocol):
    """A session that can be stopped after a given number of iterations."""

    def truncated(self, qp: NullSpaceQP, iterations: int) -> Solution:
        """Repeat the last `solve`, which had the same ``qp``. Return the iterate after ``iterations`` (at least 1)."""


@runtime_checkable
class ObservingSession(Protocol):
    """A session that needs the measured velocity. Call ``observe`` before each ``solve``."""

    def observe(self, v: Array) -> None:
        """Store the measured joint velocity v (n,) [rad/s]."""


class SolverSettings:
    """Base class of this package's solvers (frozen dataclasses). It checks their settings.

    Where `choices` lists no values, an int must be at least 1, and a float must be above 0. If the default is 0 or
    None, this value is valid too.
    """

    name: ClassVar[str]
    session: ClassVar[type[Any]]  #: class of the sessions, called with the settings and a first problem
    choices: ClassVar[Choices] = {}  #: valid values by field

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            right, rule = self._rule(field, value)
            if not right:
                quoted = "; write a number without quotes" if isinstance(value, str) and "number" in rule else ""
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
            return right, f"a whole number from 1 to {MOST}; default: {usual}"
        if usual == 0.0:
            return number and value >= 0.0, "a number of 0 or larger; default: 0"
        if isinstance(usual, float) or field.type == "float | None":
            return (number and value > 0.0) or (value is None and usual is None), f"a positive number; default: {usual}"
        return True, ""

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return why the solver refuses the problem, or None."""
        return None

    def start(self, qp: NullSpaceQP) -> Session:
        """Return a session. Raise a SolverError if ``qp`` is refused."""
        reason = self.supports(qp)
        if reason is not None:
            raise SolverError(f"{self.name}: {reason}")
        return self.session(self, qp)
