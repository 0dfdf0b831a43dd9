"""The interface of a solver: frozen settings that start sessions; a session owns memory and answers ticks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from enum import Enum
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import SolverError, is_number
from moc_opt.inputs.names import table_html
from moc_opt.qp.problem import NullSpaceQP


class Status(Enum):
    """A solver's claim about its own answer. The text is the cure.

    Example:
        >>> mo.solvers.Status.MAX_ITER.label, mo.solvers.Status.MAX_ITER.value
        ('max_iter', 'raise max_iter or loosen eps')
    """

    SOLVED = "the solver claims an optimum"
    INFEASIBLE = "no velocity inside the box meets the references: slow the path down or raise k0"
    MAX_ITER = "raise max_iter or loosen eps"
    TIME_LIMIT = "raise the time budget or take a faster solver"
    NUMERICAL = "numerical trouble: take rows = 5, regularization > 0 or a larger cost_scale"
    UNSUPPORTED = "ask supports(qp) why this solver cannot take this problem"

    label: str  #: Lower-case name, as it stands in traces and tables.

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

    Example:
        >>> mo.solvers.Solution(np.array([0.1, 0.0]), None, mo.solvers.Status.SOLVED)
        Solution(status=solved, x=[0.1, 0. ], y=none, iterations=0)
    """

    x: Array
    y: Array | None
    status: Status
    iterations: int = 0

    def __repr__(self) -> str:
        return f"Solution({', '.join(f'{name}={value}' for name, value in self._shown().items())})"

    def _repr_html_(self) -> str:
        """Show itself in a notebook."""
        return table_html("Solution", self._shown())

    def _shown(self) -> dict[str, str]:
        def row(values: Array | None) -> str:
            if values is None:
                return "none"
            return str(np.array2string(np.asarray(values), precision=4, separator=", ", max_line_width=1000))

        return {
            "status": self.status.label, "x": row(self.x), "y": row(self.y), "iterations": str(self.iterations),
        }  # fmt: skip


class Session(Protocol):
    """The workspace and the warm start of one solver on one stream of subproblems.

    Example:
        >>> qp = mo.NullSpaceQP(np.eye(3, 7), np.eye(3, 7), *np.zeros((2, 3)), np.ones(7), -np.ones(7), np.ones(7))
        >>> session = mo.solvers.create("rnn").start(qp)
        >>> answers = [session.solve(qp) for _ in range(3)]  # each begins where the last one ended
        >>> answers[-1].x.shape
        (7,)
    """

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem; never raises for a problem the solver cannot solve."""
        ...


class ShownBySettings:
    """A session that shows itself by the settings that it was started with."""

    __slots__ = ()
    _settings: Any

    def __repr__(self) -> str:
        return f"<session of {self._settings!r}>"


@runtime_checkable
class Solver(Protocol):
    """Settings. Two sessions of one solver share nothing.

    Example:
        >>> class Still:
        ...     name = "still"
        ...     def supports(self, qp):
        ...         return None
        ...     def start(self, qp):
        ...         return self
        ...     def solve(self, qp):
        ...         return mo.solvers.Solution(np.zeros(qp.n), None, mo.solvers.Status.SOLVED)
        >>> isinstance(Still(), mo.solvers.Solver)
        True
    """

    @property
    def name(self) -> str:
        """Name in the registry."""
        ...

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return None if the solver can take the problem, else the reason why not."""
        ...

    def start(self, qp: NullSpaceQP) -> Session:
        """Return a new session with its memory sized and set up for problems like ``qp``."""
        ...


@runtime_checkable
class TruncatingSession(Protocol):
    """A session that can be stopped in the middle of a solve, as by a deadline; its iterations are counted."""

    def truncated(self, qp: NullSpaceQP, iterations: int) -> Solution:
        """Return the iterate after ``iterations`` (at least 1), from where the last solve began."""
        ...


def no_answer(n: int, status: Status, iterations: int = 0) -> Solution:
    """Return a solution without an answer: its x is NaN, so that a use by mistake is found."""
    return Solution(np.full(n, np.nan), None, status, iterations)


@runtime_checkable
class ObservingSession(Protocol):
    """A session that needs the measured velocity before each tick; the controller calls ``observe``."""

    def observe(self, v: Array) -> None:
        """Take the measured joint velocity v (n,) [rad/s]."""
        ...

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem."""
        ...


def check_settings(settings: Any, **choices: Sequence[object]) -> None:
    """Check every field of a dataclass of settings that has a plain default, which also says what is usual.

    A field named in ``choices`` must be one of them; else a flag's default asks for a flag, that of a whole number for
    one of 1 or larger, of a number for a positive one (or None, if that is the default), 0.0 for one not negative.

    Raises:
        SolverError: a field is out of range; names the field, its value and the cure.
    """
    for field in fields(settings):
        name, usual, value = field.name, field.default, getattr(settings, field.name)
        finite = is_number(value) and abs(value) < float("inf")
        if name in choices:
            valid = choices[name]
            right, rule = not isinstance(value, bool) and value in valid, f"is not one of {', '.join(map(repr, valid))}"
        elif isinstance(usual, bool):
            right, rule = isinstance(value, bool), "is neither True nor False"
        elif isinstance(usual, int):
            right = isinstance(value, int) and not isinstance(value, bool) and value >= 1
            rule = f"is not a whole number of 1 or larger; {usual} is usual"
        elif usual == 0.0:
            right, rule = finite and value >= 0.0, "is not a number of 0 or larger; 0 is usual"
        elif isinstance(usual, float) or field.type == "float | None":
            right = (finite and value > 0.0) or (value is None and usual is None)
            rule = f"is not a positive number; {usual} is usual"
        else:
            continue
        if not right:
            quoted = "; a number has no quotes: drop them" if isinstance(value, str) and "number" in rule else ""
            raise SolverError(f"{settings.name}: {name} = {value!r} {rule}{quoted}")
