"""Trials: a task, a starting swivel, a plant with its own mismatch and its noise, all from one seed.

Every controller runs the same trial and is measured in phases: ``whole`` is every tick; ``travelling`` are the ticks at
which the elbow of at least one controller with a third level is on its way to its optimum, and ``settled`` the rest.
They are the same ticks for all controllers of a trial; DCAC, which leads its elbow nowhere, has no say in them, and
neither has a run that broke off.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from moc_opt import scenario
from moc_opt.control.gains import GAINS
from moc_opt.errors import MocOptError
from moc_opt.planning.elbow import in_transient
from moc_opt.planning.self_motion import self_motion
from moc_opt.robots import load_data
from moc_opt.scenario import Scenario
from moc_opt.study import Failed
from moc_opt.trace.meta import Ending
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace
from moc_opt.vision.board import board_task

STREAM = 0
"""Of the seeds of this experiment; other studies have others."""
OWN, MATCHED, DAMPED = "dcac-own", "dcac", "dcac-damped"
BASELINES = {
    OWN: "DCAC with its own gains",
    MATCHED: "DCAC with MOC's gains",
    DAMPED: "DCAC with MOC's gains, self-motion damped",
}
SAMPLED = ("mu", "tip_error_model_m", "rcm_error_m", "trocar_force_N")
POSES = ("q_rad", "tip_m", "tip_ref_m", "trocar_m", "trocar_registered_m")
EVERY = 10
"""Of the ticks, one in so many is kept for figures."""
CLOCKS = ("solve_", "tick_", "deadline_")
Phase = Literal["travelling", "settled"]


@dataclass(frozen=True)
class Measurement:
    """The metrics of one controller on one trial in one phase; no run that was stopped is measured."""

    group: str
    controller: str
    task: str
    trial: str
    seed: int
    phase: str
    metrics: Mapping[str, float]
    ended: str = "completed"

    def row(self, part: str) -> dict[str, Any]:
        """Return one row of rows.parquet."""
        names = ("ended", "group", "controller", "task", "trial", "seed", "phase")
        return {"part": part, **{name: getattr(self, name) for name in names}, **self.metrics}


@dataclass(frozen=True)
class Outcome:
    """The result of one job: (controller, task) -> column -> thinned samples; controller -> thinned trace."""

    measurements: list[Measurement] = field(default_factory=list)
    samples: dict[tuple[str, str], dict[str, NDArray[np.float32]]] = field(default_factory=dict)
    traces: dict[str, Trace] = field(default_factory=dict)
    broken: list[dict[str, Any]] = field(default_factory=list)
    """Rows of the runs that broke off, with their ``error``."""


@dataclass(frozen=True)
class Job:
    """One trial under every controller; ``brief`` measures the whole run only and keeps nothing for figures."""

    group: str
    task: str
    trial: Scenario
    controllers: tuple[str, ...]
    keep_traces: bool = False
    brief: bool = False

    def broken(self, controller: str, ended: str) -> dict[str, Any]:
        """Return the row of a run that broke off, from its ending or error."""
        stopped = Ending.of(ended) is Ending.STOPPED
        return {
            "part": "broke off", "ended": ended if stopped else Ending.FAILED.value, "group": self.group,
            "controller": controller, "task": self.task, "trial": self.trial.name, "seed": self.trial.seed,
            "error": ended,
        }  # fmt: skip

    def measured(self, controller: str, phase: str, trace: Trace, metrics: Mapping[str, float]) -> Measurement:
        """Return the metrics but for clocks: jobs share the machine, and a time taken then is no solver's fault."""
        kept = {name: value for name, value in metrics.items() if not name.startswith(CLOCKS)}
        about = (self.group, controller, self.task, self.trial.name, self.trial.seed)
        return Measurement(*about, phase, kept, str(trace.meta["ended"]))


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


def title(controller: str) -> str:
    """Return the name of a controller in tables and figures."""
    return BASELINES.get(controller, f"MOC, {controller}")


def variant(trial: Scenario, controller: str) -> Scenario:
    """Put a trial under a baseline, or under MOC with the solver of that name; compensation is the trial's for all."""
    control = trial.control
    if controller not in BASELINES:
        return trial.change(solver={"name": controller, "settings": {}})
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
    outcome, traces = Outcome(), dict[str, Trace]()
    for controller in job.controllers:
        trace, ended = attempt(variant, job.trial, controller)
        if trace is None:
            outcome.broken.append(job.broken(controller, ended))
        else:
            traces[controller] = trace
    for controller, trace in traces.items():
        metrics = summarize(trace, traces.get(MATCHED))
        outcome.measurements.append(job.measured(controller, "whole", trace, metrics))
        if not job.brief:
            thin = {name: trace.columns[name][::EVERY] for name in ("t_s", *SAMPLED, *POSES)}
            outcome.samples[controller, job.task] = {
                name: np.asarray(
                    thin[name] if thin[name].ndim == 1 else np.linalg.norm(thin[name], axis=1), dtype=np.float32
                )
                for name in SAMPLED
            }
            if job.keep_traces:
                outcome.traces[controller] = Trace(thin, {"ended": trace.meta["ended"]})
    if not job.brief and (flags := any_transient(job.trial, traces)) is not None:
        outcome.measurements.extend(_in_phases(job, traces, flags))
    return outcome


def lost_job(job: Job, failed: Failed) -> Outcome:
    """Return a trial that gave no result: every controller broke off, for this reason."""
    return Outcome(broken=[job.broken(controller, str(failed)) for controller in job.controllers])


def any_transient(trial: Scenario, traces: Mapping[str, Trace]) -> NDArray[np.bool_] | None:
    """Return (N,) ticks at which the elbow of at least one MOC is on its way; None where no MOC came to its end.

    Args:
        trial: the scenario that all ran.
        traces: controller -> trace, of as many ticks each; the baselines are not asked.
    """
    robot = trial.robot.arm()
    asked = [trace for controller, trace in traces.items() if controller not in BASELINES]
    flags = [in_transient(robot, trace.t_s, trace.q_rad) for trace in asked]
    return np.any(flags, axis=0) if flags else None


def _in_phases(job: Job, traces: Mapping[str, Trace], flags: NDArray[np.bool_]) -> list[Measurement]:
    marked = {name: trace.with_columns(travelling=flags) for name, trace in traces.items()}
    phases: tuple[Phase, ...] = get_args(Phase)
    found = []
    for name, trace in marked.items():
        for phase in phases:
            metrics = summarize(trace, marked.get(MATCHED), phase=phase)
            if metrics:
                ticks = int(np.count_nonzero(flags == (phase == "travelling")))
                extent = {"ticks": float(ticks), "share_of_ticks": ticks / len(flags)}
                found.append(job.measured(name, phase, trace, {**metrics, **extent}))
    return found


# The starting swivel: the same trial from every place of the feasible self-motion. A start at the swivel of the largest
# mu gains next to nothing, so the mean gain of an experiment says as much about the draw of its starts as about MOC.


def swivel_jobs(trial: Scenario, task: str, count: int, solver: str) -> list[tuple[dict[str, Any], Job]]:
    """Return (what tells its row from others, job) of evenly spread starts, and of one at the largest mu."""
    robot = trial.robot.arm()
    curve = self_motion(robot, robot.data.q_home if trial.start.q_rad is None else trial.start.q_rad)
    top = float((curve.s[np.argmax(curve.mu)] - curve.s[0]) / (curve.s[-1] - curve.s[0]))
    places = [(fraction, curve.at(fraction), False) for fraction in np.linspace(0.05, 0.95, count).tolist()]
    found = []
    for fraction, pose, best in sorted([*places, (top, curve.best, True)], key=lambda place: place[0]):
        row = {"part": "swivel", "fraction": fraction, "mu_start": robot.state(pose).mu, "at_maximum": best}
        start = {"pose": "home", "q_rad": tuple(pose.tolist()), "swivel": "given"}
        found.append((row, Job("swivel", task, trial.change(start=start), (MATCHED, solver), brief=True)))
    return found


def gain(outcome: Outcome) -> dict[str, Any]:
    """Return the gain in mean mu over DCAC of the two runs of a job, or why there is none."""
    if outcome.broken:
        return {name: outcome.broken[0][name] for name in ("ended", "error")}
    dcac, moc = (m.metrics["mu_mean"] for m in outcome.measurements)
    ended = next((m.ended for m in outcome.measurements if m.ended != "completed"), "completed")
    return {"ended": ended, "mu_dcac": dcac, "mu_moc": moc, "gain_percent": 100.0 * (moc / dcac - 1.0)}
