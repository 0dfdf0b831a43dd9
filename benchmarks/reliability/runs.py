"""One controller on one trial under every fault, compared with its own run without any."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.reliability.config import BASELINE, Case, Config
from moc_opt.errors import MocOptError
from moc_opt.numerics.arrays import Array
from moc_opt.scenario import Scenario, Setup
from moc_opt.sim.loop import RunAway
from moc_opt.tasks import Reference
from moc_opt.tasks.waiting import WaitingReference
from moc_opt.trace.ending import Ending
from moc_opt.trace.trace import Trace

Flags = NDArray[np.bool_]

SMOOTH_S = 0.2  # errors are averaged over so long before they are compared with the run without a fault
RECOVERED = 1.2  # times the level without a fault
RESOLUTION_M = 5e-5  # half an encoder step at the end of the arm: less is no difference
COMPLAINTS = ("failed", "raised", "malformed", "not_finite", "outside", "lied", "late", "lost")
"""Faults that a supervisor names when a solver misbehaves; "infeasible" is an honest answer."""


@dataclass(frozen=True)
class Job:
    """One controller on one trial, with the faults to inject."""

    controller: str
    trial: int
    scenario: Scenario
    cases: Mapping[str, Case]
    limits_mm: tuple[float, float]  # tip, RCM
    keep: tuple[str, ...] = ()  # cases whose traces are wanted


@dataclass
class Outcome:
    """The results of a job: one row per case, the run without a fault first."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    traces: dict[str, Trace] = field(default_factory=dict)


def jobs(config: Config) -> list[Job]:
    """Return every controller on every trial."""
    found = []
    for trial in range(config.trials):
        base = config.scenario.change(seed=config.seed + trial)
        for controller in (BASELINE, *config.solvers):
            if controller == BASELINE:
                scenario = base.change(control=base.control.matched_dcac())
                cases = {name: case for name, case in config.cases.items() if case.group != "solver"}
            else:
                scenario, cases = base.change(solver={"name": controller, "settings": {}}), dict(config.cases)
            limits = (config.tip_limit_mm, config.rcm_limit_mm)
            keep = ("bump-30N", "trocar-slips", "nan-lasting") if trial == 0 and controller == "exact" else ()
            found.append(Job(controller, trial, scenario, cases, limits, keep))
    return found


class Waited:
    """A reference whose path waits while the board is out of sight, with the interface of the loop."""

    def __init__(self, reference: Reference, period: float, ticks: int, lost_s: tuple[float, float]) -> None:
        t = period * np.arange(ticks)
        seen = (t < lost_s[0]) | (t >= lost_s[1])
        self.rows, _ = WaitingReference(reference, period).play(seen)

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Return the point, velocity, acceleration, (k, 3) each, of the first k ticks."""
        x, dx, ddx = np.swapaxes(self.rows[: len(t)], 0, 1)
        return x, dx, ddx


def run_case(scenario: Scenario, camera_lost_s: tuple[float, float] | None) -> tuple[Trace | None, str]:
    """Return the trace as far as it goes, and how the run ended."""
    try:
        setup = Setup(scenario)
        if camera_lost_s is not None:
            ticks = len(setup.times())
            setup.reference = Waited(setup.reference, scenario.plant.period_s, ticks, camera_lost_s)  # type: ignore[assignment]
        trace = setup.trace()
    except RunAway as error:
        return error.trace, str(error.trace.meta["ended"])
    except MocOptError as error:
        return None, f"refused: {type(error).__name__}: {error}"
    return trace, str(trace.meta["ended"])


def run_job(job: Job) -> Outcome:
    """Run all cases of a job."""
    out = Outcome()
    free, ended = run_case(job.scenario, None)
    if free is None:
        raise MocOptError(f"{job.controller}: the run without a fault did not start: {ended}")
    waiting: Trace | None = None
    for name, case in {"none": None, **job.cases}.items():
        level: Trace = free
        trace, how = (free, ended) if case is None else run_case(case.corrupt(job.scenario), case.camera_lost_s)
        if case is not None and case.camera_lost_s is not None:
            # A path that may wait starts gently, so it is compared with one that never has to.
            waiting = run_case(job.scenario, (0.0, 0.0))[0] if waiting is None else waiting
            level = waiting or free
        row = {
            "case": name, "group": case.group if case else "none", "solver": job.controller,
            "trial": job.trial, "ended": how,
        }  # fmt: skip
        out.rows.append({**row, **measure(trace, level, how, case, job.limits_mm)})
        if name in (*job.keep, "none") and trace is not None and job.keep:
            out.traces[name] = trace
    return out


def measure(
    trace: Trace | None, free: Trace, ended: str, case: Case | None, limits_mm: tuple[float, float]
) -> dict[str, Any]:
    """Return the figures of one run beside the run without a fault."""
    if trace is None:
        return {"outcome": "refused"}
    # A stopped arm need not follow its reference: the way that it moves on counts.
    whole, stopped_at = trace, trace.meta.get("stopped_at_s")
    trace = trace if stopped_at is None else trace.select(trace.t_s <= stopped_at)
    tip, rcm = 1e3 * trace.tip_error_m, 1e3 * whole.rcm_error_m
    bounded = bool(tip.max() <= limits_mm[0] and rcm.max() <= limits_mm[1])  # False for NaN as well
    outcome = Ending.of(ended).value
    if ended == Ending.COMPLETED:
        outcome = "survived" if bounded else "diverged"
    force = np.linalg.norm(whole.trocar_force_N, axis=1)
    found: dict[str, Any] = {
        "outcome": outcome, "ticks": len(whole), "stopped_at_s": stopped_at,
        "stop_travel_mm": None if stopped_at is None else _coast_mm(whole, len(trace) - 1),
        "tip_error_max_mm": float(tip.max()), "rcm_error_max_mm": float(rcm.max()),
        "tip_error_mean_mm": float(tip.mean()), "rcm_error_mean_mm": float(rcm.mean()),
        "trocar_force_max_N": float(force.max()),
        "limited_ticks": int(np.count_nonzero(whole.limited)),
        "last_speed_rad_per_s": float(np.abs(whole.v_rad_per_s[-1]).max()),
        "recover_s": recovery(trace, free, case, ended),
    }  # fmt: skip
    if outcome == "survived":
        found["rcm_mean_percent"] = 100.0 * (found["rcm_error_mean_mm"] / (1e3 * free.rcm_error_m.mean()) - 1.0)
        found["rcm_max_percent"] = 100.0 * (found["rcm_error_max_mm"] / (1e3 * free.rcm_error_m.max()) - 1.0)
    if "fault" in whole.columns:
        found |= detection(whole)
    return found


def _coast_mm(trace: Trace, stop: int) -> float:
    """Return the largest distance of the tip from where it was when the stop began [mm]."""
    return 1e3 * float(np.linalg.norm(trace.tip_m[stop:] - trace.tip_m[stop], axis=1).max())


def detection(trace: Trace) -> dict[str, int]:
    """Count injected solver faults, those that were refused, and those that were not.

    An answer that was corrupted, was taken, and is verified as the optimum all the same (the opposite gradient can
    have the same optimum, where the box leaves one point) did no harm: it counts apart from the missed ones.
    """
    injected: Flags = trace.columns.get("injected", np.zeros(len(trace), dtype=np.bool_))
    injected = injected & (trace.fault != "stopped")
    refused = ~np.isin(trace.fault, ("none", "stopped"))
    taken = injected & ~refused
    right: Flags = trace.columns.get("verified", np.zeros(len(trace), dtype=np.bool_))
    return {
        "injected": int(np.count_nonzero(injected)),
        "detected": int(np.count_nonzero(injected & refused)),
        "harmless": int(np.count_nonzero(taken & right)),
        "missed": int(np.count_nonzero(taken & ~right)),
        "false_alarms": int(np.count_nonzero(~injected & np.isin(trace.fault, COMPLAINTS))),
    }


def recovery(trace: Trace, free: Trace, case: Case | None, ended: str) -> float | None:
    """Return the seconds from the fault's end (its start, if it lasts) until both errors stay below 1.2 of their level.

    None where the run was stopped, or ends above that level.
    """
    if ended != "completed" or len(trace) != len(free):
        return None
    if case is None:
        return 0.0
    period = float(trace.t_s[1] - trace.t_s[0])
    width = max(1, round(SMOOTH_S / period))
    since = case.from_s if case.until_s is None else case.until_s
    last = since
    for column in ("tip_error_m", "rcm_error_m"):
        now, level = (smooth(run.columns[column], width) for run in (trace, free))
        above = np.flatnonzero((now > RECOVERED * level + RESOLUTION_M) & (trace.t_s >= since))
        if above.size:
            if above[-1] == len(trace) - 1:
                return None
            last = max(last, float(trace.t_s[above[-1]]) + period)
    return last - since


def smooth(values: Array, width: int) -> Array:
    """Return the mean of the last ``width`` values, (N,); of fewer at the beginning."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    end = np.arange(1, len(values) + 1)
    begin = np.maximum(end - width, 0)
    mean: Array = (total[end] - total[begin]) / (end - begin)
    return mean
