"""Solvers by name: those of this package, those that a library finds, and those of other packages by entry points.

A new one of ours is a file in this folder and a line in ``BUILT_IN``. A plug-in that is broken is listed with its
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
from moc_opt.inputs import plugins
from moc_opt.inputs.names import RULE, is_name
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
    "casadi:qrqp": ("moc_opt.solvers.qrqp", "QRQP", "casadi"),
}
QPSOLVERS = "qpsolvers:"
"""Prefix of all solvers that the package qpsolvers finds: one adapter for them."""
_VARIABLE = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
_PARTS = {"name": "a text", "supports": "a method of qp", "start": "a method of qp"}
_GUIDE = "docs/extending.md shows a whole solver"


class Entry(NamedTuple):
    """What makes the named solver, and the entry point that it comes from; None: it is ours."""

    name: str
    make: Callable[..., Solver]
    plugin: EntryPoint | None = None

    @property
    def parameters(self) -> dict[str, inspect.Parameter]:
        """Setting -> parameter; empty where the signature is unknown."""
        try:
            return dict(inspect.signature(self.make).parameters)
        except (TypeError, ValueError):
            return {}

    def create(self, **settings: Any) -> Solver:
        """Make the solver; see the function `create`."""
        try:
            solver = self.make(**settings)
        except MocOptError:
            raise
        except Exception as error:
            valid = [name for name in self.parameters if name != "name"]
            unknown = sorted(set(settings) - set(valid))
            if isinstance(error, TypeError) and unknown:
                raise UnknownNameError(f"setting of solver {self.name!r}", unknown[0], valid) from error
            if self.plugin is not None:
                reason = f"{in_words(self.plugin)} cannot be made: {describe(error)}"
                raise SolverError(f"solver {self.name!r}: {reason}") from error
            if isinstance(error, TypeError):
                raise SolverError(f"solver {self.name!r}: {error}") from error
            raise
        if self.plugin is not None:
            _require(self.name, self.plugin, solver, ("supports", "start", "name"))
            if not is_name(solver.name):
                own = f"{in_words(self.plugin)} calls itself {solver.name!r:.80}"
                raise SolverError(f"solver {self.name!r}: {own}: {RULE}")
        return solver


def available() -> dict[str, str | None]:
    """Name -> None when it can run here, else the reason why not.

    Example:
        >>> mo.solvers.available()["exact"] is None
        True
    """
    found: dict[str, str | None] = {name: _absent(package) for name, (_, _, package) in BUILT_IN.items()}
    absent = _absent("qpsolvers")
    reasons = {"NAME": absent} if absent else importlib.import_module("moc_opt.solvers.qpsolvers").reasons()
    found.update({QPSOLVERS + name: reason for name, reason in reasons.items()})
    for name, points in _plugins().items():
        if _ours(name):
            found[f"{name} ({in_words(points[0])})"] = _clash(name, points)
            continue
        try:
            entry = _of_plugin(name, points)
            needed = [p for p in entry.parameters.values() if p.default is p.empty and p.kind not in _VARIABLE]
            if not needed:  # else `create` asks for them
                entry.create()
            found[name] = None
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
    return setting in find(name).parameters


def defaults(name: str) -> dict[str, Any]:
    """Return setting -> default of the named solver; those without one are left out.

    Raises:
        UnknownNameError, SolverError: as ``create``.
    """
    entry = find(name)
    found = {p.name: p.default for p in entry.parameters.values() if p.default is not p.empty}
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
    return find(name).create(**settings)


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
            return Entry(name, getattr(importlib.import_module(module), attribute))
        except ImportError as error:
            raise SolverError(f"solver {name!r}: {describe(error)}: reinstall {package or 'moc_opt'}") from error
    if name.startswith(QPSOLVERS) and not _absent("qpsolvers"):
        family, short = importlib.import_module("moc_opt.solvers.qpsolvers"), name.removeprefix(QPSOLVERS)
        reasons = family.reasons()
        if short not in reasons:
            raise UnknownNameError("qpsolvers: solver", short, reasons)
        if reasons[short] is not None:
            raise SolverError(f"solver {name!r} cannot run: {reasons[short]}")
        return Entry(name, partial(family.QPSolver, short))
    if claimed:
        return _of_plugin(name, claimed)
    raise UnknownNameError("solver", name, available(), "moc-opt solvers --list")


def _absent(package: str) -> str | None:
    missing = package and find_spec(package) is None
    return f"package {package!r} is not installed: pip install {package}" if missing else None


def _ours(name: str) -> bool:
    return name in BUILT_IN or name.startswith(QPSOLVERS)


def _plugins() -> dict[str, list[EntryPoint]]:
    return plugins.plugins(GROUP, entry_points)


def _clash(name: str, points: list[EntryPoint]) -> str:
    claims = " and ".join(map(in_words, points))
    return f"{claims}: the name {name!r} is that of a built-in solver, which is taken: rename the entry point"


def _of_plugin(name: str, points: list[EntryPoint]) -> Entry:
    if not is_name(name):
        raise SolverError(f"solver {name!r:.80}: {in_words(points[0])}: rename it; {RULE}")
    made, point = plugins.load("solver", name, points, SolverError), points[0]
    if not callable(made):
        kind = type(made).__name__
        raise SolverError(f"solver {name!r}: {in_words(point)} is a {kind}: give a class or a function; {_GUIDE}")
    if inspect.isclass(made):
        _require(name, point, made, ("supports", "start"))
    return Entry(name, made, point)


def _require(name: str, point: EntryPoint, given: object, parts: tuple[str, ...]) -> None:
    def has(part: str) -> bool:
        value = getattr(given, part, None)
        return isinstance(value, str) if part == "name" else callable(value)

    lacking = ", ".join(f"{part} ({_PARTS[part]})" for part in parts if not has(part))
    if lacking:
        raise SolverError(f"solver {name!r}: {in_words(point)} has no {lacking}: add it; {_GUIDE}")
