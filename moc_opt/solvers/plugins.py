"""Solvers of third parties, found by their entry points; one that is broken is reported and hides no other."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from moc_opt.errors import SolverError, describe
from moc_opt.inputs import names
from moc_opt.inputs import plugins as inputs
from moc_opt.inputs.plugins import in_words as in_words  # registry's, too
from moc_opt.solvers.base import Solver

GROUP = "moc_opt.solvers"
_NEEDS = {"name": "a text", "supports": "a method of qp", "start": "a method of qp"}
_GUIDE = "docs/extending.md shows a whole solver"


def plugins() -> dict[str, list[EntryPoint]]:
    """Map each name to the different entry points that claim it."""
    return inputs.plugins(GROUP, entry_points)


def factory_of(name: str, points: list[EntryPoint]) -> Callable[..., Solver]:
    """Load the class or function that makes the solver.

    Raises:
        SolverError: several claim the name, the entry point cannot be imported, or it is no solver.
    """
    if not names.is_name(name):
        raise SolverError(f"solver {name!r:.80}: {in_words(points[0])}: rename it; {names.RULE}")
    found = inputs.load("solver", name, points, SolverError)
    point = points[0]
    if not callable(found):
        raise SolverError(
            f"solver {name!r}: {in_words(point)} is a {type(found).__name__}: give a class or a function; {_GUIDE}"
        )
    if inspect.isclass(found):
        _require(name, point, [part for part in ("supports", "start") if not callable(getattr(found, part, None))])
    return found  # type: ignore[no-any-return]


def made(name: str, point: EntryPoint, factory: Callable[..., Solver], settings: Mapping[str, Any]) -> Solver:
    """Make the solver with these settings.

    Raises:
        SolverError: the object that it makes is no solver.
        Exception: whatever the factory itself raises.
    """
    solver = factory(**settings)
    lacking = [part for part in ("supports", "start") if not callable(getattr(solver, part, None))]
    _require(name, point, lacking + ([] if isinstance(getattr(solver, "name", None), str) else ["name"]))
    if not names.is_name(solver.name):
        raise SolverError(f"solver {name!r}: {in_words(point)} calls itself {solver.name!r:.80}: {names.RULE}")
    return solver


def reason(name: str, points: list[EntryPoint]) -> str | None:
    """Say why the solver cannot be made; None where it can.

    Settings without a default are left for `create` to ask for.
    """
    try:
        factory = factory_of(name, points)
        if all(p.default is not p.empty or p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD) for p in parameters(factory)):
            made(name, points[0], factory, {})
    except SolverError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 - foreign code
        return f"solver {name!r}: {in_words(points[0])} cannot be made: {describe(error)}"
    return None


def parameters(factory: Callable[..., Any]) -> list[inspect.Parameter]:
    """List the settings that a factory takes; none where its signature is unknown."""
    try:
        return list(inspect.signature(factory).parameters.values())
    except (TypeError, ValueError):
        return []


def _require(name: str, point: EntryPoint, lacking: list[str]) -> None:
    if lacking:
        what = ", ".join(f"{part} ({_NEEDS[part]})" for part in lacking)
        raise SolverError(f"solver {name!r}: {in_words(point)} has no {what}: add it; {_GUIDE}")
