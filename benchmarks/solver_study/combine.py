"""The runs of a closed loop put together: one row of figures for each controller."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.solver_study.closed_loop import Run
from benchmarks.solver_study.compare import COSTS
from moc_opt.study.statistics import StatisticsError, relative_changes
from moc_opt.study.timing import Disturbance, percentiles
from moc_opt.study.trials import BASELINE
from moc_opt.trace.meta import Ending

COMPARED = {
    "mu_mean": "mu_gain_percent", "tip_error_model_mean_mm": "tip_change_percent",
    "tip_error_registered_mean_mm": "tip_patient_change_percent", "rcm_error_model_mean_mm": "rcm_change_percent",
    "rcm_error_registered_mean_mm": "rcm_patient_change_percent",
}  # fmt: skip
"""Metric -> its change against the baseline: mu; tip and RCM by the robot's own kinematics, and in the patient's frame,
the one registered at the start."""
CLOCKS = ("deadline_misses",)  # counts that the clock decides
AVERAGED = ("mu_", "tip_error_", "rcm_error_", "trocar_force_", "torque_rate_", "oscillation_", "share_of_run")


def summary(runs: Sequence[Run]) -> dict[str, dict[str, Any]]:
    """Sum up controller -> metric over its trials, and its change against the baseline; see ``combined``."""
    by_name: dict[str, list[Run]] = {}
    for run in runs:
        by_name.setdefault(run.controller, []).append(run)
    return {name: combined(mine) | changes(mine, by_name.get(BASELINE, [])) for name, mine in by_name.items()}


def changes(runs: Sequence[Run], baseline: Sequence[Run]) -> dict[str, float]:
    """Compute the changes against the baseline [percent] on the trials that both finished, with their intervals."""
    short = any(run.short for run in runs)
    theirs = {run.trial: (run.beginning if short else run).metrics for run in baseline if run.columns}
    found: dict[str, float] = {"compared_trials": 0}
    for metric, name in COMPARED.items():
        pairs = [
            (run.metrics[metric], theirs[run.trial][metric])
            for run in runs
            if run.columns and metric in run.metrics and metric in theirs.get(run.trial, {})
        ]
        try:
            found |= relative_changes([mine for mine, _ in pairs], [base for _, base in pairs]).entries(name)
        except StatisticsError:
            continue  # no trial that both finished: there is no change
        found["compared_trials"] = len(pairs)
    return found


def by_trial(runs: Sequence[Run]) -> dict[str, dict[str, dict[str, float]]]:
    """Return controller -> metric -> trial -> value, of what solvers are compared by on the trials that both ran."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for run in runs:
        mine = found.setdefault(run.controller, {})
        for metric in COSTS:
            if run.columns and metric in run.metrics:
                mine.setdefault(metric, {})[run.trial] = run.metrics[metric]
    return found


def combined(runs: Sequence[Run]) -> dict[str, Any]:
    """Combine the runs of one controller: means of means, largest of maxima, sums of counts, pooled times.

    Runs that broke off enter none of these; ``runs``, ``broke_off``, ``stopped`` and ``oscillated`` count them.
    Means in the steady state are weighted by their number of ticks. Times, and what the clock decides, are those of
    the timed runs alone.
    """
    whole = [run for run in runs if run.columns]
    values: dict[str, Any] = {
        "runs": len(runs), "broke_off": len(runs) - len(whole), "timed_runs": sum(run.timed for run in whole),
        "short_runs": sum(run.short for run in runs),
    }  # fmt: skip
    values |= {
        ending.value: sum(Ending.of(run.ended) is ending for run in runs)
        for ending in (Ending.STOPPED, Ending.OSCILLATED)
    }
    for metric in dict.fromkeys(metric for run in whole for metric in run.metrics):
        used = [run for run in whole if metric in run.metrics and (run.timed or metric not in CLOCKS)]
        if metric.endswith(("_p50_us", "_p99_us")) or metric in COMPARED.values() or not used:
            continue
        data = [run.metrics[metric] for run in used]
        if "_settled_" in metric:
            values[metric] = float(np.average(data, weights=[run.metrics["settled_ticks"] for run in used]))
            continue
        averaged = metric.startswith(AVERAGED) or metric.endswith("_percent")
        total = np.max if "_max" in metric else np.mean if averaged else np.sum
        values[metric] = float(total(data))
    seen = sum((run.load for run in whole if run.timed), Disturbance())
    values |= seen.entries() if seen.calls else {}
    for metric in CLOCKS:
        if values.get(metric):
            values[metric] = seen.judged(values[metric], 99.9)
    for column, prefix in (("solve_us", "solve"), ("tick_us", "tick")):
        timed = [run.columns[column] for run in whole if run.timed and column in run.columns]
        values |= percentiles(np.concatenate([np.empty(0), *timed]), prefix, seen)
    errors = [run.error for run in runs if run.error]
    raised = [run.raised for run in runs if run.raised]
    values |= {"trouble": raised[0]} if raised else {}
    return {**values, "reason": errors[0]} if errors else values
