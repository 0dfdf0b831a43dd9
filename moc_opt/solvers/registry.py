"""Solvers by name. A new one is a file in ``backends``, ``neural`` or ``nlp`` and a line in ``BUILT_IN``."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any

from moc_opt.errors import MocOptError, SolverError, UnknownNameError, describe, shown
from moc_opt.solvers import plugins
from moc_opt.solvers.base import Solver

# name -> (module, class, package that must be installed or "")
BUILT_IN: dict[str, tuple[str, str, str]] = {
    "exact": ("moc_opt.solvers.exact.solver", "Exact", ""),
    "rnn": ("moc_opt.solvers.neural.projection", "RNN", ""),
    "rnn-printed": ("moc_opt.solvers.neural.projection", "RNNPrinted", ""),
    "osqp": ("moc_opt.solvers.backends.osqp", "OSQP", "osqp"),
    "proxqp": ("moc_opt.solvers.backends.proxqp", "ProxQP", "proxsuite"),
    "daqp": ("moc_opt.solvers.backends.daqp", "DAQP", "daqp"),
    "piqp": ("moc_opt.solvers.backends.piqp", "PIQP", "piqp"),
    "quadprog": ("moc_opt.solvers.backends.quadprog", "Quadprog", "quadprog"),
    "clarabel": ("moc_opt.solvers.backends.clarabel", "Clarabel", "clarabel"),
    "nlp-sqp": ("moc_opt.solvers.nlp.nlp", "SQP", "casadi"),
    "nlp-ipopt": ("moc_opt.solvers.nlp.nlp", "Ipopt", "casadi"),
    "nlp-fatrop": ("moc_opt.solvers.nlp.nlp", "Fatrop", "casadi"),
}
# prefix -> (package, module): one adapter for all solvers that a library finds
FAMILIES: dict[str, tuple[str, str]] = {
    "qpsolvers:": ("qpsolvers", "moc_opt.solvers.backends.qpsolvers"),
    "casadi:": ("casadi", "moc_opt.solvers.backends.casadi_conic"),
}


def names() -> list[str]:
    """Return every registered name, installed or not; ``qpsolvers:NAME``, ``casadi:NAME`` for what those find here."""
    return [name for name, reason in available().items() if reason is None or name in BUILT_IN]


def available() -> dict[str, str | None]:
    """Name -> None when it can run here, else the reason why not.

    Example:
        >>> mo.solvers.available()["exact"] is None
        True
    """
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
    for name, points in plugins.plugins().items():
        if _ours(name):
            found[f"{name} ({plugins.in_words(points[0])})"] = _clash(name, points)
        else:
            found[name] = plugins.reason(name, points)
    return found


def _ours(name: str) -> bool:
    return name in BUILT_IN or name.startswith(tuple(FAMILIES))


def _clash(name: str, points: list[Any]) -> str:
    module, attribute, _ = BUILT_IN.get(name, ("moc_opt.solvers.registry", "FAMILIES", ""))
    claims = " and ".join(map(plugins.in_words, points))
    return (
        f"{claims}: the name {name!r} is that of a built-in solver ({module}:{attribute}), which is taken: "
        "rename the entry point"
    )


def _factory(name: str) -> Callable[..., Solver]:
    if not isinstance(name, str):
        raise SolverError(f"solver = {shown(name)}: give the name of one, such as 'exact'")
    claimed = plugins.plugins().get(name, [])
    if claimed and _ours(name):
        warnings.warn(_clash(name, claimed), UserWarning, stacklevel=4)
    if name in BUILT_IN:
        module, attribute, package = BUILT_IN[name]
        if package and find_spec(package) is None:
            raise SolverError(f"solver {name!r} needs the package {package!r}: pip install {package}")
        try:
            return getattr(importlib.import_module(module), attribute)  # type: ignore[no-any-return]
        except ImportError as error:
            raise SolverError(f"solver {name!r}: {describe(error)}: reinstall {package or 'moc_opt'}") from error
    for prefix, (package, module) in FAMILIES.items():
        if name.startswith(prefix) and find_spec(package) is not None:
            return importlib.import_module(module).factory(name.removeprefix(prefix))
    if claimed:
        return plugins.factory_of(name, claimed)
    raise UnknownNameError("solver", name, available(), "moc-opt solvers --list")


def check_name(name: str) -> None:
    """Check that there is a solver of that name, without importing it; `create` finds whether it can run here.

    Raises:
        UnknownNameError: with the nearest names.
    """
    if not (_ours(name) or name in plugins.plugins()):
        raise UnknownNameError("solver", name, available(), "moc-opt solvers --list")


def accepts(name: str, setting: str) -> bool:
    """Return whether the solver's factory takes a setting of that name."""
    return setting in {parameter.name for parameter in plugins.parameters(_factory(name))}


def defaults(name: str) -> dict[str, Any]:
    """Return setting -> default of the named solver; those without one are left out.

    Raises:
        UnknownNameError, SolverError: as ``create``.
    """
    factory = _factory(name)
    found = {p.name: p.default for p in plugins.parameters(factory) if p.default is not p.empty}
    made = factory.func if isinstance(factory, partial) else factory
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
    factory = _factory(name)
    points = [] if _ours(name) else plugins.plugins()[name]
    try:
        return plugins.made(name, points[0], factory, settings) if points else factory(**settings)
    except TypeError as error:
        valid = [p.name for p in plugins.parameters(factory) if p.name != "name"]
        unknown = sorted(set(settings) - set(valid))
        if unknown:
            raise UnknownNameError(f"setting of solver {name!r}", unknown[0], valid) from error
        raise SolverError(f"solver {name!r}: {error}") from error
    except MocOptError:
        raise
    except Exception as error:
        if not points:
            raise
        what = plugins.in_words(points[0])
        raise SolverError(f"solver {name!r}: {what} cannot be made: {describe(error)}") from error
