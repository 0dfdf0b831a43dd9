"""Run a trial (a scenario with its own seed) under a controller, and make one row of results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from moc_opt import scenario
from moc_opt.arrays import Array
from moc_opt.control.settings import GAINS
from moc_opt.control.supervisor import Fault
from moc_opt.errors import MocOptError, describe
from moc_opt.planning.elbow import in_transient
from moc_opt.robots import load_data
from moc_opt.scenario import Scenario, Setup
from moc_opt.solvers.base import Solver
from moc_opt.study.engine import Failed, Job
from moc_opt.study.timing import since, used
from moc_opt.trace.meta import Ending
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace
from moc_opt.vision.board import board_task

BASELINE, OWN, DAMPED = "dcac", "dcac-own", "dcac-damped"
BASELINES = {
    BASELINE: "tip and RCM alone, with the gains of MOC",
    OWN: "tip and RCM alone, with the gains that the paper gives DCAC",
    DAMPED: "tip and RCM alone, with the gains of MOC and the self-motion damped",
}
CURVES = (
    "t_s", "mu", "tip_error_model_m", "tip_error_registered_m", "tip_error_m", "rcm_error_model_m",
    "rcm_error_registered_m", "rcm_error_m", "trocar_force_N", "solve_us", "tick_us",
)  # fmt: skip
CLOCKS = ("solve_", "tick_", "deadline_")
LOOK_TICKS = 100  # ticks between readings of the load
PATIENCE_S, PER_S, LONGEST_S = 30.0, 30.0, 60.0
"""Time limit of a run: `PATIENCE_S`, plus `PER_S` for each of the first `LONGEST_S` simulated seconds."""


def seeds(seed: int, stream: int, count: int) -> list[int]:
    """Draw the seeds of ``count`` trials. Studies with different streams share no seeds."""
    state = np.random.SeedSequence([seed, stream]).generate_state(count, np.uint32)
    return [int(entry) for entry in state]


def trials(base: Scenario, tasks: Sequence[str], own_seeds: Sequence[int], *, virtual: bool = False) -> list[Scenario]:
    """Make one scenario per seed, with the tasks in turn and a random swivel.

    With ``virtual``, the path's sizes and the trocar's depth are those of the paper's virtual task.
    """
    found = []
    for k, seed in enumerate(own_seeds):
        name = tasks[k % len(tasks)]
        task: dict[str, Any] = {"path": name}
        tables: dict[str, Any] = {}
        if virtual:
            board = board_task(name)
            task, tables = {"path": board.kind, "sizes": dict(board.sizes)}, {"trocar": {"depth_m": board.depth_m}}
        found.append(base.change(name=f"{name}/{seed}", seed=seed, task=task, start={"swivel": "random"}, **tables))
    return found


def placed(trial: Scenario) -> Scenario:
    """Return the trial with its random start pose resolved to joint positions."""
    q = Setup(trial).q_start.tolist()
    return trial.change(start={"pose": "home", "q_rad": q, "swivel": "given", "check_path": False})


def variant(trial: Scenario, controller: str, settings: Mapping[str, Any] | None = None) -> Scenario:
    """Return the trial under one of `BASELINES`, or with a solver."""
    control = trial.control
    if controller == BASELINE and control.law == "dcac":
        return trial
    if controller not in BASELINES:
        return trial.change(solver={"name": controller, "settings": dict(settings or {})})
    if controller == OWN:
        return trial.change(control={"law": "dcac", "gains": "dcac", **dict.fromkeys(GAINS)})
    table = control.matched_dcac()
    if controller == DAMPED:  # as level 3 of MOC damps if the solver's velocity x is 0: K_N2 (x - v) - D_N2 v
        data = load_data(trial.robot.name)
        moc = control.resolve_gains(data.gains, data.n)
        table = {**table, "dcac_damping": (moc.K_N2 + moc.D_N2).tolist()}
    return trial.change(control=table)


@dataclass(frozen=True)
class Trial:
    """One scenario under one controller."""

    case: Scenario
    controller: str  #: one of `BASELINES`, or the name of a solver
    settings: Mapping[str, Any] = field(default_factory=dict)  #: settings of the solver
    tags: Mapping[str, Any] = field(default_factory=dict)  #: further columns of the row
    timed: bool = False  #: whether the trial runs alone and is timed
    keep: Literal["row", "curves"] = "row"  #: "curves": also keep the columns in `CURVES`
    solver: str | Solver | None = None  #: solver to use instead of ``controller``

    @property
    def about(self) -> dict[str, Any]:
        """The columns that identify the trial's row."""
        case = self.case
        named = {"trial": case.name, "seed": case.seed, "robot": case.robot.name, "task": case.task.path}
        return {**named, "controller": self.controller, "timed": self.timed, **self.tags}

    @property
    def job(self) -> Job:
        """The job that runs the trial."""
        limit = PATIENCE_S + PER_S * min(self.case.duration_s or LONGEST_S, LONGEST_S)
        return Job(run_trial, (self,), limit, alone=self.timed, group=self.controller)

    def failed(self, reason: str) -> Run:
        """Return the `Run` of a failed trial."""
        return Run({**self.about, "ended": Ending.FAILED.value, "whole": False, "error": reason})


@dataclass(frozen=True)
class Run:
    """The result of a trial.

    Its row has the columns of `Trial.about`, ``ended``, ``whole`` (completed), ``error``, ``raised`` and every metric.
    ``raised`` describes the solver's exceptions or, if there are none, its malformed answers.
    """

    row: Mapping[str, Any]
    columns: Mapping[str, Array] = field(default_factory=dict)  #: curves of a completed run
    load: Mapping[str, float] = field(default_factory=dict)  #: the machine's load, if the run was timed


def run_trial(asked: Trial) -> Run:
    """Run and summarise a trial."""
    return run_and_trace(asked)[0]


def run_and_trace(asked: Trial, baseline: Trace | None = None) -> tuple[Run, Trace | None]:
    """Return a trial's `Run` and its trace. With a ``baseline`` of equal length, metrics include the gain over it."""
    begun, seen, solver = dict[str, float](), dict[str, float](), asked.solver

    def look(tick: int) -> None:
        if tick == 0:
            begun.update(used())
        elif tick % LOOK_TICKS == 0:
            seen.update(since(begun, tick))

    watch = look if asked.timed else None

    try:
        if solver is None or isinstance(solver, str):
            trace = scenario.run(variant(asked.case, solver or asked.controller, asked.settings), watch)
        else:
            trace = scenario.run(asked.case, watch, solver=solver)
    except scenario.RunAway as error:
        trace = error.trace
    except MocOptError as error:
        return asked.failed(describe(error)), None
    ended = str(trace.meta["ended"])
    whole = Ending.of(ended).whole
    metrics = summarize(trace, baseline if baseline is not None and len(baseline) == len(trace) else None)
    if not asked.timed:
        metrics = {name: value for name, value in metrics.items() if not name.startswith(CLOCKS)}
    faults = trace.meta.get("faults", {})
    raised = faults.get(Fault.RAISED.label) or faults.get(Fault.MALFORMED.label)
    row = {
        **asked.about, "ended": ended, "whole": whole, "error": None if whole else ended,
        "raised": raised and f"{raised['count']} ticks, first at {raised['first_at_s']:.3f} s: {raised['first']}",
        "ticks": len(trace), **_counts(trace), **metrics,
    }  # fmt: skip
    load = {**seen, "times_calls": len(trace)} if asked.timed else {}
    return Run(row, _columns(asked, trace) if whole else {}, load), trace


def _counts(trace: Trace) -> dict[str, Any]:
    found: dict[str, Any] = {"mu_bound_method": trace.meta.get("mu_bound_method")}
    if "status" in trace.columns:
        found |= {"asked": int((trace.status != "none").sum()), "infeasible": int((trace.status == "infeasible").sum())}
    if "fault" in trace.columns:
        names, counts = np.unique(trace.fault, return_counts=True)
        found |= {f"fault_{name}": int(count) for name, count in zip(names, counts, strict=True) if name != "none"}
    return found


def _columns(asked: Trial, trace: Trace) -> dict[str, Array]:
    if asked.keep == "row":
        return {}
    found = {name: np.asarray(trace.columns[name], np.float64) for name in CURVES if name in trace.columns}
    if asked.controller not in BASELINES:
        found["travelling"] = in_transient(asked.case.robot.arm(), trace.t_s, trace.q_rad).astype(np.float64)
    return found


def outcome(asked: Trial, result: Run | Failed) -> Run:
    """Return the run, or a failed one if the job has no result."""
    return asked.failed(str(result)) if isinstance(result, Failed) else result
