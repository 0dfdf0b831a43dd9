"""The settings under which each solver is studied, from solver-settings.toml."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from moc_opt.solvers import create
from moc_opt.solvers.registry import defaults

DEFAULT, TIGHT, RECOMMENDED = "default", "tight", "recommended"
QPSOLVERS, NONLINEAR = "qpsolvers:", "nlp-"
"""Prefixes of the names of solvers that are called through qpsolvers, and of nonlinear solvers."""
SETTINGS = tomllib.loads(Path(__file__).with_name("solver-settings.toml").read_text(encoding="utf-8"))
AS_QPSOLVERS_CALLS_IT = {"rows": 6, "cost_scale": 1.0, "advised": False}


@dataclass(frozen=True)
class SolverSetting:
    """One solver under one setting."""

    solver: str
    name: str
    options: Mapping[str, Any]
    reason: str

    @property
    def label(self) -> str:
        """Solver and setting, such as "osqp@tight"."""
        return f"{self.solver}@{self.name}"

    @property
    def recommended(self) -> bool:
        """Whether it is the recommended setting."""
        return self.name == RECOMMENDED

    @property
    def nonlinear(self) -> bool:
        """Whether the solver solves a nonlinear version of the subproblem."""
        return self.solver.startswith(NONLINEAR)

    @property
    def six_rows(self) -> bool:
        """Whether the solver gets six equality rows, which can contradict each other."""
        return self.solver == "exact" or self.options.get("rows") == 6


def solver_settings(
    names: Iterable[str], overrides: Mapping[str, Mapping[str, Any]] | None = None
) -> list[SolverSetting]:
    """Return the solvers' settings. ``overrides[solver]`` changes options of its recommended setting."""
    return [
        SolverSetting(solver, name, {**options, **((overrides or {}).get(solver, {}) if name == RECOMMENDED else {})},
                      reason)
        for solver in names for name, (options, reason) in of(solver).items()
    ]  # fmt: skip


def of(name: str) -> dict[str, tuple[dict[str, Any], str]]:
    """Map the names of a solver's settings to (options, reason)."""
    tables = SETTINGS.get(name, {})
    if not name.startswith(QPSOLVERS):
        known = {of: ({key: v for key, v in one.items() if key != "why"}, one["why"]) for of, one in tables.items()}
        return known or {RECOMMENDED: ({}, "the solver's defaults: the study has no settings for this solver")}
    found = {DEFAULT: (AS_QPSOLVERS_CALLS_IT, "the library as qpsolvers calls it, on six rows")}
    if TIGHT in tables:
        values = ", ".join(f"{key} = {value:g}" for key, value in tables[TIGHT]["options"].items())
        found[TIGHT] = ({**AS_QPSOLVERS_CALLS_IT, **tables[TIGHT]}, values)
    found[RECOMMENDED] = ({}, "five rows and a scaled cost; options that are not listed keep the library's defaults")
    return found


def effective(setting: SolverSetting) -> dict[str, Any]:
    """Return the solver's options, with the adapter's defaults."""
    found = {**defaults(setting.solver), **setting.options}
    for name in ("kinematics", "period"):
        found.pop(name, None)
    if setting.solver.startswith(QPSOLVERS):
        advice = create(setting.solver, **setting.options).advice  # type: ignore[attr-defined]
        found = {"rows": found["rows"], "cost_scale": advice.cost_scale, **advice.options}
    return found


def in_words(options: Mapping[str, Any]) -> str:
    """Write options on one line."""
    parts = []
    for name, value in options.items():
        if isinstance(value, Mapping):
            parts += [in_words(value)] if value else []
        else:
            parts.append(f"{name} = {value:g}" if isinstance(value, float) else f"{name} = {value}")
    return ", ".join(parts) or "nothing to set"
