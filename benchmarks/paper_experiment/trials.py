"""The trials of the paper's experiment: every controller on the same start, plant and noise, measured phase by phase.

A trial is a task (circle, sinusoid, spiral), a starting swivel drawn from the feasible self-motion, a plant with its
own mismatch, and its noise, all from one seed. Every controller runs it. The phases:

- ``whole``: every tick, the rest before and after the path included;
- ``path``: from the moment the path begins;
- ``travelling`` and ``settled``: the ticks at which the elbow of at least one controller with a third level is on its
  way to its optimum, and the rest. The ticks are the same for all controllers of a trial; DCAC, which leads its elbow
  nowhere, has no say in them, and neither has a run that broke off.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt import scenario
from moc_opt.control.gains import GAINS
from moc_opt.errors import MocOptError
from moc_opt.redundancy.transient import in_transient
from moc_opt.robots import load_data
from moc_opt.scenario import Scenario
from moc_opt.trace.ending import Ending
from moc_opt.trace.metrics import PHASES, summarize
from moc_opt.trace.trace import Trace
from moc_opt.vision.board import board_task

Floats = NDArray[np.float32]

OWN, MATCHED, DAMPED = "dcac-own", "dcac", "dcac-damped"
BASELINES = {
    OWN: "DCAC with its own gains",
    MATCHED: "DCAC with MOC's gains",
    DAMPED: "DCAC with MOC's gains, self-motion damped",
}
SAMPLED = ("mu", "tip_error_model_m", "rcm_error_m", "trocar_force_N")
CLOCKS = ("solve_", "tick_", "deadline_")
POSES = ("q_rad", "tip_m", "tip_ref_m", "trocar_m", "trocar_registered_m")
EVERY = 10


@dataclass(frozen=True)
class Measurement:
    """The metrics of one controller on one trial in one phase."""

    group: str
    controller: str
    task: str
    trial: str
    seed: int
    phase: str
    metrics: Mapping[str, float]
    ended: str = "completed"
    """the trace's ``meta["ended"]``: no run that was stopped is measured"""

    def row(self) -> dict[str, Any]:
        """Return one row of rows.parquet."""
        names = ("ended", "group", "controller", "task", "trial", "seed", "phase")
        return {"part": "trials", **{name: getattr(self, name) for name in names}, **self.metrics}


@dataclass(frozen=True)
class Outcome:
    """The result of one job, small enough to pass between processes."""

    measurements: list[Measurement]
    samples: dict[tuple[str, str], dict[str, Floats]]
    """(controller, task) -> column -> every EVERY-th tick"""
    traces: dict[str, Trace] = field(default_factory=dict)
    """controller -> thinned trace, where asked for"""
    broken: list[dict[str, Any]] = field(default_factory=list)
    """group, controller, trial, error of runs that broke off"""


@dataclass(frozen=True)
class Job:
    """One trial under every controller."""

    group: str
    task: str
    trial: Scenario
    controllers: tuple[str, ...]
    solver_settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    keep_traces: bool = False


def seeds(seed: int, stream: int, count: int) -> list[int]:
    """Draw the seeds of ``count`` trials; different streams (experiment, search, verification) share none."""
    state = np.random.SeedSequence([seed, stream]).generate_state(count, np.uint32)
    return [int(entry) for entry in state]


def trials(base: Scenario, tasks: Sequence[str], seeds_of_trials: Sequence[int]) -> list[tuple[str, Scenario]]:
    """Return (task, scenario) for each task and its share of the seeds, in order.

    The sizes and the depth below the trocar are those of the virtual task of that name.
    """
    per_task = len(seeds_of_trials) // len(tasks)
    found = []
    for i, name in enumerate(tasks):
        virtual = board_task(name)
        for k, seed in enumerate(seeds_of_trials[i * per_task : (i + 1) * per_task]):
            scene = base.change(
                name=f"{name}/{k}", seed=seed, task={"path": virtual.kind, "sizes": dict(virtual.sizes)},
                trocar={"depth_m": virtual.depth_m}, start={"swivel": "random"},
            )  # fmt: skip
            found.append((name, scene))
    return found


def variant(trial: Scenario, controller: str, settings: Mapping[str, Any] | None = None) -> Scenario:
    """Put a trial under a baseline, or under MOC with the solver of that name; compensation is the trial's for all."""
    control = trial.control
    if controller not in BASELINES:
        return trial.change(solver={"name": controller, "settings": dict(settings or {})})
    if controller == OWN:
        return trial.change(control={"law": "dcac", "gains": "dcac", **dict.fromkeys(GAINS)})
    table = control.matched_dcac()
    if controller == DAMPED:
        # As much damping as MOC's third level gives where its desired is rest.
        data = load_data(trial.robot.name)
        moc = control.resolve_gains(data.gains, data.n)
        table = {**table, "dcac_damping": (moc.K_N2 + moc.D_N2).tolist()}
    return trial.change(control=table)


def attempt(make: Callable[..., Scenario], *arguments: Any) -> tuple[Trace | None, str]:
    """Run ``make(*arguments)``: its trace, None where it broke off or was stopped; and how it ended, or the error."""
    try:
        trace = scenario.run(make(*arguments))
    except MocOptError as error:
        return None, f"{type(error).__name__}: {error}"
    ended = str(trace.meta["ended"])
    return (trace if Ending.of(ended).whole else None), ended


def run_job(job: Job) -> Outcome:
    """Run every controller of a job; a run that breaks off is a result, with its reason."""
    outcome = Outcome([], {}, {}, [])
    traces: dict[str, Trace] = {}
    for controller in job.controllers:
        trace, ended = attempt(variant, job.trial, controller, job.solver_settings.get(controller))
        if trace is not None:
            traces[controller] = trace
            continue
        stopped = Ending.of(ended) is Ending.STOPPED
        outcome.broken.append(
            {
                "part": "broke off", "ended": ended if stopped else Ending.FAILED.value, "group": job.group,
                "controller": controller, "task": job.task, "trial": job.trial.name, "seed": job.trial.seed,
                "error": f"PlantError: {ended}" if stopped else ended,
            }
        )  # fmt: skip
    baselines = {name: trace for name, trace in traces.items() if name in BASELINES}
    for controller, trace in traces.items():
        reference = baselines.get(MATCHED)
        on_path = trace.t_s >= job.trial.task.wait_s
        ended = str(trace.meta["ended"])
        _note(outcome, job, controller, "whole", summarize(trace, reference), ended)
        if on_path.any():
            cut = None if reference is None else reference.select(on_path)
            _note(outcome, job, controller, "path", summarize(trace.select(on_path), cut), ended)
        outcome.samples[controller, job.task] = _thin(trace)
        if job.keep_traces:
            outcome.traces[controller] = _slim(trace)
    _measure_phases(outcome, job, traces)
    return outcome


def any_transient(trial: Scenario, traces: Mapping[str, Trace], **sampling: float) -> NDArray[np.bool_] | None:
    """Return (N,) ticks at which the elbow of at least one MOC is on its way; None where no MOC came to its end.

    Args:
        trial: the scenario that all ran.
        traces: controller -> trace, of as many ticks each; the baselines are not asked.
        sampling: of `moc_opt.redundancy.transient.in_transient`.
    """
    robot = trial.robot.arm()
    flags = [
        in_transient(robot, trace.t_s, trace.q_rad, **sampling)
        for controller, trace in traces.items()
        if controller not in BASELINES
    ]
    return np.any(flags, axis=0) if flags else None


def _measure_phases(outcome: Outcome, job: Job, traces: Mapping[str, Trace]) -> None:
    """Measure every controller at the same ticks: see the head of the module."""
    flags = any_transient(job.trial, traces)
    if flags is None:
        return
    marked = {name: trace.with_columns(travelling=flags) for name, trace in traces.items()}
    for name, trace in marked.items():
        for phase in PHASES:
            metrics = summarize(trace, marked.get(MATCHED), phase=phase)  # type: ignore[arg-type]
            if metrics:
                ticks = int(np.count_nonzero(flags == (phase == "travelling")))
                extent = {"ticks": float(ticks), "share_of_ticks": ticks / len(flags)}
                _note(outcome, job, name, phase, {**metrics, **extent}, str(trace.meta["ended"]))


def _note(outcome: Outcome, job: Job, controller: str, phase: str, metrics: Mapping[str, float], ended: str) -> None:
    # Clocks are left out: jobs share the machine, and a time taken then is no solver's fault.
    kept = {name: value for name, value in metrics.items() if not name.startswith(CLOCKS)}
    outcome.measurements.append(
        Measurement(
            job.group, controller, job.task, job.trial.name, job.trial.seed, phase=phase, metrics=kept, ended=ended
        )
    )


def _thin(trace: Trace) -> dict[str, Floats]:
    found = {}
    for name in SAMPLED:
        column = trace.columns[name][::EVERY]
        found[name] = np.asarray(column if column.ndim == 1 else np.linalg.norm(column, axis=1), dtype=np.float32)
    return found


def _slim(trace: Trace) -> Trace:
    kept = {name: trace.columns[name][::EVERY] for name in ("t_s", *SAMPLED, *POSES)}
    return Trace(kept, {"ended": trace.meta.get("ended", "completed")})
