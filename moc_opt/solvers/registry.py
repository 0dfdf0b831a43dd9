"""Solvers by name: built-in ones, those of qpsolvers, and plug-ins of other packages.

To add a solver to this package, add a file to this folder and a line to ``BUILT_IN``.
"""

from __future__ import annotations

import importlib
import inspect
import warnings
from collections.abc import Callable
from functools import partial
from importlib.metadata import EntryPoint
from importlib.util import find_spec
from typing import Any, NamedTuple

from moc_opt.errors import MocOptError, SolverError, UnknownNameError, describe, located, shown
from moc_opt.inputs import plugins
from moc_opt.inputs.names import RULE, is_name
from moc_opt.inputs.plugins import in_words
from moc_opt.solvers.base import Solver

GROUP = "moc_opt.solvers"
# By name: module, class, and required package ("" if none).
BUILT_IN: dict[str, tuple[str, str, str]] = {
    "exact": ("exact", "Exact", ""),
    "rnn": ("rnn", "RNN", ""),
    "rnn-printed": ("rnn", "RNNPrinted", ""),
    "osqp": ("osqp", "OSQP", "osqp"),
    "proxqp": ("proxqp", "ProxQP", "proxsuite"),
    "daqp": ("daqp", "DAQP", "daqp"),
    "piqp": ("piqp", "PIQP", "piqp"),
    "quadprog": ("quadprog", "Quadprog", "quadprog"),
    "clarabel": ("clarabel", "Clarabel", "clarabel"),
    "nlp-sqp": ("nlp", "SQP", "casadi"),
    "nlp-ipopt": ("nlp", "Ipopt", "casadi"),
}
QPSOLVERS = "qpsolvers:"  #: prefix of the solvers of qpsolvers


class Entry(NamedTuple):
    """A solver's name and the callable that makes it."""

    name: str
    make: Callable[..., Solver]
    plugin: EntryPoint | None = None

    @property
    def parameters(self) -> dict[str, inspect.Parameter]:
        """The callable's parameters; empty if unknown."""
        try:
            return dict(inspect.signature(self.make).parameters)
        except (TypeError, ValueError):
            return {}

    def create(self, **settings: Any) -> Solver:
        """Make the solver."""
        made_by = "it" if self.plugin is None else in_words(self.plugin)
        try:
            solver = self.make(**settings)
        except MocOptError:
            raise
        except (Exception, SystemExit) as error:
            unknown = sorted(settings.keys() - self.parameters.keys())
            if isinstance(error, TypeError) and unknown:
                raise UnknownNameError(f"setting of solver {self.name}:", unknown[0], self.parameters) from error
            raise SolverError(f"solver {self.name!r}: {made_by} cannot be made: {located(error)}") from error
        return solver if self.plugin is None else check_solver(solver, f"solver {self.name!r}: {made_by}")


def check_solver(given: object, what: str = "") -> Solver:
    """Return ``given``. Raise a SolverError if it is no solver."""
    what = what or shown(given, 80)
    if isinstance(given, type):
        raise SolverError(f"{what} is a class, no solver: call it, as in {given.__name__}()")
    if isinstance(given, str):
        raise SolverError(f"{what} is a name, no solver: give moc_opt.solvers.create({what})")
    lacking = [part for part in ("supports", "start") if not callable(getattr(given, part, None))]
    if lacking:
        cure = "add what is missing, as docs/extending.md shows; solvers.create(name) makes a built-in solver"
        raise SolverError(f"{what} is no solver: it has no method `{'` and no `'.join(lacking)}`: {cure}")
    name = getattr(given, "name", None)
    if not is_name(name):
        has = "has no name: set its attribute `name`" if name is None else f"has the name {shown(name, 80)}"
        raise SolverError(f"{what} {has}: {RULE}")
    return given  # type: ignore[return-value]


def available() -> dict[str, str | None]:
    """Map each solver's name to the reason why it cannot run here, or to None."""
    found: dict[str, str | None] = {name: _absent(package) for name, (_, _, package) in BUILT_IN.items()}
    absent = _absent("qpsolvers")
    libraries = {"NAME": absent} if absent else importlib.import_module("moc_opt.solvers.qpsolvers").reasons()
    found.update({QPSOLVERS + name: reason for name, reason in libraries.items()})
    for name, points in plugins.plugins(GROUP).items():
        if _ours(name):
            found[f"{name} ({in_words(points[0])})"] = _clash(name, points)
            continue
        try:
            entry = _of_plugin(name, points)
            named = (p for p in entry.parameters.values() if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD))
            if all(p.default is not p.empty for p in named):  # a plug-in that needs arguments is not tried
                entry.create()
            found[name] = None
        except MocOptError as error:
            found[name] = str(error)
    return found


def check_name(name: str) -> None:
    """Raise an UnknownNameError if no solver has this name."""
    if not (_ours(name) or name in plugins.plugins(GROUP)):
        raise UnknownNameError("solver", name, available(), "moc-opt solvers --list")


def defaults(name: str) -> dict[str, Any]:
    """Return a solver's default settings. Raise what ``create`` raises."""
    return {p.name: p.default for p in find(name).parameters.values() if p.default is not p.empty}


def create(name: str, **settings: Any) -> Solver:
    """Create a solver.

    Raises:
        UnknownNameError: no such solver or setting.
        SolverError: a package is missing, a plug-in is no solver, or a setting is out of range.
    """
    return find(name).create(**settings)


def find(name: str) -> Entry:
    """Import a solver, and return its `Entry`. Raise what ``create`` raises."""
    if not isinstance(name, str):
        raise SolverError(f"solver = {shown(name)}: give a solver's name, such as 'exact'")
    claimed = plugins.plugins(GROUP).get(name, [])
    if claimed and _ours(name):
        warnings.warn(_clash(name, claimed), UserWarning, stacklevel=3)
    if name in BUILT_IN:
        module, attribute, package = BUILT_IN[name]
        reason = _absent(package)
        if reason:
            raise SolverError(f"solver {name!r} cannot run: {reason}")
        try:
            return Entry(name, getattr(importlib.import_module(f"moc_opt.solvers.{module}"), attribute))
        except ImportError as error:
            raise SolverError(f"solver {name!r}: {describe(error)}: reinstall {package or 'moc_opt'}") from error
    if name.startswith(QPSOLVERS) and not _absent("qpsolvers"):
        adapter, library = importlib.import_module("moc_opt.solvers.qpsolvers"), name.removeprefix(QPSOLVERS)
        reasons = adapter.reasons()
        if library not in reasons:
            raise UnknownNameError("qpsolvers: solver", library, reasons)
        if reasons[library] is not None:
            raise SolverError(f"solver {name!r} cannot run: {reasons[library]}")
        return Entry(name, partial(adapter.QPSolver, library))
    if claimed:
        return _of_plugin(name, claimed)
    raise UnknownNameError("solver", name, available(), "moc-opt solvers --list")


def _absent(package: str) -> str | None:
    missing = package and find_spec(package) is None
    return f"package {package!r} is not installed: pip install {package}" if missing else None


def _ours(name: str) -> bool:
    return name in BUILT_IN or name.startswith(QPSOLVERS)


def _clash(name: str, points: list[EntryPoint]) -> str:
    claims = " and ".join(map(in_words, points))
    return f"{claims}: the name {name!r} belongs to a built-in solver: rename the entry point"


def _of_plugin(name: str, points: list[EntryPoint]) -> Entry:
    if not is_name(name):
        raise SolverError(f"solver {name!r:.80}: {in_words(points[0])}: rename it; {RULE}")
    return Entry(name, plugins.load("solver", name, points, SolverError), points[0])
