"""Checks that every solver's settings share; each error names the field, its value and the cure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, NoReturn

from moc_opt.errors import SolverError


def like_defaults(settings: Any, **choices: Sequence[object]) -> None:
    """Check every field of a solver's settings that has a plain default, which also says what is usual.

    A field named in ``choices`` must be one of them; else a flag's default asks for a flag, a whole number's for one of
    1 or larger, a number's for a positive one, and 0.0 for one that is not negative.

    Args:
        settings: a dataclass with a ``name``.

    Raises:
        SolverError: a field is out of range.
    """
    for field in fields(settings):
        name, usual, value = field.name, field.default, getattr(settings, field.name)
        if name in choices:
            one_of(settings.name, name, value, choices[name])
        elif isinstance(usual, bool):
            flag(settings.name, name, value)
        elif isinstance(usual, int):
            whole(settings.name, name, value, usual)
        elif isinstance(usual, float):
            (positive if usual > 0.0 else not_negative)(settings.name, name, value, usual)


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
    quoted = "; a number has no quotes: drop them" if isinstance(value, str) and "number" in cure else ""
    raise SolverError(f"{solver}: {field} = {value!r} {cure}{quoted}")
