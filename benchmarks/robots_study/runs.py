"""One trial of one arm under every controller; each run is a row, one that broke off too."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.paper_experiment.trials import BASELINES, MATCHED, any_transient, variant
from moc_opt import scenario
from moc_opt.errors import MocOptError
from moc_opt.scenario import RunAway, Scenario
from moc_opt.study import Failed
from moc_opt.study.trials import placed
from moc_opt.trace.meta import Ending
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace

SETTLED = (
    "tip_error_model_mean_mm", "tip_error_registered_mean_mm", "tip_error_mean_mm",
    "rcm_error_model_mean_mm", "rcm_error_registered_mean_mm", "rcm_error_mean_mm",
)  # fmt: skip
"""Of tip and RCM, each by the arm's own kinematics, from what was registered at the start, and in the base frame."""
METRICS = (
    "mu_mean", "mu_fraction_of_bound", "mu_fraction_of_best_from_start", "mu_fraction_of_best", *SETTLED,
    "trocar_force_mean_N", "torque_rate_rms_Nm_per_s", "verified_solved", "claimed_solved",
)  # fmt: skip


@dataclass(frozen=True)
class Job:
    """One trial and who runs it."""

    task: str
    trial: Scenario
    solvers: tuple[str, ...]

    def row(self) -> dict[str, Any]:
        """Return what tells its rows from others."""
        return {"robot": self.trial.robot.name, "task": self.task, "trial": self.trial.name, "seed": self.trial.seed}


def lost_job(job: Job, failed: Failed) -> list[dict[str, Any]]:
    """Return the row of a trial that gave no result."""
    return [job.row() | {"controller": "", "ended": "failed", "error": str(failed)}]


def run_job(job: Job) -> list[dict[str, Any]]:
    """Return rows of all controllers, `MATCHED` DCAC first; of a start that is not found, one row with the error."""
    about = job.row()
    try:
        trial = placed(job.trial).change(best_courses=True)
    except MocOptError as error:
        return [about | {"controller": "", "ended": "no start", "error": str(error)}]
    rows: list[dict[str, Any]] = []
    traces: dict[str, Trace] = {}
    for controller in (MATCHED, *job.solvers):
        row: dict[str, Any] = about | {"controller": controller, "error": ""}
        try:
            trace = scenario.run(variant(trial, controller))
            row["ended"] = str(trace.meta["ended"])
        except RunAway as error:
            trace, row["ended"], row["error"] = error.trace, str(error.trace.meta["ended"]), str(error)
        except MocOptError as error:
            rows.append(row | {"ended": "failed", "error": str(error)})
            continue
        row["whole"] = Ending.of(row["ended"]).whole
        if row["whole"]:
            traces[controller] = trace
            found = summarize(trace)
            if "mu_bound_method" in trace.meta:
                row["mu_bound_method"] = str(trace.meta["mu_bound_method"])
            row |= {name: found[name] for name in METRICS if name in found}
            row["no_best_course"] = trace.meta["best_courses"]["absent"]
            if "status" in trace.columns and controller not in BASELINES:
                row["infeasible_ticks"] = int(np.count_nonzero(trace.columns["status"] == "infeasible"))
        rows.append(row)
    moving = any_transient(trial, traces)  # settled: no controller's elbow is on its way any more
    for row in rows:
        if moving is not None and row["controller"] in traces:
            found = summarize(traces[row["controller"]].with_columns(travelling=moving), phase="settled")
            row |= {f"settled_{name}": found[name] for name in SETTLED if name in found}
    return rows
