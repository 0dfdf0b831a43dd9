"""The same trials under every controller: what a solver's answers do to the robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.study.store import Part, Store
from benchmarks.study.worker import Hung, Worker, WorkerError, beat
from benchmarks.timing import percentiles
from moc_opt import scenario
from moc_opt.control.supervisor import Fault
from moc_opt.errors import MocOptError
from moc_opt.metrics import summarize
from moc_opt.scenario import Scenario
from moc_opt.trace import Trace
from moc_opt.travel import travelling

Array = NDArray[Any]

BASELINE = "dcac"  # tip and RCM alone, with the gains of the others
KEPT = ("t_s", "mu", "mu_bound", "tip_error_m", "rcm_error_m", "trocar_force_N", "solve_us", "tick_us")
POSES = (
    "q_rad",
    "tip_m",
    "tip_ref_m",
    "trocar_m",
    "trocar_registered_m",
)  # where arm and trocar were, to be drawn
POSES_EVERY = 5
PATIENCE_S = 30.0  # without a sign of life: a tick, or what comes before and after the run
BEAT_S = 0.5
HUNG = "hung"
SCANS_PER_S = 10.0  # of the self-motion, to tell a travelling elbow from a settled one
ERRORS = ("tip_error", "rcm_error")
AVERAGED = ("mu_", "tip_error_", "rcm_error_", "trocar_force_", "torque_rate_")


@dataclass(frozen=True)
class Run:
    """One controller on one trial; without columns where the run broke off, and ``error`` says why."""

    controller: str
    trial: str
    metrics: Mapping[str, float]
    columns: Mapping[str, Array] = field(default_factory=dict)
    error: str | None = None
    faults: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # as in the trace's meta

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
        """One row of rows.parquet."""
        return {
            "part": "closed_loop", "solver": self.controller, "trial": self.trial, "error": self.error,
            "raised": self.raised or None, **self.metrics,
        }  # fmt: skip


def each_tick(columns: Mapping[str, Array]) -> dict[str, Array]:
    """The columns with a row for each tick."""
    return {name: column for name, column in columns.items() if name not in POSES}


def trials(base: Scenario, tasks: Sequence[str], seeds: Sequence[int]) -> dict[str, Scenario]:
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


def finish(trial: Scenario, baseline: Mapping[str, Array] | None, poses: bool) -> Iterator[Part]:
    """Run and summarise, in a worker; a run that breaks off is a result, with its reason."""
    last = perf_counter()

    def watch(tick: int) -> None:
        nonlocal last
        if perf_counter() - last > BEAT_S:
            beat()
            last = perf_counter()

    try:
        trace = scenario.run(trial, watch)
    except MocOptError as error:
        yield Part({"error": f"{type(error).__name__}: {error}", "metrics": {}}, {})
        return
    metrics = summarize(trace, None if baseline is None else Trace(baseline)) | _settled(trial, trace)
    if "fault" in trace.columns:
        names, counts = np.unique(trace.fault, return_counts=True)
        metrics |= {f"fault_{name}": float(count) for name, count in zip(names, counts, strict=True)}
        metrics["infeasible_percent"] = 100.0 * float(np.mean(trace.status == "infeasible"))
    metrics["ticks"] = float(len(trace))
    arrays = {name: np.asarray(trace.columns[name], dtype=float) for name in KEPT if name in trace.columns}
    if poses:
        arrays |= {name: trace.columns[name][::POSES_EVERY].astype(np.float32) for name in POSES}
    yield Part({"error": None, "metrics": metrics, "faults": trace.meta.get("faults", {})}, arrays)


def _settled(trial: Scenario, trace: Trace) -> dict[str, float]:
    """Errors apart from what an elbow on its way costs; nothing where it never arrives."""
    flags = travelling(trial.robot.arm(), trace.t_s, trace.q_rad, samples_per_s=SCANS_PER_S, window_s=2.0 / SCANS_PER_S)
    found = summarize(trace.with_columns(travelling=flags), phase="settled")
    return {
        **{f"{error}_settled_mean_mm": found[f"{error}_mean_mm"] for error in ERRORS if f"{error}_mean_mm" in found},
        "travelling_percent": 100.0 * float(np.mean(flags)),
    }


def run_one(
    store: Store, worker: Worker, trial: Scenario, label: str, baseline: Run | None, *, timed: bool = True
) -> Run:
    """One scenario in the worker, or from the store.

    Args:
        store: of finished runs.
        worker: where it runs.
        trial: the whole scenario.
        label: the controller's name in tables.
        baseline: the run that mu is compared with.
        timed: whether its times mean anything: nothing else ran meanwhile.
    """
    reference = each_tick(baseline.columns) if baseline is not None and baseline.columns else None
    shape = trial.model_dump(mode="json")
    mu = None if reference is None else reference["mu"]
    key = store.key(part="closed loop", scenario=shape, baseline=mu, timed=timed)
    part = store.get(key)
    if part is None:
        try:
            # Of the many runs whose times are not taken none is drawn: their poses would only fill the disk.
            asked = (finish, trial, reference, timed)
            (part,) = list(worker.stream(*asked, patience_s=PATIENCE_S, first_s=PATIENCE_S))
        except WorkerError as error:
            word = HUNG if isinstance(error, Hung) else type(error).__name__.lower()
            part = Part({"error": f"{word}: {error}", "metrics": {}}, {})
        store.put(key, part)
    values = part.values
    return Run(label, trial.name, values["metrics"], part.arrays, values["error"], values.get("faults", {}))


def run_all(
    cases: Mapping[str, Scenario],
    controllers: Mapping[str, Mapping[str, Any]],
    advance: Callable[[str], None],
    store: Store | None = None,
) -> list[Run]:
    """Every controller on every trial, trial by trial, the baseline first; one at a time, so that times hold."""
    store = store or Store(None)
    runs: list[Run] = []
    hung: dict[str, str] = {}
    with Worker() as worker:
        for trial in cases.values():
            baseline = run_one(store, worker, variant(trial, BASELINE), BASELINE, None)
            advance(f"{trial.name} {BASELINE}")
            runs.append(baseline)
            for name, settings in controllers.items():
                if name in hung:
                    runs.append(Run(name, trial.name, {}, error=f"not run: it hung on trial {hung[name]}"))
                else:
                    runs.append(run_one(store, worker, variant(trial, name, settings), name, baseline))
                    if (runs[-1].error or "").startswith(HUNG):
                        hung[name] = trial.name
                advance(f"{trial.name} {name}")
    return runs


def summary(runs: Sequence[Run]) -> dict[str, dict[str, Any]]:
    """Controller -> metric over its trials: means of means, largest of maxima, sums of counts, pooled times."""
    return {
        name: combined([run for run in runs if run.controller == name])
        for name in dict.fromkeys(run.controller for run in runs)
    }


def combined(runs: Sequence[Run]) -> dict[str, Any]:
    """The runs of one controller as one; see ``summary``."""
    whole = [run for run in runs if run.columns]
    values: dict[str, Any] = {"runs": len(runs), "broke_off": len(runs) - len(whole)}
    for metric in dict.fromkeys(metric for run in whole for metric in run.metrics):
        data = [run.metrics[metric] for run in whole if metric in run.metrics]
        if metric.endswith(("_p50_us", "_p99_us")):
            continue
        averaged = metric.startswith(AVERAGED) or metric.endswith("_percent")
        total = np.max if "_max" in metric else np.mean if averaged else np.sum
        values[metric] = float(total(data))
    for column, prefix in (("solve_us", "solve"), ("tick_us", "tick")):
        pooled = np.concatenate([np.empty(0), *(r.columns[column] for r in whole if column in r.columns)])
        values |= percentiles(pooled, prefix)
    errors = [run.error for run in runs if run.error]
    raised = [run.raised for run in runs if run.raised]
    values |= {"trouble": raised[0]} if raised else {}
    return {**values, "reason": errors[0]} if errors else values
