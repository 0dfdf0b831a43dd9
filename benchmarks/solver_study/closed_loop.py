"""The same trials under every controller: the effect of a solver's answers on the robot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt import scenario
from moc_opt.control.supervisor import Fault
from moc_opt.errors import MocOptError
from moc_opt.planning.elbow import in_transient
from moc_opt.scenario import Scenario
from moc_opt.study import Failed, Job
from moc_opt.study.timing import UNDISTURBED, Disturbance, used
from moc_opt.study.trials import BASELINE, variant
from moc_opt.trace.meta import Ending
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace

Array = NDArray[Any]
Runner = Callable[..., list[Any]]
"""`moc_opt.study.run` with the study's own folder, workers and progress."""

KEPT = (
    "t_s", "mu", "mu_bound", "tip_error_m", "tip_error_model_m", "tip_error_registered_m", "rcm_error_m",
    "rcm_error_model_m", "rcm_error_registered_m", "trocar_force_N", "solve_us", "tick_us",
)  # fmt: skip
TRANSIENT = "travelling"  # column of a run: its own elbow is on its way
POSES = ("q_rad", "tip_m", "tip_ref_m", "trocar_m", "trocar_registered_m")  # to be drawn
POSES_EVERY = 5
PATIENCE_S = 30.0  # for what comes before and after a run
PER_S = 30.0  # that a simulated second may take; the slowest sound solver takes 15 ms a tick
LONGEST_S = 60.0  # of a run whose length is that of its task
SCANS_PER_S = 10.0  # of the self-motion, to tell the transient of the elbow from the steady state
STEADY = ("tip_error_model", "rcm_error_model", "rcm_error")
SHOWN_EVERY_S = 10.0  # what is known so far: its intervals take a second


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
    load: Disturbance = UNDISTURBED  # what the machine did between the first tick and the last

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


class Asked(NamedTuple):
    """One run that is wanted.

    Attributes:
        label: the controller's name in tables.
        case: the whole scenario, named by its trial.
        timed: its times mean something: nothing else runs meanwhile.
        short: only the beginning of the trial is run.
        whole: columns are kept, and the ticks found at which the elbow is on its way: `with_steady_errors` needs them.
        begin_s: the ticks before this time are summarised apart too.
    """

    label: str
    case: Scenario
    timed: bool = False
    short: bool = False
    whole: bool = True
    begin_s: float = np.inf


def finish(case: Scenario, poses: bool, whole: bool, begin_s: float) -> Run:
    """Run and summarise, in a worker; a run that breaks off is a result, with its reason. Arguments as in `Asked`."""
    marks = list[Disturbance]()

    def watch(tick: int) -> None:
        now = used()
        marks[:] = [marks[0] if marks else now, now]

    try:
        trace = scenario.run(case, watch)
    except MocOptError as error:
        return broken_off(case, f"{type(error).__name__}: {error}")
    ended = str(trace.meta["ended"])
    if not Ending.of(ended).whole:
        return Run("", case.name, summarize(trace), error=ended, ended=ended)
    metrics = summarize(trace)
    begun: dict[str, float] = {}
    count = int((trace.t_s < begin_s).sum())
    if count < len(trace):
        begun = summarize(trace.head(count))
    if "fault" in trace.columns:
        names, counts = np.unique(trace.fault, return_counts=True)
        metrics |= {f"fault_{name}": float(count) for name, count in zip(names, counts, strict=True)}
        metrics["infeasible_percent"] = 100.0 * float(np.mean(trace.status == "infeasible"))
    metrics["ticks"] = float(len(trace))
    kept = [name for name in (KEPT if whole else KEPT[:1]) if name in trace.columns]
    arrays = {name: np.asarray(trace.columns[name], dtype=float) for name in kept}
    if whole:
        flags = in_transient(
            case.robot.arm(), trace.t_s, trace.q_rad, samples_per_s=SCANS_PER_S, window_s=2.0 / SCANS_PER_S
        )
        metrics["travelling_percent"] = 100.0 * float(np.mean(flags))
        arrays[TRANSIENT] = flags
    if poses:
        arrays |= {name: trace.columns[name][::POSES_EVERY].astype(np.float32) for name in POSES}
    load = marks[1] - marks[0] + Disturbance(len(trace))
    return Run("", case.name, metrics, arrays, None, ended, faults=trace.meta.get("faults", {}), begun=begun, load=load)


def broken_off(case: Scenario, reason: str) -> Run:
    """Return a run that gave no result."""
    return Run("", case.name, {}, error=reason, ended="failed")


def run_each(
    run: Runner, asked: Sequence[Asked], done: Callable[[Asked, Run], None] = lambda one, found: None
) -> list[Run]:
    """Run them, those that are timed first and alone; a timed run whose times are spoilt is not kept.

    Args:
        run: `moc_opt.study.run` with the study's folder, workers and progress.
        asked: the runs.
        done: called with each as it comes.
    """
    jobs = [
        Job(finish, (one.case, one.timed, one.whole, one.begin_s), limit_of(one.case), alone=one.timed, group=one.label)
        for one in asked
    ]
    place = {id(job): one for job, one in zip(jobs, asked, strict=True)}

    def named(one: Asked, result: Run | Failed) -> Run:
        found = broken_off(one.case, str(result)) if isinstance(result, Failed) else result
        return replace(found, controller=one.label, timed=one.timed, short=one.short)

    results = run(
        jobs, done=lambda job, result: done(place[id(job)], named(place[id(job)], result)),
        keep=lambda found: not found.columns or POSES[0] not in found.columns or found.load.trusts(99.0),
    )  # fmt: skip
    return [named(one, result) for one, result in zip(asked, results, strict=True)]


def limit_of(case: Scenario) -> float:
    """Return how long a run may take [s]."""
    return PATIENCE_S + PER_S * min(case.duration_s or LONGEST_S, LONGEST_S)


def run_all(
    run: Runner,
    cases: Mapping[str, Scenario],
    controllers: Mapping[str, Mapping[str, Any]],
    *,
    trials_of: Callable[[str], int] | None = None,
    timed: int = 1,
    short: Sequence[str] = (),
    short_s: float = np.inf,
    show: Callable[[list[Run]], None] = lambda _: None,
) -> list[Run]:
    """Run every controller on its trials, the baseline first; in the order of the trials.

    Args:
        run: see `run_each`.
        cases: name -> trial.
        controllers: solver -> its settings.
        trials_of: how many trials a solver runs, the first so many; None: all of them.
        timed: how many trials, the first ones, run alone, so that their times hold; the others' are not used.
        short: solvers that run the beginning of each trial alone,
        short_s: and how long that is; of the other runs it is summarised apart too.
        show: called with the runs of the trials that are whole, at most every ``SHOWN_EVERY_S``.
    """
    brief = set(short) & set(controllers)
    begin_s = short_s if brief else np.inf
    asked: list[Asked] = []
    for k, trial in enumerate(cases.values()):
        asked.append(Asked(BASELINE, variant(trial, BASELINE), k < timed, begin_s=begin_s))
        for name, settings in controllers.items():
            if trials_of is not None and k >= trials_of(name):
                continue
            case, cut = variant(trial, name, settings), name in brief and short_s < (trial.duration_s or np.inf)
            asked.append(Asked(name, case.change(duration_s=short_s) if cut else case, k < timed, cut, begin_s=begin_s))
    wanted = Counter(one.case.name for one in asked)
    so_far, shown = dict[str, list[Run]](), -np.inf

    def take(one: Asked, found: Run) -> None:
        nonlocal shown
        so_far.setdefault(one.case.name, []).append(found)
        if perf_counter() - shown > SHOWN_EVERY_S and wanted[one.case.name] == len(so_far[one.case.name]):
            whole = [by_trial(so_far[name]) for name in so_far if wanted[name] == len(so_far[name])]
            show([each for runs in whole for each in runs])
            shown = perf_counter()

    found = run_each(run, asked, take)
    return [each for name in cases for each in by_trial([r for r in found if r.trial == cases[name].name])]


def by_trial(runs: Sequence[Run]) -> list[Run]:
    """Return the runs of one trial with what only all of them tell: gains of mu, and errors in the steady state."""
    baseline = next((run for run in runs if run.controller == BASELINE and run.columns), None)
    return with_steady_errors([with_gain(run, baseline) for run in runs])


def with_gain(run: Run, baseline: Run | None) -> Run:
    """Return the run with its gain of mean mu over the baseline's on the same ticks [percent]."""
    if baseline is None or not run.columns:
        return run
    base = float(baseline.columns["mu"][: len(run.columns["t_s"])].mean())
    return replace(run, metrics={**run.metrics, "mu_gain_percent": 100.0 * (run.metrics["mu_mean"] / base - 1.0)})


def with_steady_errors(runs: Sequence[Run]) -> list[Run]:
    """Return the runs of one trial with their errors in the steady state, over the same ticks for all of them.

    Steady ticks are those at which no controller is still moving the elbow to its optimum. DCAC, which does not move
    it on purpose, and runs that broke off do not count here.
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
