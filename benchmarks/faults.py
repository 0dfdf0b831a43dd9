"""What happens when something breaks? Every run is compared with the same run without a fault.

python -m benchmarks.faults [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json]
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, ClassVar, Literal, Self

import numpy as np
import polars as pl
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from benchmarks.goals import Goal, goals_sentence, goals_table, judge
from moc_opt import figures
from moc_opt.arrays import Array
from moc_opt.errors import MocOptError
from moc_opt.inputs.settings import Name, Settings
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario, Setup
from moc_opt.sim.record import RunAway
from moc_opt.study import Failed, Job
from moc_opt.study.command import Found, Study, StudyConfig, command, runnable
from moc_opt.study.results import Results
from moc_opt.study.show import Picture, Report, Section, about
from moc_opt.study.trials import BASELINE, variant
from moc_opt.tasks import Reference
from moc_opt.tasks.timelaw import WaitingReference
from moc_opt.trace.meta import Ending
from moc_opt.trace.trace import Trace

PICTURED = ("none", "bump-30N", "trocar-slips", "nan-lasting")
CURVES = ("t_s", "tip_error_m", "rcm_error_m", "trocar_force_N")
SMOOTH_S, RECOVERED, RESOLUTION_M = 0.2, 1.2, 5e-5
"""A run has recovered once its errors (means over 0.2 s) stay below 1.2 e + 0.05 mm. Here e is the error, at the same
time, of the run without the fault."""
COMPLAINTS = ("failed", "raised", "malformed", "not_finite", "outside", "lied", "late", "lost")
"""Reasons to refuse an answer as faulty. "infeasible" is not among them, because it can be the right answer."""
OUTCOMES = ("survived", "stopped", "oscillated", "diverged", "ran away", "refused", "failed")
WORST = (
    "tip_error_max_mm", "rcm_error_max_mm", "trocar_force_max_N", "rcm_mean_percent", "rcm_max_percent",
    "stop_travel_mm", "last_speed_rad_per_s",
)  # fmt: skip
COUNTS = ("injected", "detected", "harmless", "missed", "false_alarms", "ticks")
AT_REST_RAD_PER_S, RCM_LIMIT_PERCENT, FALSE_ALARMS_PERCENT = 0.05, 5.0, 1.0
EVERY, SOLVERS = "Every fault", "Solver faults"
CASES = [
    Column("case", "fault"), Column("controller", "controller"),
    Column("outcome", "outcome", help="how the runs ended, counted over the trials"),
    Column("tip_error_max_mm", "worst tip", unit="mm", format=".2f", help="largest tip error up to the stop or end"),
    Column("rcm_error_max_mm", "worst RCM", unit="mm", format=".2f", help="largest RCM error, also during a stop"),
    Column("trocar_force_max_N", "worst force", unit="N", format=".2f"),
    Column("rcm_mean_percent", "mean RCM", unit="%", format="+.1f", help="change of the mean RCM error by the fault"),
    Column("recover_s", "recovered after", unit="s", format=".2f", help="time from the fault's end until tip and RCM "
           "error stay below 1.2 e + 0.05 mm (e: error without the fault). For a lasting fault: from its start"),
    Column("stop_travel_mm", "stop travel", unit="mm", format=".1f", help="motion of the tip after the stop began"),
]  # fmt: skip
SEEN = [
    Column("case", "fault"), Column("controller", "controller"), Column("injected", "injected", format=".0f"),
    Column("detected", "detected", format=".0f"),
    Column("harmless", "harmless", format=".0f", help="corrupted answers that were used, but are optimal"),
    Column("missed", "missed", format=".0f"),
    Column("false_alarms", "false alarms", format=".0f", help="answers that were refused without an injected fault"),
]  # fmt: skip


class Case(Settings):
    KIND: ClassVar[str] = "[cases]"
    group: Literal["none", "solver", "sensors", "plant", "contact", "camera"]
    faults: dict[str, Any] = Field(default_factory=dict)
    plant: dict[str, Any] = Field(default_factory=dict)
    trocar: dict[str, Any] = Field(default_factory=dict)
    camera_lost_s: tuple[float, float] | None = None
    """interval [s] in which the camera does not see the board, so that the tip waits"""
    from_s: float = Field(0.0, ge=0.0)
    until_s: float | None = Field(None, ge=0.0, description="None if the fault acts until the end")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.until_s is not None and self.until_s < self.from_s:
            raise ValueError(f"until_s = {self.until_s} is before from_s = {self.from_s}: exchange them")
        return self

    def corrupt(self, scenario: Scenario) -> Scenario:
        return scenario.change(faults=self.faults, plant=self.plant, trocar=self.trocar)


FREE = {"none": Case(group="none")}
"""The case without a fault. It runs first, because the other cases are compared with it."""


class Config(StudyConfig):
    trials: int = Field(2, ge=1)
    solvers: list[str] = Field(["exact", "osqp", "rnn"], min_length=1)
    tip_limit_mm: float = Field(20.0, gt=0.0)
    rcm_limit_mm: float = Field(20.0, gt=0.0)
    scenario: Scenario = Scenario()
    cases: dict[Name, Case] = Field(min_length=1)

    @field_validator("cases")
    @classmethod
    def _fit_a_scenario(cls, cases: dict[str, Case]) -> dict[str, Case]:
        for case in cases.values():
            case.corrupt(Scenario())
        if FREE.keys() & cases.keys():
            raise ValueError("'none' is the name of the run without a fault: choose another name")
        return cases

    def quick(self) -> Self:
        short = self.scenario.change(duration_s=min(3.2, self.scenario.duration_s or 3.2))
        return self.model_copy(update={"trials": 1, "scenario": short})

    def scenarios(self) -> list[Scenario]:
        return [self.scenario.change(name=f"trial {k}", seed=self.seed + k) for k in range(self.trials)]


@dataclass(frozen=True)
class Block:
    controller: str
    trial: Scenario
    cases: Mapping[str, Case]
    limits_mm: tuple[float, float]  # tip, RCM
    pictured: bool = False

    def row(self, name: str, ended: str) -> dict[str, Any]:
        about = {"case": name, "group": self.cases[name].group, "controller": self.controller}
        return {**about, "trial": self.trial.name, "seed": self.trial.seed, "ended": ended}


def work(study: Study, config: Config) -> Found:
    runnable(config.solvers)
    limits, cases = (config.tip_limit_mm, config.rcm_limit_mm), {**FREE, **config.cases}
    sound = {name: case for name, case in cases.items() if case.group != "solver"}  # DCAC has no solver that could fail
    blocks = [
        Block(name, variant(trial, name), sound if name == BASELINE else cases, limits, (name, k) == ("exact", 0))
        for k, trial in enumerate(config.scenarios()) for name in (BASELINE, *config.solvers)
    ]  # fmt: skip
    rows, traces = Results(), dict[str, Trace]()
    jobs = [Job(run_block, (block,), 60.0 * len(block.cases)) for block in blocks]
    for block, done in zip(blocks, study.run(jobs, "controllers"), strict=True):
        if isinstance(done, Failed):
            why = {"outcome": "failed", "error": str(done)}
            rows.add(*({**block.row(name, "failed"), **why} for name in block.cases))
        else:
            rows.add(*done[0])
            traces |= {name: Trace(columns) for name, columns in done[1].items()}
    found, by_case = worst(rows), dict[str, dict[str, Any]]()
    for row in found:
        by_case.setdefault(row["case"], {})[row["controller"]] = row
    goals = judge({"rows": found}, goals_of(cases))
    return Found(report(found, goals, traces, config), {"cases": by_case, "goals": goals}, rows)


def run_block(block: Block) -> tuple[list[dict[str, Any]], dict[str, dict[str, Array]]]:
    rows, curves = [], {}
    faultless: dict[bool, Trace | None] = {}
    for name, case in block.cases.items():
        trace, how = run_case(case.corrupt(block.trial), case.camera_lost_s)
        waits = case.camera_lost_s is not None
        # Even without a wait, a `Waited` reference starts more slowly than a `Reference`. So if the faulty run has a
        # `Waited` reference, the run without the fault has one, too. The latter does not wait.
        if waits not in faultless:
            faultless[waits] = run_case(block.trial, (0.0, 0.0))[0] if waits else trace
        if (free := faultless[waits]) is None:
            raise MocOptError(f"{block.controller}: the run without a fault did not start: {how}")
        rows.append(block.row(name, how) | measure(trace, free, how, case, block.limits_mm))
        if name in PICTURED and block.pictured and trace is not None:
            curves[name] = {column: trace.columns[column] for column in CURVES}
    return rows, curves


class Waited(Reference):
    rows_played: Array  # X_d, dX_d, ddX_d at each time, of a tip that waits while the camera is lost

    def __init__(self, reference: Reference, times: Array, lost_s: tuple[float, float]) -> None:
        super().__init__(reference.path, reference.v_max, reference.a_max, reference.t_start)
        seen = (times < lost_s[0]) | (times >= lost_s[1])
        played, _ = WaitingReference(reference, float(times[1] - times[0])).play(seen)
        object.__setattr__(self, "rows_played", played)

    def at(self, t: Any) -> tuple[Array, Array, Array]:
        x, dx, ddx = np.swapaxes(self.rows_played[: len(t)], 0, 1)
        return x, dx, ddx


def run_case(scenario: Scenario, camera_lost_s: tuple[float, float] | None) -> tuple[Trace | None, str]:
    """Return the trace (None if the scenario is refused) and how the run ended."""
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
    trace: Trace | None, free: Trace, ended: str, case: Case, limits_mm: tuple[float, float]
) -> dict[str, Any]:
    if trace is None:
        return {"outcome": "refused"}
    # Tip errors after a stop are left out, because the stopped tip does not follow its reference.
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
    """Count injected solver faults and false alarms.

    A falsified answer that was used is harmless if it is optimal, else missed.
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


def recovery(trace: Trace, free: Trace, case: Case, ended: str) -> float | None:
    """Return the time [s] from the fault's end (from its start, if the fault lasts) to the recovery, or None."""
    if ended != "completed" or len(trace) != len(free):
        return None
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
    return pl.Series(values).rolling_mean(width, min_samples=1).to_numpy()


def worst(rows: Results) -> list[dict[str, Any]]:
    """Return one row per case and controller: over the trials, the sum of each count and the worst of each figure."""
    found = []
    for case, name in product(rows.names("case"), rows.names()):
        if not (mine := list(rows.where(case=case, controller=name))):
            continue
        counts = {word: sum(row["outcome"] == word for row in mine) for word in OUTCOMES}
        there = [f"{n} {word}" if n < len(mine) else word for word, n in counts.items() if n]
        known = {key: [r[key] for r in mine if r.get(key) is not None] for key in (*WORST, *COUNTS, "recover_s")}
        recovered = len(known["recover_s"])
        if recovered < len(mine):
            known["recover_s"] = []
        found.append({
            "case": case, "controller": name, "group": mine[0]["group"], "outcome": ", ".join(there), "runs": len(mine),
            **{word.replace(" ", "_"): n for word, n in counts.items()}, "recovered": recovered,
            "ended": "; ".join(sorted({str(row["ended"]) for row in mine})),
            **{key: (sum if key in COUNTS else max)(values) for key, values in known.items() if values},
        })  # fmt: skip
    return found


def goals_of(cases: Mapping[str, Case]) -> dict[str, Goal]:
    shares = {name: case.faults.get("solver_share", 0.0) for name, case in cases.items() if case.group == "solver"}
    always = {name for name, share in shares.items() if share >= 1.0}
    seldom = set(shares) - always

    def total(*keys: str) -> Any:
        return lambda summary: sum(row.get(key, 0) for row in summary["rows"] for key in keys)

    def above(words: str, when: str, column: str, among: Collection[str]) -> Goal:
        def highest(summary: Any) -> Mapping[str, Any]:
            known = [row for row in summary["rows"] if row["case"] in among and column in row]
            return max(known, key=lambda row: row[column])

        return Goal(f"rise of the {words} RCM error if the solver is faulty {when}", "%", RCM_LIMIT_PERCENT,
                    lambda summary: highest(summary)[column], section=EVERY,
                    made_of=lambda summary: "{case}, {controller}".format(**highest(summary)))  # fmt: skip

    return {
        "diverged": Goal("runs that diverge and are not stopped", "", 0, total("diverged"), section=EVERY),
        "lost": Goal("runs that ran away, were refused or failed", "", 0,
                     total("ran_away", "refused", "failed"), section=EVERY),
        "missed": Goal("injected solver faults that were not noticed", "", 0, total("missed"), section=SOLVERS),
        "false_alarms": Goal(
            "answers refused without an injected fault", "% of all ticks", FALSE_ALARMS_PERCENT,
            lambda summary: 100.0 * total("false_alarms")(summary) / max(total("ticks")(summary), 1), section=SOLVERS),
        "mean_seldom": above("mean", "at some ticks", "rcm_mean_percent", seldom),
        "max_seldom": above("largest", "at some ticks", "rcm_max_percent", seldom),
        "mean_always": above("mean", "at every tick", "rcm_mean_percent", always),
        "rest": Goal("largest joint speed at the end of a stop", "rad/s", AT_REST_RAD_PER_S,
                     lambda summary: max(r["last_speed_rad_per_s"] for r in summary["rows"] if r["stopped"]),
                     section=EVERY),
    }  # fmt: skip


def report(
    rows: Sequence[Mapping[str, Any]], goals: Mapping[str, Any], traces: Mapping[str, Trace], config: Config
) -> Report:
    keys = ("runs", "survived", "stopped", "injected", "detected", "harmless")
    runs, survived, stopped, injected, detected, harmless = (sum(row.get(key, 0) for row in rows) for key in keys)
    answer = [
        f"Of {runs} runs, {survived} survived within the limits, {stopped} were stopped, and "
        f"{runs - survived - stopped} ended in another way.",
        f"Of {injected} injected solver faults, {detected} were detected"
        + (f"; {harmless} others left the answer optimal." if harmless else "."),
        goals_sentence(goals),
    ]
    says = "First trial of MOC with exact: after a fault, the errors and the trocar force fall again, or the arm stops."
    pictures = [Picture(figures.time_series(traces, CURVES[1:]), says, "faults")] if traces else []
    groups = {"none": "no fault", "sensors": "sensors and packets", "plant": "plant and delay",
              "contact": "bumps and trocar", "camera": "camera", "solver": "solvers"}  # fmt: skip
    tables = [
        Table(f"Worst of {config.trials} trials: {title}", CASES, mine)
        for group, title in groups.items() if (mine := [row for row in rows if row["group"] == group])
    ]  # fmt: skip
    seen = [row for row in rows if row["group"] == "solver"]
    limits = f"Survived: the run was completed with tip errors up to {config.tip_limit_mm:g} mm and RCM errors up to "
    limits += f"{config.rcm_limit_mm:g} mm. Diverged: the run was completed with larger errors."
    sections = [
        Section(EVERY, limits, tables),
        Section(SOLVERS, "", [Table("Solver faults, injected and detected", SEEN, seen)]),
    ]
    first = goals_table(goals)
    return Report(f"Every fault: {about(config.scenario)}", answer, first, pictures, sections)


main = partial(command, "faults", "MOC and DCAC under faults.", Config, work)

if __name__ == "__main__":
    sys.exit(main())
