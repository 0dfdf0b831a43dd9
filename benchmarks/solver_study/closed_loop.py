"""The same trials under every controller: what a solver's answers do to the robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.crew import spread
from benchmarks.common.processes import Hung, Worker, WorkerError, beat
from benchmarks.common.store import Part, Store
from moc_opt import scenario
from moc_opt.comparison.trials import BASELINE, variant
from moc_opt.control.supervisor import Fault
from moc_opt.errors import MocOptError
from moc_opt.redundancy.transient import in_transient
from moc_opt.scenario import Scenario
from moc_opt.trace.ending import Ending
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace

Array = NDArray[Any]

KEPT = (
    "t_s", "mu", "mu_bound", "tip_error_m", "tip_error_model_m", "rcm_error_m", "rcm_error_model_m", "trocar_force_N",
    "solve_us", "tick_us",
)  # fmt: skip
TRANSIENT = "travelling"  # column of a run: its own elbow is on its way
POSES = ("q_rad", "tip_m", "tip_ref_m", "trocar_m", "trocar_registered_m")  # to be drawn
POSES_EVERY = 5
PATIENCE_S = 30.0  # without a sign of life: a tick, or what comes before and after the run
BEAT_S = 0.5
HUNG = "hung"
SCANS_PER_S = 10.0  # of the self-motion, to tell the transient of the elbow from the steady state
STEADY = ("tip_error_model", "rcm_error_model", "rcm_error")


@dataclass(frozen=True)
class Run:
    """One controller on one trial; without columns where the run broke off, and ``error`` says why.

    ``ended`` is the trace's ``meta["ended"]``, or "failed" where there is none; the metrics of a stopped run are those
    of a part, and enter no mean.
    """

    controller: str
    trial: str
    metrics: Mapping[str, float]
    columns: Mapping[str, Array] = field(default_factory=dict)
    error: str | None = None
    ended: str = "completed"
    timed: bool = True
    faults: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # as in the trace's meta
    short: bool = False  # only the beginning of the trial was run
    begun: Mapping[str, float] = field(default_factory=dict)  # metrics of that beginning, where some runs are short

    @property
    def beginning(self) -> Run:
        """The ticks that the short runs have too; the run itself where it is short or broke off."""
        return replace(self, metrics=self.begun) if self.begun and not self.short else self

    @property
    def raised(self) -> str:
        """What the solver raised first, and how often it did; "" where it never did."""
        found = self.faults.get(Fault.RAISED.label)
        if found is None:
            return ""
        return f"{self.trial}, {found['count']:g} ticks, first at {found['first_at_s']:.3f} s: {found['first']}"

    @property
    def trace(self) -> Trace | None:
        """What is left of the run: a few columns."""
        return Trace(each_tick(self.columns)) if self.columns else None

    @property
    def seen(self) -> Trace | None:
        """What can be drawn of the run: poses too, at every ``POSES_EVERY``-th tick; None where none were kept."""
        if not self.columns or POSES[0] not in self.columns:
            return None
        thin = {name: column[::POSES_EVERY] for name, column in each_tick(self.columns).items()}
        return Trace({**thin, **{name: self.columns[name] for name in POSES}})

    def row(self) -> dict[str, Any]:
        """Return one row of rows.parquet."""
        return {
            "part": "closed_loop", "solver": self.controller, "trial": self.trial, "ended": self.ended,
            "error": self.error, "raised": self.raised or None, **self.metrics,
        }  # fmt: skip


def each_tick(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Return the columns with a row for each tick."""
    return {name: column for name, column in columns.items() if name not in (*POSES, TRANSIENT)}


def finish(
    trial: Scenario, baseline: Mapping[str, Array] | None, poses: bool, whole: bool, begin_s: float = np.inf
) -> Iterator[Part]:
    """Run and summarise, in a worker; a run that breaks off is a result, with its reason.

    Args:
        trial: the whole scenario.
        baseline: columns of the run that mu is compared with.
        poses: keep where arm and trocar were.
        whole: keep columns, and find the ticks at which the elbow is on its way; else the metrics alone.
        begin_s: summarise the ticks before this time apart too.
    """
    last = perf_counter()

    def watch(tick: int) -> None:
        nonlocal last
        if perf_counter() - last > BEAT_S:
            beat()
            last = perf_counter()

    try:
        trace = scenario.run(trial, watch)
    except MocOptError as error:
        yield Part({"ended": "failed", "error": f"{type(error).__name__}: {error}", "metrics": {}}, {})
        return
    ended = str(trace.meta["ended"])
    if not Ending.of(ended).whole:
        yield Part({"ended": ended, "error": ended, "metrics": summarize(trace)}, {})
        return
    reference = None if baseline is None else Trace(baseline)
    metrics = summarize(trace, None if reference is None else reference.head(len(trace)))
    begun: dict[str, float] = {}
    count = int((trace.t_s < begin_s).sum())
    if count < len(trace):
        begun = summarize(trace.head(count), None if reference is None else reference.head(count))
    if "fault" in trace.columns:
        names, counts = np.unique(trace.fault, return_counts=True)
        metrics |= {f"fault_{name}": float(count) for name, count in zip(names, counts, strict=True)}
        metrics["infeasible_percent"] = 100.0 * float(np.mean(trace.status == "infeasible"))
    metrics["ticks"] = float(len(trace))
    kept = [name for name in (KEPT if whole else KEPT[:1]) if name in trace.columns]
    arrays = {name: np.asarray(trace.columns[name], dtype=float) for name in kept}
    if whole:
        flags = in_transient(
            trial.robot.arm(), trace.t_s, trace.q_rad, samples_per_s=SCANS_PER_S, window_s=2.0 / SCANS_PER_S
        )
        metrics["travelling_percent"] = 100.0 * float(np.mean(flags))
        arrays[TRANSIENT] = flags
    if poses:
        arrays |= {name: trace.columns[name][::POSES_EVERY].astype(np.float32) for name in POSES}
    faults = trace.meta.get("faults", {})
    found = {"ended": ended, "error": None, "metrics": metrics, "faults": faults, "begun": begun}
    yield Part(found, arrays)


def run_one(
    store: Store, worker: Worker, trial: Scenario, label: str, baseline: Run | None, *, timed: bool = True,
    whole: bool = True, begin_s: float = np.inf,
) -> Run:
    """Run one scenario in the worker, or take its run from the store.

    Args:
        store: of finished runs.
        worker: where it runs.
        trial: the whole scenario.
        label: the controller's name in tables.
        baseline: the run that mu is compared with.
        timed: whether its times mean anything: nothing else ran meanwhile.
        whole: keep columns, and find the ticks at which the elbow is on its way: `with_steady_errors` needs them.
        begin_s: summarise the ticks before this time apart too.
    """
    reference = each_tick(baseline.columns) if baseline is not None and baseline.columns else None
    key = store.key(
        part="closed loop", scenario=trial.model_dump(mode="json"), timed=timed, whole=whole,
        baseline=None if reference is None else reference["mu"], begin_s=begin_s if np.isfinite(begin_s) else None,
    )  # fmt: skip
    part = store.get(key)
    if part is None:
        try:
            # Of the many runs whose times are not taken none is drawn: their poses would only fill the disk.
            asked = (finish, trial, reference, timed, whole, begin_s)
            (part,) = list(worker.stream(*asked, patience_s=PATIENCE_S, first_s=PATIENCE_S))
        except WorkerError as error:
            word = HUNG if isinstance(error, Hung) else type(error).__name__.lower()
            part = Part({"ended": "failed", "error": f"{word}: {error}", "metrics": {}}, {})
        store.put(key, part)
    values, faults = part.values, part.values.get("faults", {})
    return Run(
        label, trial.name, values["metrics"], part.arrays, values["error"], values["ended"], timed=timed, faults=faults,
        begun=values.get("begun", {}),
    )  # fmt: skip


def run_all(
    cases: Mapping[str, Scenario],
    controllers: Mapping[str, Mapping[str, Any]],
    advance: Callable[[str], None],
    store: Store | None = None,
    *,
    timed: int = 1,
    processes: int = 1,
    short: Sequence[str] = (),
    short_s: float = np.inf,
    show: Callable[[list[Run]], None] = lambda _: None,
) -> list[Run]:
    """Run every controller on every trial, the baseline first; in the order of the trials.

    Args:
        cases: name -> trial.
        controllers: solver -> its settings.
        advance: called with a few words after each run.
        store: of finished runs; None keeps nothing.
        timed: how many trials, the first ones, run alone, so that their times hold; the others' are not used.
        processes: how many of the others run at a time.
        short: solvers that run the beginning of each trial alone,
        short_s: and how long that is; of the other runs it is summarised apart too.
        show: called with the runs so far after each trial.
    """
    store = store or Store(None)
    hung: dict[str, str] = {}
    brief = set(short) & set(controllers)
    begin_s = short_s if brief else np.inf
    so_far: list[Run] = []

    def one_trial(worker: Worker, trial: Scenario, alone: bool) -> list[Run]:
        baseline = run_one(store, worker, variant(trial, BASELINE), BASELINE, None, timed=alone, begin_s=begin_s)
        advance(f"{trial.name} {BASELINE}")
        runs = [baseline]
        for name, settings in controllers.items():
            if name in hung:
                reason = f"not run: it hung on trial {hung[name]}"
                runs.append(Run(name, trial.name, {}, error=reason, ended="failed", timed=alone))
            else:
                asked, cut = variant(trial, name, settings), False
                if name in brief and short_s < (trial.duration_s or np.inf):
                    asked, cut = asked.change(duration_s=short_s), True
                run = run_one(store, worker, asked, name, baseline, timed=alone, begin_s=begin_s)
                runs.append(replace(run, trial=trial.name, short=cut))
                if (runs[-1].error or "").startswith(HUNG):
                    hung[name] = trial.name
            advance(f"{trial.name} {name}")
        runs = with_steady_errors(runs)
        so_far.extend(runs)
        show(list(so_far))
        return runs

    trials = list(cases.values())
    with Worker() as worker:
        found = [one_trial(worker, trial, True) for trial in trials[:timed]]
    others = trials[timed:]
    if others:
        found += spread(others, lambda worker, trial: one_trial(worker, trial, False), processes)
    return [run for runs in found for run in runs]


def with_steady_errors(runs: Sequence[Run]) -> list[Run]:
    """Return the runs of one trial with their errors in the steady state, over the same ticks for all of them.

    Steady are the ticks at which the elbow of no controller with a third level is on its way to its optimum; DCAC,
    which leads its elbow nowhere, has no say in them, nor has a run that broke off.
    """
    transient = [
        run.columns[TRANSIENT].astype(bool)
        for run in runs
        if run.columns and run.controller != BASELINE and not run.short
    ]
    if not transient:
        return list(runs)
    steady = ~np.any(transient, axis=0)
    found = []
    for run in runs:
        metrics = dict(run.metrics)
        if run.columns and not run.short:
            metrics["settled_ticks"] = float(steady.sum())
            if steady.any():
                for name in STEADY:
                    metrics[f"{name}_settled_mean_mm"] = 1e3 * float(run.columns[f"{name}_m"][steady].mean())
        found.append(replace(run, metrics=metrics))
    return found
