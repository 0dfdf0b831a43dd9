"""Solvers of third parties, found by their entry points; one that is broken is reported and hides no other."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from moc_opt.errors import SolverError, describe
from moc_opt.inputs import names
from moc_opt.solvers.base import Solver

GROUP = "moc_opt.solvers"
_NEEDS = {"name": "a text", "supports": "a method of qp", "start": "a method of qp"}
_GUIDE = "docs/extending.md shows a whole solver"


def plugins() -> dict[str, list[EntryPoint]]:
    """Map each name to the different entry points that claim it; one that is announced twice counts once."""
    return _scan(tuple(sys.path), entry_points)


@lru_cache(maxsize=8)
def _scan(path: tuple[str, ...], look: Callable[..., Iterable[EntryPoint]]) -> dict[str, list[EntryPoint]]:
    # 10 ms for a hundred packages, and a sweep makes thousands of solvers
    found: dict[str, dict[str, EntryPoint]] = {}
    for point in look(group=GROUP):
        found.setdefault(point.name, {}).setdefault(point.value, point)
    return {name: list(points.values()) for name, points in found.items()}


def in_words(point: EntryPoint) -> str:
    """Name the entry point and the package that announces it, for messages."""
    package = getattr(point.dist, "name", None)
    return f"entry point {point.value!r}" + (f" of package {package!r}" if package else "")


def factory_of(name: str, points: list[EntryPoint]) -> Callable[..., Solver]:
    """Load the class or function that makes the solver.

    Raises:
        SolverError: several claim the name, the entry point cannot be imported, or it is no solver.
    """
    if not names.is_name(name):
        raise SolverError(f"solver {name!r:.80}: {in_words(points[0])}: rename it; {names.RULE}")
    if len(points) > 1:
        claims = " and ".join(map(in_words, points))
        raise SolverError(f"solver {name!r}: {claims} claim this name: rename one, or uninstall its package")
    (point,) = points
    try:
        found = point.load()
    except (Exception, SystemExit) as error:
        raise SolverError(
            f"solver {name!r}: {in_words(point)} does not load: {describe(error)}; mend or uninstall its package"
        ) from error
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
        SolverError: what it makes is no solver.
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
