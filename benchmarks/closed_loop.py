"""The same trials under every controller: what a solver's answers do to the robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.timing import percentiles
from moc_opt import scenario
from moc_opt.errors import MocOptError
from moc_opt.metrics import summarize
from moc_opt.scenario import Scenario
from moc_opt.trace import Trace

BASELINE = "dcac"  # tip and RCM alone, with the gains of the others


@dataclass(frozen=True)
class Run:
    """One controller on one trial; ``trace`` is None where the run broke off, ``error`` says why."""

    controller: str
    trial: str
    trace: Trace | None
    metrics: Mapping[str, float]
    error: str | None = None

    def row(self) -> dict[str, Any]:
        """One row of rows.parquet."""
        return {
            "part": "closed_loop",
            "solver": self.controller,
            "trial": self.trial,
            "error": self.error,
            **self.metrics,
        }


def trials(base: Scenario, tasks: list[str], seeds: list[int]) -> dict[str, Scenario]:
    """One scenario per task and seed; the seed draws the starting swivel, the mismatch and the noise."""
    return {
        f"{task}/{seed}": base.change(
            name=f"{task}/{seed}", seed=seed, task={"path": task}, start={"swivel": "random"}
        )
        for task in tasks
        for seed in seeds
    }


def variant(trial: Scenario, controller: str, settings: Mapping[str, Any] | None = None) -> Scenario:
    """The trial under DCAC (with MOC's gains) or under MOC with the named solver."""
    if controller == BASELINE:
        return trial.change(control={"law": "dcac", "gains": trial.control.gains or "moc"})
    return trial.change(solver={"name": controller, "settings": dict(settings or {})})


def run_one(
    trial: Scenario, controller: str, settings: Mapping[str, Any] | None, baseline: Trace | None
) -> Run:
    """Run and summarise; a run that breaks off is a result, with its reason."""
    try:
        trace = scenario.run(variant(trial, controller, settings))
    except MocOptError as error:
        return Run(controller, trial.name, None, {}, f"{type(error).__name__}: {error}")
    return Run(controller, trial.name, trace, summarize(trace, baseline))


def run_all(
    cases: Mapping[str, Scenario],
    controllers: Mapping[str, Mapping[str, Any]],
    advance: Callable[[str], None],
) -> list[Run]:
    """Every controller on every trial, trial by trial, the baseline first."""
    runs = []
    for trial in cases.values():
        baseline = run_one(trial, BASELINE, None, None)
        advance(f"{trial.name} {BASELINE}")
        runs.append(baseline)
        for name, settings in controllers.items():
            runs.append(run_one(trial, name, settings, baseline.trace))
            advance(f"{trial.name} {name}")
    return runs


def summary(runs: list[Run]) -> dict[str, dict[str, Any]]:
    """Controller -> metric over its trials: means of means, largest of maxima, sums of counts, pooled times."""
    found: dict[str, dict[str, Any]] = {}
    for name in dict.fromkeys(run.controller for run in runs):
        mine = [run for run in runs if run.controller == name]
        whole = [run for run in mine if run.trace is not None]
        values: dict[str, Any] = {"runs": len(mine), "broke_off": len(mine) - len(whole)}
        for metric in dict.fromkeys(metric for run in whole for metric in run.metrics):
            data = [run.metrics[metric] for run in whole if metric in run.metrics]
            if metric.endswith(("_p50_us", "_p99_us")):
                continue
            total = np.max if "_max" in metric else np.mean if metric.startswith(AVERAGED) else np.sum
            values[metric] = float(total(data))
        for column, prefix in (("solve_us", "solve"), ("tick_us", "tick")):
            pooled = np.concatenate([np.empty(0), *(run.trace.columns[column] for run in whole if run.trace)])
            values |= percentiles(pooled, prefix)
        found[name] = values
    return found


AVERAGED = ("mu_", "tip_error_", "rcm_error_", "trocar_force_", "torque_rate_")
