"""From rows to figures of every arm and controller, to the findings that hold on it, and to what is said of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from scipy import stats

from benchmarks.paper_experiment.trials import MATCHED
from benchmarks.paper_experiment.verdict import ABOUT_FRAMES
from benchmarks.robots_study.runs import SETTLED
from moc_opt.study.statistics import mean, relative_changes, spread, too_few

Rows = Sequence[Mapping[str, Any]]
Figures = Mapping[str, Mapping[str, Any]]
"""Of one arm: controller -> figure."""

ERRORS = ("tip_model", "tip_registered", "tip", "rcm_model", "rcm", "rcm_true")
"""Name in the summary of each of `SETTLED`: three frames side by side, of the tip and of the RCM."""
CHANGES = {
    "mu_gain_percent": "mu_mean", "force_change_percent": "trocar_force_mean_N",
    "chatter_change_percent": "torque_rate_rms_Nm_per_s",
    **{f"{key}_change_percent": f"settled_{name}" for key, name in zip(ERRORS, SETTLED, strict=True)},
}  # fmt: skip
MEANS = (
    "mu_mean", "mu_fraction_of_bound", "mu_fraction_of_best_from_start", "mu_fraction_of_best", *SETTLED,
    "trocar_force_mean_N", "torque_rate_rms_Nm_per_s", "infeasible_ticks",
)  # fmt: skip
MUCH_WORSE = 1.1
"""A tip error that is larger than the baseline's by this factor."""
MOST_CHANGE_PERCENT, LEAST_GAIN_PERCENT = 5.0, 10.0
"""Of a settled error, and of mu."""
FINDINGS: Mapping[str, str] = {
    "all_end": "no run stopped or wild",
    "gains": "mean gain in mu of 10 % and more",
    "tip": "tip error in the base frame, once no elbow travels, at most 5 % above DCAC's",
    "tip_registered": "tip error in the frame registered at the start: at most 5 % above",
    "rcm": "RCM error from the registered trocar, once no elbow travels, at most 5 % above DCAC's",
    "rcm_true": "RCM error from the true trocar: at most 5 % above",
    "tails": "tip worse by more than 10 % in at most 10 % of the trials",
    "tip_model": "tip by the arm's own kinematics: at most 5 % above",
    "rcm_model": "RCM by the arm's own kinematics: at most 5 % above",
    "tails_model": "tip by its own kinematics: the same tails",
}
JUDGED = {"gains": "mu_gain_percent", **{key: f"{key}_change_percent" for key in ERRORS}}
"""Finding -> the change that it is about."""


def summarise(rows: Rows) -> dict[str, Any]:
    """Return {"robots": robot -> controller -> figure, "findings": robot -> finding -> holds, "ranking": ...}.

    Means and changes are over the trials that the controller and matched DCAC both ended; those that either broke off
    are counted.
    """
    robots: dict[str, Any] = {}
    no_start: dict[str, int] = {}
    for robot in dict.fromkeys(row["robot"] for row in rows):
        mine = [row for row in rows if row["robot"] == robot]
        no_start[robot] = sum(row["ended"] == "no start" for row in mine)
        names = dict.fromkeys(row["controller"] for row in mine if row["controller"])
        robots[robot] = {name: _figures(mine, name) for name in names}
    findings = {robot: _findings(figures) for robot, figures in robots.items()}
    return {"robots": robots, "no_start": no_start, "findings": findings, "ranking": _ranking(robots)}


def _figures(rows: Rows, controller: str) -> dict[str, Any]:
    base = {row["trial"]: row for row in rows if row["controller"] == MATCHED and row.get("whole")}
    mine = [row for row in rows if row["controller"] == controller]
    pairs = [(row, base[row["trial"]]) for row in mine if row.get("whole") and row["trial"] in base]
    found: dict[str, Any] = {
        "trials": len(mine), "whole": len(pairs), "broken": sum(not row.get("whole") for row in mine),
    }  # fmt: skip
    for name in MEANS:
        if values := [row[name] for row, _ in pairs if name in row]:
            found |= mean(values).entries(name)
    if controller == MATCHED:
        return found
    for change, name in CHANGES.items():
        if both := [(a[name], b[name]) for a, b in pairs if name in a and name in b]:
            found |= relative_changes(*zip(*both, strict=True)).entries(change)
    if methods := dict.fromkeys(row["mu_bound_method"] for row, _ in pairs if "mu_bound_method" in row):
        found["mu_bound_method"] = ", ".join(methods)
    for name in ("tip", "tip_model"):
        key = name.replace("tip", "tip_error") + "_mean_mm"
        found[f"{name}_much_worse"] = sum(a[key] > MUCH_WORSE * b[key] for a, b in pairs if key in a and key in b)
    return found


def judged(figures: Figures) -> Mapping[str, Any]:
    """Return the figures of the solver that the findings on an arm are about: ``exact``, or the first one there is."""
    return figures.get(solver_of(figures), {})


def solver_of(figures: Figures) -> str:
    return "exact" if "exact" in figures else next((name for name in figures if name != MATCHED), "")


def few(figures: Figures) -> str | None:
    """Return the words for too few trials on an arm; None where they are enough."""
    return too_few(judged(figures).get("whole", 0))


def _findings(figures: Figures) -> dict[str, bool | None]:
    """Return finding -> whether it holds; None where nothing or too little was measured, or the two means disagree."""
    row, decided = judged(figures), few(figures) is None
    if "mu_gain_percent" not in row:
        return dict.fromkeys(FINDINGS)

    def below(change: str, limit: float) -> bool | None:
        sides = {row[mean] <= limit for mean in (change, f"{change}_of_ratios") if mean in row}
        return sides.pop() if len(sides) == 1 and decided else None

    gained = below("mu_gain_percent", LEAST_GAIN_PERCENT)
    whole = all(other["broken"] == 0 for other in figures.values())
    tails = {f"tails{of}": row[f"tip{of}_much_worse"] <= 0.1 * row["trials"] for of in ("", "_model")}
    return {
        "all_end": whole if decided or not whole else None,
        "gains": None if gained is None else not gained,
        **{key: below(f"{key}_change_percent", MOST_CHANGE_PERCENT) for key in ERRORS},
        **{key: holds if decided else None for key, holds in tails.items()},
    }


def _ranking(robots: Mapping[str, Figures]) -> dict[str, Any]:
    """Return solvers by mean mu to a thousandth, best first, and rank correlation of arms that tell them apart."""
    scores, between = {}, {}
    for robot, figures in robots.items():
        found = {name: row["mu_mean"] for name, row in figures.items() if name != MATCHED and "mu_mean" in row}
        # What differs by less than a thousandth is alike: answers that are equal to 1e-6 have no rank.
        scores[robot] = {name: round(mu / max(found.values()), 3) for name, mu in found.items()}
    for one, two in combinations(scores, 2):
        shared = [name for name in scores[one] if name in scores[two]]
        if len(shared) > 2 and all(len({by[name] for name in shared}) > 1 for by in (scores[one], scores[two])):
            rho = stats.spearmanr([scores[one][n] for n in shared], [scores[two][n] for n in shared]).statistic
            between[f"{one}, {two}"] = float(rho)
    order = {robot: sorted(by, key=lambda name: -by[name]) for robot, by in scores.items()}
    return {"order": order, "between": between, "mean": float(np.mean(list(between.values()))) if between else None}


def sentences(summary: Mapping[str, Any]) -> list[str]:
    """Say what mu gains on which arm, which findings do not hold where, and whether solvers rank alike."""
    arms, findings = summary["robots"], summary["findings"]
    gained = {arm: text for arm, by in arms.items() if (text := spread(judged(by), "mu_gain_percent")) is not None}
    if not gained:
        return ["No trial was run by a solver and by DCAC."]
    trials = sorted(judged(arms[arm])["trials"] for arm in gained)
    count = " to ".join(dict.fromkeys(str(trials[k]) for k in (0, -1)))
    known = [by for arm, by in findings.items() if few(arms[arm]) is None]
    holds = [text for key, text in FINDINGS.items() if known and all(by[key] for by in known)]
    missed = {arm: sum(verdict is False for verdict in by.values()) for arm, by in findings.items()}
    few_on = "".join(f" {arm}: {words}." for arm, by in arms.items() if (words := few(by)))
    rho = summary["ranking"]["mean"]
    alike = "too few or too equal to rank" if rho is None else f"rank correlation {rho:.2f} on average"
    return [
        f"Gain of mean mu with `{solver_of(arms[next(iter(gained))])}` over DCAC with the same gains [%], {count} "
        f"random poses an arm: {', '.join(f'{arm} {text}' for arm, text in gained.items())}.",
        f"Findings that hold on every arm: {'; '.join(holds) or 'none'}. Of {len(FINDINGS)} each arm misses: "
        f"{', '.join(f'{arm} {count}' for arm, count in missed.items())}.{few_on}",
        f"{ABOUT_FRAMES} The order of the solvers on one arm and on another: {alike}.",
    ]  # fmt: skip
