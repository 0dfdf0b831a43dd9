"""Under which settings each solver is studied, and why: the one table.

Three settings each: ``default`` is the library as it comes, on the paper's six rows and its unscaled cost;
``tight`` changes its tolerances alone; ``recommended`` is our adapter's default. The network has no library: its
``default`` are the paper's weights and gain, and further settings vary method, steps and weights.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from moc_opt.solvers import create
from moc_opt.solvers.registry import defaults

DEFAULT, TIGHT, RECOMMENDED = "default", "tight", "recommended"
QPSOLVERS, NONLINEAR = "qpsolvers:", "nlp-"
"""Beginnings of names: libraries that qpsolvers calls; solvers of the nonlinear problem of the tick."""


@dataclass(frozen=True)
class SolverSetting:
    """One solver under one setting."""

    solver: str
    name: str
    options: Mapping[str, Any]
    reason: str

    @property
    def label(self) -> str:
        """Its name in tables."""
        return f"{self.solver}@{self.name}"

    @property
    def recommended(self) -> bool:
        """Whether it is the setting under which the solver is judged."""
        return self.name == RECOMMENDED

    @property
    def nonlinear(self) -> bool:
        """Whether the solver answers the nonlinear problem of the tick, which the judge does not verify."""
        return self.solver.startswith(NONLINEAR)

    @property
    def six_rows(self) -> bool:
        """Whether it is given the paper's six rows, and may say that they contradict each other."""
        return self.solver == "exact" or self.options.get("rows") == 6


PAPER_FORM: dict[str, Any] = {"rows": 6, "cost_scale": 1.0}  # what a user writes down who reads the paper

# solver -> setting -> (options, reason)
SETTINGS: dict[str, dict[str, tuple[dict[str, Any], str]]] = {
    "exact": {RECOMMENDED: ({}, "a closed form with a fallback: nothing to set")},
    "osqp": {
        DEFAULT: ({**PAPER_FORM, "eps": 1e-3, "eps_rel": 1e-3}, "OSQP 1.1: eps_abs = eps_rel = 1e-3"),
        TIGHT: ({**PAPER_FORM, "eps": 1e-9, "eps_rel": 0.0}, "eps_abs = 1e-9, no relative part"),
        RECOMMENDED: (
            {},
            "1e-3 is ten times the whole gradient; eps = 1e-8 with costs x 100 left no wrong claim, for twice the "
            "iterations; five rows",
        ),
    },
    "proxqp": {
        DEFAULT: (
            {**PAPER_FORM, "eps": 1e-5, "eps_primal_inf": 1e-4, "max_iter": 10_000, "max_iter_in": 1500},
            "proxsuite 0.8: eps_abs = 1e-5, eps_primal_inf = 1e-4, 10000 outer and 1500 inner iterations",
        ),
        TIGHT: (
            {**PAPER_FORM, "eps": 1e-9, "eps_primal_inf": 1e-4, "max_iter": 10_000, "max_iter_in": 1500},
            "eps_abs = 1e-9; the tolerance of infeasibility as it comes",
        ),
        RECOMMENDED: (
            {},
            "eps_primal_inf = 1e-4 calls feasible problems infeasible, 1e-9 with costs x 10 does not; few iterations, "
            "as an undecided problem would run for minutes; five rows",
        ),
    },
    "daqp": {
        DEFAULT: ({**PAPER_FORM, "primal_tol": 1e-6}, "DAQP 0.11: primal_tol = 1e-6, dual_tol = 1e-12"),
        TIGHT: ({**PAPER_FORM, "primal_tol": 1e-10}, "primal_tol = 1e-10"),
        RECOMMENDED: ({}, "costs x 1e3: else one undamped answer in twenty stops at the wrong end; five rows"),
    },
    "piqp": {
        DEFAULT: ({**PAPER_FORM, "eps": 1e-8}, "PIQP 0.6: eps_abs = 1e-8"),
        TIGHT: ({**PAPER_FORM, "eps": 1e-11}, "eps_abs = 1e-11"),
        RECOMMENDED: ({}, "eps = 1e-9 with costs x 1e3: the gradient stands clear of the tolerance; five rows"),
    },
    "quadprog": {
        RECOMMENDED: (
            {},
            "as it comes: it has no tolerance; five rows, as it fails on dependent ones; needs regularization > 0",
        ),
    },
    "clarabel": {
        DEFAULT: ({**PAPER_FORM, "eps": 1e-8}, "Clarabel 0.11: tol_gap = tol_feas = 1e-8"),
        TIGHT: ({**PAPER_FORM, "eps": 1e-11}, "tol_gap = tol_feas = 1e-11"),
        RECOMMENDED: ({}, "costs x 1e3: else about one answer in a hundred misses 1e-3 relative; five rows"),
    },
    "nlp-sqp": {
        DEFAULT: (
            {"cost_scale": 1.0, "eps": 1e-6, "hessian": "exact"},
            "sqpmethod: tol_pr = tol_du = 1e-6, exact Hessian",
        ),
        TIGHT: ({"cost_scale": 1.0, "eps": 1e-9, "hessian": "exact"}, "both tolerances 1e-9"),
        RECOMMENDED: (
            {},
            "BFGS: the exact Hessian is indefinite without regularization and often finds no answer; costs x 1e5 make "
            "the identity, where BFGS begins, the true Hessian",
        ),
    },
    "nlp-ipopt": {
        DEFAULT: ({"cost_scale": 1.0, "eps": 1e-8, "max_iter": 3000}, "IPOPT: tol = 1e-8, 3000 iterations"),
        TIGHT: ({"cost_scale": 1.0, "eps": 1e-10, "max_iter": 3000}, "tol = 1e-10"),
        RECOMMENDED: ({}, "costs x 1e4 instead of a tolerance near rounding"),
    },
    "rnn-printed": {RECOMMENDED: ({}, "equation (2) to the letter; its modes are slower than 50 s")},
    "rnn": {
        DEFAULT: (
            {"scale": 1.0, "k": 0.1, "h": 0.09},
            "the paper's weights and k = 0.1, with the largest stable step: 3e7 steps to 1e-3",
        ),
        TIGHT: ({"steps": 1000}, "1000 steps a tick"),
        RECOMMENDED: ({}, "weights x 100, k = 0.5, h = 1, 10 steps: stable, and warm from tick to tick"),
        "explicit-1": ({"steps": 1}, "one step a tick"),
        "explicit-100": ({"steps": 100}, "a hundred steps a tick"),
        "semi-implicit-1": ({"steps": 1, "method": "semi-implicit"}, "multipliers on the new x, one step"),
        "semi-implicit-10": ({"steps": 10, "method": "semi-implicit"}, "multipliers on the new x, ten steps"),
        "semi-implicit-100": ({"steps": 100, "method": "semi-implicit"}, "multipliers on the new x, a hundred"),
        "weights-10": ({"scale": 10.0, "k": 0.5, "h": 0.15}, "weights x 10 only: h k < c0 wants shorter steps"),
    },
}  # fmt: skip

# Through qpsolvers the tolerances have the libraries' own names.
TIGHT_OPTIONS: dict[str, dict[str, Any]] = {
    "clarabel": {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11},
    "daqp": {"primal_tol": 1e-10},
    "highs": {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    "osqp": {"eps_abs": 1e-9, "eps_rel": 0.0},
    "piqp": {"eps_abs": 1e-11, "eps_rel": 0.0},
    "proxqp": {"eps_abs": 1e-9, "eps_rel": 0.0},
    "scs": {"eps_abs": 1e-9, "eps_rel": 0.0},
}


def solver_settings(
    names: Iterable[str], overrides: Mapping[str, Mapping[str, Any]] | None = None
) -> list[SolverSetting]:
    """Return every setting of every named solver; ``overrides`` (solver -> options) change the recommended ones."""
    return [
        SolverSetting(solver, name, {**options, **((overrides or {}).get(solver, {}) if name == RECOMMENDED else {})},
                      reason)
        for solver in names for name, (options, reason) in of(solver).items()
    ]  # fmt: skip


def of(name: str) -> dict[str, tuple[dict[str, Any], str]]:
    """Return name of a setting -> (options, reason) of one solver."""
    if name in SETTINGS:
        return SETTINGS[name]
    if not name.startswith(QPSOLVERS):
        return {RECOMMENDED: ({}, "as it comes: the study has no row for it")}
    library = name.removeprefix(QPSOLVERS)
    plain = {**PAPER_FORM, "advised": False}
    table = {DEFAULT: (plain, "the library as qpsolvers calls it, on six rows")}
    tight = TIGHT_OPTIONS.get(library)
    if tight:
        values = ", ".join(f"{key} = {value:g}" for key, value in tight.items())
        table[TIGHT] = ({**plain, "options": tight}, values)
    table[RECOMMENDED] = ({}, "five rows, and the cost scale and tolerances of our adapter's table of advice")
    return table


def effective(setting: SolverSetting) -> dict[str, Any]:
    """Return all options the solver gets: our adapter's defaults with its options over them."""
    found = {**defaults(setting.solver), **setting.options}
    for name in ("kinematics", "period"):
        found.pop(name, None)
    if setting.solver.startswith(QPSOLVERS):
        advice = create(setting.solver, **setting.options).advice  # type: ignore[attr-defined]
        found = {"rows": found["rows"], "cost_scale": advice.cost_scale, **advice.options}
    return found


def in_words(options: Mapping[str, Any]) -> str:
    """Write settings on one line."""
    parts = []
    for name, value in options.items():
        if isinstance(value, Mapping):
            parts += [in_words(value)] if value else []
        else:
            parts.append(f"{name} = {value:g}" if isinstance(value, float) else f"{name} = {value}")
    return ", ".join(parts) or "nothing to set"
