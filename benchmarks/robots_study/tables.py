"""Summary and tables of the arms, all from the rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from scipy import stats

from benchmarks.paper_experiment.trials import MATCHED
from moc_opt.comparison.statistics import mean, relative_change
from moc_opt.report.tables import Column, Table

Rows = Sequence[Mapping[str, Any]]

CHANGES = (
    ("mu_mean", "mu_gain_percent"), ("settled_tip_error_mean_mm", "tip_change_percent"),
    ("settled_rcm_error_registered_mean_mm", "rcm_change_percent"),
    ("settled_tip_error_model_mean_mm", "tip_model_change_percent"),
    ("settled_rcm_error_model_mean_mm", "rcm_model_change_percent"), ("trocar_force_mean_N", "force_change_percent"),
    ("torque_rate_rms_Nm_per_s", "chatter_change_percent"),
)  # fmt: skip
MEANS = (
    "mu_mean", "mu_fraction_of_bound", "mu_fraction_of_best_from_start", "mu_fraction_of_best", "tip_error_mean_mm",
    "tip_error_model_mean_mm", "rcm_error_mean_mm",
    "rcm_error_registered_mean_mm", "rcm_error_model_mean_mm", "trocar_force_mean_N", "torque_rate_rms_Nm_per_s",
    "infeasible_ticks", "solve_p50_us",
)  # fmt: skip
MUCH_WORSE = 1.1
"""A tip error that is larger than the baseline's by this factor."""
MOST_CHANGE_PERCENT, LEAST_GAIN_PERCENT = 5.0, 10.0
"""Of a settled error, and of mu."""
FINDINGS: Mapping[str, str] = {
    "all_end": "no run stopped or wild",
    "gains": "mean gain in mu of 10 % and more",
    "tip": "tip error, once no elbow travels, at most 5 % above DCAC's",
    "rcm": "RCM error from the registered trocar, once no elbow travels, at most 5 % above DCAC's",
    "tails": "tip worse by more than 10 % in at most 10 % of the trials",
    "tip_model": "tip by the arm's own kinematics: at most 5 % above",
    "rcm_model": "RCM by the arm's own kinematics: at most 5 % above",
    "tails_model": "tip by its own kinematics: the same tails",
}
BY_ARM = [
    Column("robot", "arm"), Column("controller", "controller"), Column("trials", "trials", format="d"),
    Column("broken", "broke off", format="d"), Column("mu_gain_percent", "gain in mu", unit="%", format="+.1f"),
    Column("mu_fraction_of_bound", "of bound", format=".3f"),
    Column("mu_bound_method", "best of"),
    Column("mu_fraction_of_best_from_start", "of best from start", format=".3f", help="of the best course from there"),
    Column("mu_fraction_of_best", "of best", format=".3f", help="of the best course from any swivel and branch"),
    Column("tip_change_percent", "tip, settled", unit="%", format="+.1f"),
    Column("rcm_change_percent", "RCM, settled", unit="%", format="+.1f"),
    Column("tip_much_worse", "tip > 10 % worse", format="d"),
    Column("tip_model_change_percent", "tip, own", unit="%", format="+.1f"),
    Column("rcm_model_change_percent", "RCM, own", unit="%", format="+.1f"),
    Column("tip_model_much_worse", "tip, own > 10 % worse", format="d"),
    Column("tip_error_mean_mm", "tip", unit="mm", format=".3f"),
    Column("rcm_error_registered_mean_mm", "RCM, registered", unit="mm", format=".3f"),
    Column("trocar_force_mean_N", "force", unit="N", format=".2f"),
    Column("infeasible_ticks", "infeasible ticks", format=".0f"),
]  # fmt: skip


def summarise(rows: Rows) -> dict[str, Any]:
    """Return {"robots": robot -> controller -> figure, "findings": robot -> finding -> holds, "ranking": ...}.

    Means and changes are over the trials that the controller and matched DCAC both ended; those that either broke off
    are counted.
    """
    robots = list(dict.fromkeys(row["robot"] for row in rows))
    found: dict[str, Any] = {"robots": {}, "no_start": {}}
    for robot in robots:
        mine = [row for row in rows if row["robot"] == robot]
        found["no_start"][robot] = sum(row["ended"] == "no start" for row in mine)
        names = [name for name in dict.fromkeys(row["controller"] for row in mine) if name]
        found["robots"][robot] = {name: _figures(mine, name) for name in names}
    found["findings"] = {robot: _findings(figures) for robot, figures in found["robots"].items()}
    found["ranking"] = _ranking(found["robots"])
    return found


def _figures(rows: Rows, controller: str) -> dict[str, Any]:
    base = {row["trial"]: row for row in rows if row["controller"] == MATCHED and row.get("whole")}
    mine = [row for row in rows if row["controller"] == controller]
    pairs = [(row, base[row["trial"]]) for row in mine if row.get("whole") and row["trial"] in base]
    found: dict[str, Any] = {"trials": len(mine), "broken": sum(not row.get("whole") for row in mine)}
    for name in MEANS:
        values = [row[name] for row, _ in pairs if name in row]
        if values:
            found |= mean(values).entries(name)
    if controller == MATCHED:
        return found
    for name, change in CHANGES:
        both = [(a[name], b[name]) for a, b in pairs if name in a and name in b]
        if both:
            found |= relative_change(*zip(*both, strict=True)).entries(change)
    methods = dict.fromkeys(row["mu_bound_method"] for row, _ in pairs if "mu_bound_method" in row)
    if methods:
        found["mu_bound_method"] = ", ".join(methods)
    for name in ("tip", "tip_model"):
        key = name.replace("tip", "tip_error") + "_mean_mm"
        both = [(a[key], b[key]) for a, b in pairs if key in a and key in b]
        found[f"{name}_much_worse"] = sum(a > MUCH_WORSE * b for a, b in both)
    return found


def of(figures: Mapping[str, Any]) -> str | None:
    """Return the solver that the findings on an arm are about: ``exact``, or the first one there is."""
    return "exact" if "exact" in figures else next((name for name in figures if name != MATCHED), None)


def _findings(figures: Mapping[str, Mapping[str, Any]]) -> dict[str, bool | None]:
    """Return finding -> whether it holds; None where nothing was measured."""
    name = of(figures)
    if name is None or "mu_gain_percent" not in figures[name]:
        return dict.fromkeys(FINDINGS)
    row = figures[name]

    def small(change: str) -> bool | None:
        value = row.get(change)
        return None if value is None else value <= MOST_CHANGE_PERCENT

    return {
        "all_end": all(other["broken"] == 0 for other in figures.values()),
        "gains": row["mu_gain_percent"] >= LEAST_GAIN_PERCENT,
        **{key: small(f"{key}_change_percent") for key in ("tip", "rcm", "tip_model", "rcm_model")},
        **{f"tails{of}": row[f"tip{of}_much_worse"] <= 0.1 * row["trials"] for of in ("", "_model")},
    }


def _ranking(robots: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> dict[str, Any]:
    """Return solvers by mean mu to a thousandth, best first, and rank correlation of arms that tell them apart."""
    scores = {
        robot: {name: row["mu_mean"] for name, row in figures.items() if name != MATCHED and "mu_mean" in row}
        for robot, figures in robots.items()
    }
    # What differs by less than a thousandth is alike: answers that are equal to 1e-6 have no rank.
    scores = {robot: {name: round(mu / max(by.values()), 3) for name, mu in by.items()} for robot, by in scores.items()}
    order = {robot: sorted(by, key=lambda name: -by[name]) for robot, by in scores.items()}
    between = {}
    for one, two in combinations(scores, 2):
        shared = [name for name in scores[one] if name in scores[two]]
        if len(shared) > 2 and all(len({by[name] for name in shared}) > 1 for by in (scores[one], scores[two])):
            rho = stats.spearmanr([scores[one][n] for n in shared], [scores[two][n] for n in shared]).statistic
            between[f"{one}, {two}"] = float(rho)
    values = [rho for rho in between.values() if np.isfinite(rho)]
    return {"order": order, "between": between, "mean": float(np.mean(values)) if values else None}


def tables(summary: Mapping[str, Any]) -> list[Table]:
    """Show every arm and controller, and which findings hold where."""
    rows = [{"robot": r, "controller": c, **row} for r, by in summary["robots"].items() for c, row in by.items()]
    word = {True: "yes", False: "no", None: "-"}
    holds = [
        {"finding": text, **{robot: word[by[key]] for robot, by in summary["findings"].items()}}
        for key, text in FINDINGS.items()
    ]
    order = [{"robot": r, "order": ", ".join(names)} for r, names in summary["ranking"]["order"].items()]
    rho = summary["ranking"]["mean"]
    told = "" if rho is None else f"Mean rank correlation between arms: {rho:.2f}."
    columns = [Column("finding", "finding"), *(Column(robot, robot) for robot in summary["findings"])]
    return [
        Table("Arms and controllers, changes against DCAC with the same gains", BY_ARM, rows),
        Table("Which findings hold on which arm", columns, holds),
        Table("Solvers by mean mu, best first", [Column("robot", "arm"), Column("order", "order")], order, told),
    ]  # fmt: skip
