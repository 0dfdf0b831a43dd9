"""One trial under DCAC and MOC with the same gains in one plant, and what registering again would leave of its errors.

*Registered again*: once MOC's elbow has come to rest, the arm touches the path and the incision anew. The offset
between true and believed tip at that tick then takes the place of the one at the start, and that at the trocar
likewise. It shifts reference and trocar by a constant of less than a millimetre and changes nothing else, so that the
error follows from the same run: no second one is simulated. All figures after the travel are over the ticks from there
to the end, the same for both controllers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.paper_experiment.trials import MATCHED, attempt, variant
from moc_opt.planning.elbow import in_transient
from moc_opt.scenario import Scenario, Setup
from moc_opt.sim.settings import PlantSettings
from moc_opt.study import Failed
from moc_opt.tasks.trocar import shaft_distance
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace

KINDS = {"origins": "mm", "encoders": "mrad", "both": "mm and mrad"}
"""What is off -> unit of its size. Of "both" the origins are off by so many mm and the encoders by so many mrad."""
TILT_RAD_PER_M = PlantSettings().calibration_tilt_rad / PlantSettings().calibration_error_m
ERRORS = (
    "tip_error_model", "tip_error_registered", "tip_error", "rcm_error_model", "rcm_error_registered", "rcm_error",
)  # fmt: skip
METRICS = (
    "mu_mean", "mu_gain_percent", *(f"{name}_mean_mm" for name in ERRORS), "trocar_force_mean_N",
    "torque_rate_rms_Nm_per_s",
)  # fmt: skip
LEAST_S = 0.5
"""Of a run after the elbow's travel; less gives no figure of what comes after."""


@dataclass(frozen=True)
class Job:
    """One trial under DCAC and MOC in one plant; ``about`` tells its rows from others."""

    about: Mapping[str, Any]
    solver: str
    trial: Scenario

    def row(self, controller: str) -> dict[str, Any]:
        """Return what tells a controller's row from others."""
        return {**self.about, "controller": controller, "trial": self.trial.name, "seed": self.trial.seed}


def lost_job(job: Job, failed: Failed) -> list[dict[str, Any]]:
    """Return the rows of a trial that gave no result: every controller's, with the reason."""
    return [job.row(controller) | {"ended": str(failed)} for controller in (MATCHED, job.solver)]


def plant_of(base: PlantSettings, kind: str, size: float) -> PlantSettings:
    """Return the plant with kinematic errors of this size alone; the frames tilt as their origins are off."""
    origins = 1e-3 * size if kind in ("origins", "both") else 0.0
    encoders = 1e-3 * size if kind in ("encoders", "both") else 0.0
    errors = {
        "calibration_error_m": origins, "calibration_tilt_rad": TILT_RAD_PER_M * origins, "encoder_bias_rad": encoders,
    }  # fmt: skip
    return PlantSettings(**base.model_dump() | errors)


def run_job(job: Job) -> list[dict[str, Any]]:
    """Return one row a controller; a run that breaks off is a row with its reason."""
    rows: list[dict[str, Any]] = []
    traces: dict[str, Trace] = {}
    for controller in (MATCHED, job.solver):
        row = job.row(controller)
        trace, row["ended"] = attempt(variant, job.trial, controller)
        if trace is not None:
            found = summarize(trace, traces.get(MATCHED))  # DCAC's own gain over itself is no figure
            row |= {name: found[name] for name in METRICS if name in found}
            traces[controller] = trace
        rows.append(row)
    if job.about["part"] == "calibration" and len(traces) == len(rows):
        moc, setup = traces[job.solver], Setup(job.trial)
        flags = np.flatnonzero(in_transient(setup.robot, moc.t_s, moc.q_rad))
        tick = int(flags[-1]) + 1 if flags.size else 0
        if tick < len(moc) and moc.t_s[-1] - moc.t_s[tick] >= LEAST_S:
            for row in rows:
                row |= {"arrived_s": float(moc.t_s[tick]), **after_travel(traces[row["controller"]], setup, tick)}
    return rows


def after_travel(trace: Trace, setup: Setup, tick: int) -> dict[str, float]:
    """Return the mean errors from a tick on [mm], as registered at the start and as registered again at that tick."""
    # True minus believed place of the tip, and of the shaft at the trocar's depth, which touching would register.
    tips, wrists = setup.robot.tool_along(trace.q_rad + setup.plant.mismatch.encoder_bias)
    told = trace.trocar_registered_m - setup.offset.trocar  # in the controller's own frame
    depth = np.linalg.norm(told - tips, axis=1, keepdims=True)
    believed, true = tips - wrists, trace.tip_m - trace.wrist_m
    believed = tips - depth * believed / np.linalg.norm(believed, axis=1, keepdims=True)
    true = trace.tip_m - depth * true / np.linalg.norm(true, axis=1, keepdims=True)

    rest = slice(tick, None)
    tip = np.linalg.norm(trace.tip_ref_m + (trace.tip_m - tips)[tick] - trace.tip_m, axis=1)
    rcm = shaft_distance(trace.tip_m, trace.wrist_m, told + (true - believed)[tick])
    return {
        "tip_after": 1e3 * float(trace.tip_error_registered_m[rest].mean()), "tip_again": 1e3 * float(tip[rest].mean()),
        "rcm_after": 1e3 * float(trace.rcm_error_registered_m[rest].mean()), "rcm_again": 1e3 * float(rcm[rest].mean()),
    }  # fmt: skip
