"""Solvers by name: those of this package, those that a library finds, and those of other packages by entry points.

A new one of ours is a file in this folder and a line in ``BUILT_IN``. A plug-in that is broken is reported with its
reason and hides no other.
"""

from __future__ import annotations

import importlib
import inspect
import warnings
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import Any, NamedTuple

from moc_opt.errors import MocOptError, SolverError, UnknownNameError, describe, shown
from moc_opt.inputs import names as naming
from moc_opt.inputs import plugins
from moc_opt.inputs.plugins import in_words
from moc_opt.solvers.base import Solver

GROUP = "moc_opt.solvers"
# name -> (module, class, package that must be installed or "")
BUILT_IN: dict[str, tuple[str, str, str]] = {
    "exact": ("moc_opt.solvers.exact", "Exact", ""),
    "rnn": ("moc_opt.solvers.rnn", "RNN", ""),
    "rnn-printed": ("moc_opt.solvers.rnn", "RNNPrinted", ""),
    "osqp": ("moc_opt.solvers.osqp", "OSQP", "osqp"),
    "proxqp": ("moc_opt.solvers.proxqp", "ProxQP", "proxsuite"),
    "daqp": ("moc_opt.solvers.daqp", "DAQP", "daqp"),
    "piqp": ("moc_opt.solvers.piqp", "PIQP", "piqp"),
    "quadprog": ("moc_opt.solvers.quadprog", "Quadprog", "quadprog"),
    "clarabel": ("moc_opt.solvers.clarabel", "Clarabel", "clarabel"),
    "nlp-sqp": ("moc_opt.solvers.nlp", "SQP", "casadi"),
    "nlp-ipopt": ("moc_opt.solvers.nlp", "Ipopt", "casadi"),
    "nlp-fatrop": ("moc_opt.solvers.nlp", "Fatrop", "casadi"),
}
# prefix -> (module, class, package): one adapter for all solvers that a library finds
FAMILIES: dict[str, tuple[str, str, str]] = {
    "qpsolvers:": ("moc_opt.solvers.qpsolvers", "QPSolver", "qpsolvers"),
    "casadi:": ("moc_opt.solvers.casadi_conic", "CasadiConic", "casadi"),
}
_NEEDS = {"name": "a text", "supports": "a method of qp", "start": "a method of qp"}
_GUIDE = "docs/extending.md shows a whole solver"


class Entry(NamedTuple):
    """What makes a solver, and the entry point that it comes from; None: it is ours."""

    make: Callable[..., Solver]
    plugin: EntryPoint | None = None

    def parameters(self) -> list[inspect.Parameter]:
        """List the settings that it takes; none where its signature is unknown."""
        try:
            return list(inspect.signature(self.make).parameters.values())
        except (TypeError, ValueError):
            return []


def names() -> list[str]:
    """Return every registered name, installed or not; ``qpsolvers:NAME``, ``casadi:NAME`` for what those find here."""
    return [name for name, reason in available().items() if reason is None or name in BUILT_IN]


def available() -> dict[str, str | None]:
    """Name -> None when it can run here, else the reason why not.

    Example:
        >>> mo.solvers.available()["exact"] is None
        True
    """
    found: dict[str, str | None] = {name: _absent(package) for name, (_, _, package) in BUILT_IN.items()}
    for prefix, (module, _, package) in FAMILIES.items():
        absent = _absent(package)
        reasons = {"NAME": absent} if absent else importlib.import_module(module).reasons()
        found.update({prefix + name: reason for name, reason in reasons.items()})
    for name, points in _plugins().items():
        if _ours(name):
            found[f"{name} ({in_words(points[0])})"] = _clash(name, points)
            continue
        found[name] = None
        try:
            entry = _of_plugin(name, points)
            # settings without a default are left for `create` to ask for
            if all(p.default is not p.empty or p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD) for p in entry.parameters()):
                _made(name, entry, {})
        except MocOptError as error:
            found[name] = str(error)
    return found


def check_name(name: str) -> None:
    """Check that there is a solver of that name, without importing it; `create` finds whether it can run here.

    Raises:
        UnknownNameError: with the nearest names.
    """
    if not (_ours(name) or name in _plugins()):
        raise UnknownNameError("solver", name, available(), "moc-opt solvers --list")


def accepts(name: str, setting: str) -> bool:
    """Return whether the named solver takes a setting of that name."""
    return setting in {parameter.name for parameter in find(name).parameters()}


def defaults(name: str) -> dict[str, Any]:
    """Return setting -> default of the named solver; those without one are left out.

    Raises:
        UnknownNameError, SolverError: as ``create``.
    """
    entry = find(name)
    found = {p.name: p.default for p in entry.parameters() if p.default is not p.empty}
    made = entry.make.func if isinstance(entry.make, partial) else entry.make
    if is_dataclass(made):  # a signature has no more than a mark where a default is made anew each time
        found |= {f.name: f.default_factory() for f in fields(made) if f.default_factory is not MISSING}
    return found


def create(name: str, **settings: Any) -> Solver:
    """Build a solver's frozen settings.

    Raises:
        UnknownNameError: with the nearest names.
        SolverError: a package is missing, a plug-in is no solver, or a setting is unknown or out of range.

    Example:
        >>> mo.solvers.create("exact").name
        'exact'
        >>> mo.solvers.create("exacct")
        Traceback (most recent call last):
        moc_opt.errors.UnknownNameError: unknown solver 'exacct': did you mean 'exact'? ...
    """
    return _made(name, find(name), settings)


def find(name: str) -> Entry:
    """Import what makes the named solver.

    Raises:
        UnknownNameError, SolverError: as ``create``.
    """
    if not isinstance(name, str):
        raise SolverError(f"solver = {shown(name)}: give the name of one, such as 'exact'")
    claimed = _plugins().get(name, [])
    if claimed and _ours(name):
        warnings.warn(_clash(name, claimed), UserWarning, stacklevel=3)
    if name in BUILT_IN:
        module, attribute, package = BUILT_IN[name]
        if _absent(package):
            raise SolverError(f"solver {name!r} needs the package {package!r}: pip install {package}")
        try:
            return Entry(getattr(importlib.import_module(module), attribute))
        except ImportError as error:
            raise SolverError(f"solver {name!r}: {describe(error)}: reinstall {package or 'moc_opt'}") from error
    for prefix, (module, attribute, package) in FAMILIES.items():
        if name.startswith(prefix) and not _absent(package):
            family, short = importlib.import_module(module), name.removeprefix(prefix)
            reasons = family.reasons()
            if short not in reasons:
                raise UnknownNameError(f"{prefix} solver", short, reasons)
            if reasons[short] is not None:
                raise SolverError(f"solver {name!r} cannot run: {reasons[short]}")
            return Entry(partial(getattr(family, attribute), short))
    if claimed:
        return _of_plugin(name, claimed)
    raise UnknownNameError("solver", name, available(), "moc-opt solvers --list")


def _absent(package: str) -> str | None:
    missing = package and find_spec(package) is None
    return f"package {package!r} is not installed: pip install {package}" if missing else None


def _ours(name: str) -> bool:
    return name in BUILT_IN or name.startswith(tuple(FAMILIES))


def _plugins() -> dict[str, list[EntryPoint]]:
    return plugins.plugins(GROUP, entry_points)


def _clash(name: str, points: list[EntryPoint]) -> str:
    module, attribute, _ = BUILT_IN.get(name, ("moc_opt.solvers.registry", "FAMILIES", ""))
    return (
        f"{' and '.join(map(in_words, points))}: the name {name!r} is that of a built-in solver ({module}:{attribute}),"
        " which is taken: rename the entry point"
    )


def _of_plugin(name: str, points: list[EntryPoint]) -> Entry:
    if not naming.is_name(name):
        raise SolverError(f"solver {name!r:.80}: {in_words(points[0])}: rename it; {naming.RULE}")
    found, point = plugins.load("solver", name, points, SolverError), points[0]
    if not callable(found):
        kind = type(found).__name__
        raise SolverError(f"solver {name!r}: {in_words(point)} is a {kind}: give a class or a function; {_GUIDE}")
    if inspect.isclass(found):
        _require(name, point, found, ("supports", "start"))
    return Entry(found, point)


def _made(name: str, entry: Entry, settings: dict[str, Any]) -> Solver:
    try:
        solver = entry.make(**settings)
    except MocOptError:
        raise
    except (Exception, SystemExit, KeyboardInterrupt) as error:
        valid = [p.name for p in entry.parameters() if p.name != "name"]
        unknown = sorted(set(settings) - set(valid))
        if isinstance(error, TypeError) and unknown:
            raise UnknownNameError(f"setting of solver {name!r}", unknown[0], valid) from error
        if entry.plugin is not None:
            what = f"{in_words(entry.plugin)} cannot be made: {describe(error)}"
            raise SolverError(f"solver {name!r}: {what}") from error
        if isinstance(error, TypeError):
            raise SolverError(f"solver {name!r}: {error}") from error
        raise
    if entry.plugin is not None:
        _require(name, entry.plugin, solver, ("supports", "start", "name"))
        if not naming.is_name(solver.name):
            raise SolverError(
                f"solver {name!r}: {in_words(entry.plugin)} calls itself {solver.name!r:.80}: {naming.RULE}"
            )
    return solver


def _require(name: str, point: EntryPoint, found: object, parts: tuple[str, ...]) -> None:
    lacking = [
        f"{part} ({_NEEDS[part]})" for part in parts
        if not (isinstance(getattr(found, part, None), str) if part == "name" else callable(getattr(found, part, None)))
    ]  # fmt: skip
    if lacking:
        raise SolverError(f"solver {name!r}: {in_words(point)} has no {', '.join(lacking)}: add it; {_GUIDE}")
