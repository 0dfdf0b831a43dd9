"""The part of the solver study in closed loop: every solver in the controller on the same trials."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from moc_opt.figures import time_series
from moc_opt.report.tables import Column, Table
from moc_opt.study.look import REPLAY, add_look
from moc_opt.study.results import ERRORS, FRAMES, Results, change_name
from moc_opt.study.show import Picture, Section, columns
from moc_opt.study.solver_verdicts import CLOSED, COSTS
from moc_opt.study.statistics import spread, too_few
from moc_opt.study.timing import Disturbance, percentiles
from moc_opt.study.trials import BASELINE, Run, Trial
from moc_opt.trace.meta import Ending

if TYPE_CHECKING:
    from moc_opt.study.solvers import Work

MEANS = (
    "mu_mean", "mu_fraction_of_bound", "mu_fraction_of_best_from_start", "mu_fraction_of_best", *ERRORS,
    "trocar_force_mean_N", "torque_rate_rms_Nm_per_s",
)  # fmt: skip
CHANGES = tuple(name for name in COSTS if name != "torque_rate_rms_Nm_per_s")
SUMS = ("ticks", "asked", "infeasible", "fault_late", "claimed_solved", "verified_solved", "silently_wrong")
LARGEST = ("primal_max", "natural_max", "loss_max", "tip_error_model_max_mm", "rcm_error_model_max_mm")
COUNTED = (
    "claimed_solved", "verified_solved", "silently_wrong", "infeasible", "loss_max", "tip_error_model_max_mm",
    "rcm_error_model_max_mm", "oscillated",
)  # fmt: skip


def figures(
    rows: Results, controller: str, timed: Sequence[Run] = (), common: Container[str] | None = None
) -> dict[str, Any]:
    """Return what the summary holds of a controller: means and changes over its whole runs, sums and largest values.

    Args:
        rows: of the controller and the baseline.
        controller: whose.
        timed: its runs that ran alone, whose times are pooled.
        common: the trials that every solver runs, None for all: only there are its endings held against a solver, as
            others may end alike on a trial that they do not run.
    """
    found = rows.figures(controller, MEANS, CHANGES)
    mine = [row for row in rows if row["controller"] == controller]
    judged = [row for row in mine if common is None or row["trial"] in common]
    found["broke_off_in_common"] = sum(not row["whole"] for row in judged)
    for name, of in (("oscillated", mine), ("oscillated_in_common", judged)):
        found[name] = sum(Ending.of(row["ended"]) is Ending.OSCILLATED for row in of)
    for names, total in ((SUMS, sum), (LARGEST, max)):
        for name in names:
            if values := [row[name] for row in mine if row.get(name) is not None]:
                found[name] = total(values)
    load = sum((run.load for run in timed), Disturbance())
    if load.calls:
        found |= {**load.entries(), "timed_runs": len(timed)}
        found["deadline_misses"] = load.judged(sum(run.row["deadline_misses"] for run in timed), 99.9)
        for name in ("solve", "tick"):
            times = [run.columns[f"{name}_us"] for run in timed if f"{name}_us" in run.columns]
            found |= percentiles(np.concatenate([np.empty(0), *times]), name, load)
    return found


def closed_loop(work: Work) -> None:
    """Run every solver in the controller, and the baseline, on its trials: first those that all of them run."""
    part = work.config.closed_loop
    cases = work.config.cases()
    number = {case.name: k for k, case in enumerate(cases)}
    starts, lost = work.study.placed(cases)
    work.runs.add(*lost)
    names = [BASELINE, *(name for name in work.names if name not in part.slow)]
    timed = dict[str, list[Run]]()
    few = min(part.others, part.trials)
    common = [case.name for case in cases[:few]]
    for first, last in ((0, few), (few, part.trials)):
        chosen = [case.change(best_courses=True) for case in starts if first <= number[case.name] < last]
        asked = [
            Trial(case, name, work.config.settings.get(name, {}), timed=number[case.name] < part.timed,
                  keep="poses" if number[case.name] < part.timed else "row")
            for case in chosen for name in names if number[case.name] < part.of(name)
        ]  # fmt: skip
        runs = work.study.trials(asked, f"closed loop, trials {first + 1} to {last}", keep=_trusted) if asked else []
        for run in runs:
            if run.row["timed"] and run.columns:
                timed.setdefault(run.row["controller"], []).append(run)
        work.runs.add(*(run.row for run in runs))
        work.summary["closed_loop"] = {
            name: figures(work.runs, name, timed.get(name, []), common) for name in names
        }  # fmt: skip
        work.say()
    work.files += [REPLAY] if timed else []
    first_runs = {name: runs[0] for name, runs in timed.items() if runs[0].row["trial"] == cases[0].name}
    work.sections.append(_section(work, {name: run for name, run in first_runs.items() if run.trace is not None}))


def _trusted(run: Run) -> bool:
    """Tell whether a run may be kept: times that other work has spoilt are taken again."""
    return not run.row.get("timed") or run.load.trusts(99.0)


def _section(work: Work, seen: Mapping[str, Run]) -> Section:
    part, rows = work.config.closed_loop, work.summary["closed_loop"]
    changes = {
        change_name(name): f"change of {cost.word}" for name, cost in COSTS.items() if name in CHANGES
    }  # fmt: skip
    shown = [{"solver": name, **row, **_texts(row)} for name, row in rows.items()]
    table = Table(
        "The same trials under every controller",
        [Column("solver", "controller"), Column("trials", "trials"), Column("whole", "whole"),
         *(Column(key, title, unit="%") for key, title in changes.items()), *columns(*MEANS), *columns(*COUNTED),
         *(Column(f"tick_{p}_us", f"tick {p.replace('_', '.')}", unit="us", format=".1f")
           for p in ("p50", "p99", "p99_9")), Column("deadline_misses", "misses", format=".0f")],
        shown, "Changes against DCAC on the trials that both ran: of the mean, with 95 % intervals. " + FRAMES,
    )  # fmt: skip
    length = f"the first {part.duration_s:g} s of its task" if part.duration_s else "its whole task"
    traces = {name: trace for name, run in seen.items() if (trace := run.trace) is not None}
    trial = next((str(run.row["trial"]) for run in seen.values()), "")
    parts: list[Table | Picture] = [table]
    if traces:
        says = f"Trial {trial}: manipulability, tip error, RCM error and trocar force over time."
        parts.append(Picture(time_series(traces), says, "trial"))
    robot, out = work.config.scenario.robot.arm(), work.study.out
    return Section(
        CLOSED, f"Each trial has a seed of its own, which draws pose, mismatch and noise, and shows {length}.", parts,
        (lambda page: add_look(page, out, robot, traces, trial)) if traces else lambda page: None,
    )  # fmt: skip


def _texts(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the changes as texts with their intervals, or why there is no verdict."""
    few = too_few(row.get("compared", 0))
    return {name: few or spread(row, name) for name in map(change_name, CHANGES) if name in row}
