"""Checks that every solver's settings share; each error names the field, its value and the cure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

from moc_opt.errors import SolverError


def positive(solver: str, field: str, value: object, usual: float) -> None:
    """Raise SolverError unless ``value`` is a finite number above zero."""
    if not _number(value) or not 0.0 < value < float("inf"):  # type: ignore[operator]
        _refuse(solver, field, value, f"is not a positive number; {usual:g} is usual")


def not_negative(solver: str, field: str, value: object, usual: float) -> None:
    """Raise SolverError unless ``value`` is a finite number, zero or larger."""
    if not _number(value) or not 0.0 <= value < float("inf"):  # type: ignore[operator]
        _refuse(solver, field, value, f"is not a number of 0 or larger; {usual:g} is usual")


def whole(solver: str, field: str, value: object, usual: int) -> None:
    """Raise SolverError unless ``value`` is an integer of 1 or larger."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        _refuse(solver, field, value, f"is not a whole number of 1 or larger; {usual} is usual")


def flag(solver: str, field: str, value: object) -> None:
    """Raise SolverError unless ``value`` is a bool."""
    if not isinstance(value, bool):
        _refuse(solver, field, value, "is neither True nor False")


def one_of(solver: str, field: str, value: object, valid: Sequence[object]) -> None:
    """Raise SolverError unless ``value`` is among ``valid``."""
    if isinstance(value, bool) or value not in valid:
        _refuse(solver, field, value, f"is not one of {', '.join(map(repr, valid))}")


def _number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _refuse(solver: str, field: str, value: object, cure: str) -> NoReturn:
    raise SolverError(f"{solver}: {field} = {value!r} {cure}")
