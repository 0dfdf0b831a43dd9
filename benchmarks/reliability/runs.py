"""One controller on one trial under every fault, compared with its own run without any."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moc_opt.arrays import Array
from moc_opt.errors import MocOptError
from moc_opt.inputs.settings import Settings
from moc_opt.scenario import Scenario, Setup
from moc_opt.sim.record import RunAway
from moc_opt.study import Failed
from moc_opt.tasks import Reference
from moc_opt.tasks.waiting import WaitingReference
from moc_opt.trace.meta import Ending
from moc_opt.trace.trace import Trace

BASELINE = "dcac"
PICTURED = ("none", "bump-30N", "trocar-slips", "nan-lasting")
"""Cases whose traces are drawn, of `exact` on the first trial."""
SMOOTH_S = 0.2  # errors are averaged over so long before they are compared with the run without a fault
RECOVERED = 1.2  # times the level without a fault
RESOLUTION_M = 5e-5  # half an encoder step at the end of the arm: less is no difference
COMPLAINTS = ("failed", "raised", "malformed", "not_finite", "outside", "lied", "late", "lost")
"""Faults that a supervisor names when a solver misbehaves; "infeasible" is an honest answer."""


class Case(Settings):
    """One fault: its changes of a scenario, and the time in which it acts."""

    KIND: ClassVar[str] = "[cases]"
    group: Literal["solver", "sensors", "plant", "contact", "camera"]
    faults: dict[str, Any] = Field(default_factory=dict)
    plant: dict[str, Any] = Field(default_factory=dict)
    trocar: dict[str, Any] = Field(default_factory=dict)
    camera_lost_s: tuple[float, float] | None = Field(
        None, description="the board is out of sight from .. until; the tip waits meanwhile"
    )
    from_s: float = Field(0.0, ge=0.0)
    until_s: float | None = Field(None, ge=0.0, description="None: it lasts")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.until_s is not None and self.until_s < self.from_s:
            raise ValueError(f"until_s = {self.until_s} is before from_s = {self.from_s}: exchange them")
        return self

    def corrupt(self, scenario: Scenario) -> Scenario:
        """Return the scenario with this fault in it."""
        return scenario.change(faults=self.faults, plant=self.plant, trocar=self.trocar)


@dataclass(frozen=True)
class Job:
    """One controller on one trial, with the faults to inject."""

    controller: str
    trial: int
    scenario: Scenario
    cases: Mapping[str, Case]
    limits_mm: tuple[float, float]  # tip, RCM

    def row(self, name: str, ended: str) -> dict[str, Any]:
        group = self.cases[name].group if name in self.cases else "none"
        return {"case": name, "group": group, "solver": self.controller, "trial": self.trial, "ended": ended}


@dataclass
class Outcome:
    """The results of a job: one row per case, the run without a fault first."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    traces: dict[str, Trace] = field(default_factory=dict)


def run_job(job: Job) -> Outcome:
    """Run all cases of a job."""
    out = Outcome()
    free, ended = run_case(job.scenario, None)
    if free is None:
        raise MocOptError(f"{job.controller}: the run without a fault did not start: {ended}")
    waiting: Trace | None = None
    for name, case in {"none": None, **job.cases}.items():
        level = free
        trace, how = (free, ended) if case is None else run_case(case.corrupt(job.scenario), case.camera_lost_s)
        if case is not None and case.camera_lost_s is not None:
            # A path that may wait starts gently, so it is compared with one that never has to.
            waiting = run_case(job.scenario, (0.0, 0.0))[0] if waiting is None else waiting
            level = free if waiting is None else waiting
        out.rows.append(job.row(name, how) | measure(trace, level, how, case, job.limits_mm))
        if name in PICTURED and (job.controller, job.trial) == ("exact", 0) and trace is not None:
            out.traces[name] = trace
    return out


def lost_job(job: Job, failed: Failed) -> Outcome:
    """Return a job that gave no result: every case is a row with the reason."""
    return Outcome([job.row(name, str(failed)) | {"outcome": "refused"} for name in ("none", *job.cases)])


class Waited(Reference):
    """A reference whose path waits while the board is out of sight."""

    rows_played: Array

    def __init__(self, reference: Reference, times: Array, lost_s: tuple[float, float]) -> None:
        super().__init__(reference.path, reference.v_max, reference.a_max, reference.t_start)
        seen = (times < lost_s[0]) | (times >= lost_s[1])
        played, _ = WaitingReference(reference, float(times[1] - times[0])).play(seen)
        object.__setattr__(self, "rows_played", played)

    def at(self, t: Any) -> tuple[Array, Array, Array]:
        """Return the point, velocity, acceleration, (k, 3) each, of the first k ticks."""
        x, dx, ddx = np.swapaxes(self.rows_played[: len(t)], 0, 1)
        return x, dx, ddx


def run_case(scenario: Scenario, camera_lost_s: tuple[float, float] | None) -> tuple[Trace | None, str]:
    """Return the trace as far as it goes, and how the run ended."""
    try:
        setup = Setup(scenario)
        if camera_lost_s is not None:
            setup.reference = Waited(setup.reference, setup.times(), camera_lost_s)
        trace = setup.trace()
    except RunAway as error:
        trace = error.trace
    except MocOptError as error:
        return None, f"refused: {type(error).__name__}: {error}"
    return trace, str(trace.meta["ended"])


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
    coast = 1e3 * np.linalg.norm(whole.tip_m[len(trace) - 1 :] - whole.tip_m[len(trace) - 1], axis=1)
    found: dict[str, Any] = {
        "outcome": outcome, "ticks": len(whole), "stopped_at_s": stopped_at,
        "stop_travel_mm": None if stopped_at is None else float(coast.max()),
        "tip_error_max_mm": float(tip.max()), "rcm_error_max_mm": float(rcm.max()),
        "tip_error_mean_mm": float(tip.mean()), "rcm_error_mean_mm": float(rcm.mean()),
        "trocar_force_max_N": float(np.linalg.norm(whole.trocar_force_N, axis=1).max()),
        "last_speed_rad_per_s": float(np.abs(whole.v_rad_per_s[-1]).max()),
        "recover_s": recovery(trace, free, case, ended),
    }  # fmt: skip
    if outcome == "survived":
        found["rcm_mean_percent"] = 100.0 * (found["rcm_error_mean_mm"] / (1e3 * free.rcm_error_m.mean()) - 1.0)
        found["rcm_max_percent"] = 100.0 * (found["rcm_error_max_mm"] / (1e3 * free.rcm_error_m.max()) - 1.0)
    return found | (detection(whole) if "fault" in whole.columns else {})


def detection(trace: Trace) -> dict[str, int]:
    """Count injected solver faults, those that were refused, and those that were not.

    An answer that was corrupted, was taken, and is verified as the optimum all the same (the opposite gradient can
    have the same optimum, where the box leaves one point) did no harm: it counts apart from the missed ones.
    """
    never: NDArray[np.bool_] = np.zeros(len(trace), dtype=np.bool_)
    injected = trace.columns.get("injected", never) & (trace.fault != "stopped")
    refused = ~np.isin(trace.fault, ("none", "stopped"))
    taken, right = injected & ~refused, trace.columns.get("verified", never)
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
