"""Solvers by name. A new one is a file beside this one and a line in ``BUILT_IN``."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import Any

from moc_opt.errors import SolverError, UnknownNameError
from moc_opt.solvers.base import Solver

ENTRY_POINTS = "moc_opt.solvers"

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
# prefix -> (package, module): one adapter for all solvers that a library finds
FAMILIES: dict[str, tuple[str, str]] = {
    "qpsolvers:": ("qpsolvers", "moc_opt.solvers.qpsolvers"),
    "casadi:": ("casadi", "moc_opt.solvers.casadi_conic"),
}


def _plugins() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=ENTRY_POINTS)}


def names() -> list[str]:
    """Every registered name, installed or not; ``qpsolvers:NAME`` and ``casadi:NAME`` for what those find here."""
    return [name for name, reason in available().items() if reason is None or name in BUILT_IN]


def available() -> dict[str, str | None]:
    """Name -> None when it can run here, else the reason why not."""
    found: dict[str, str | None] = {}
    for name, (_, _, package) in BUILT_IN.items():
        missing = package and find_spec(package) is None
        found[name] = f"package {package!r} is not installed: pip install {package}" if missing else None
    for prefix, (package, module) in FAMILIES.items():
        if find_spec(package) is None:
            found[prefix + "NAME"] = f"package {package!r} is not installed: pip install {package}"
        else:
            reasons = importlib.import_module(module).reasons()
            found.update({prefix + name: reason for name, reason in reasons.items()})
    for name, point in _plugins().items():
        try:
            point.load()
        except Exception as error:  # noqa: BLE001 - a broken plug-in must not hide the others
            found[name] = f"entry point {point.value!r} does not load: {error}"
        else:
            found.setdefault(name, None)
    return found


def _factory(name: str) -> Callable[..., Solver]:
    if name in BUILT_IN:
        module, attribute, package = BUILT_IN[name]
        if package and find_spec(package) is None:
            raise SolverError(f"solver {name!r} needs the package {package!r}: pip install {package}")
        return getattr(importlib.import_module(module), attribute)  # type: ignore[no-any-return]
    for prefix, (package, module) in FAMILIES.items():
        if name.startswith(prefix) and find_spec(package) is not None:
            return importlib.import_module(module).factory(name.removeprefix(prefix))
    plugins = _plugins()
    if name in plugins:
        return plugins[name].load()  # type: ignore[no-any-return]
    raise UnknownNameError("solver", name, available())


def accepts(name: str, setting: str) -> bool:
    """Whether the solver's factory takes a setting of that name."""
    return setting in inspect.signature(_factory(name)).parameters


def defaults(name: str) -> dict[str, Any]:
    """Setting -> default of the named solver; those without one are left out.

    Raises:
        UnknownNameError, SolverError: as ``create``.
    """
    factory = _factory(name)
    parameters = inspect.signature(factory).parameters.values()
    found = {p.name: p.default for p in parameters if p.default is not p.empty}
    made = factory.func if isinstance(factory, partial) else factory
    if is_dataclass(made):  # a signature has no more than a mark where a default is made anew each time
        found |= {f.name: f.default_factory() for f in fields(made) if f.default_factory is not MISSING}
    return found


def create(name: str, **settings: Any) -> Solver:
    """Build a solver's frozen settings.

    Raises:
        UnknownNameError: with the nearest names.
        SolverError: a package is missing, or a setting is unknown or out of range.
    """
    factory = _factory(name)
    try:
        return factory(**settings)
    except TypeError as error:
        valid = [p for p in inspect.signature(factory).parameters if p != "name"]
        unknown = sorted(set(settings) - set(valid))
        if unknown:
            raise UnknownNameError(f"setting of solver {name!r}", unknown[0], valid) from error
        raise SolverError(f"solver {name!r}: {error}") from error
