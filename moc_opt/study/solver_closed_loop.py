"""The parts of the solver study in closed loop: every solver in the controller on the same trials, and the sweeps.

A sweep varies one setting: the accuracy of a solver, rho, the box, or the budget of a solve. The sweeps also tell
whether a solver's residuals in open loop predict what it does to the robot.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from moc_opt.arrays import Array
from moc_opt.figures import time_series
from moc_opt.inputs.names import file_stem
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario
from moc_opt.study.look import add_look
from moc_opt.study.results import ERRORS, FRAMES, Results, change_name
from moc_opt.study.show import Picture, Section, columns
from moc_opt.study.solver_answers import Problems, ask
from moc_opt.study.solver_settings import SolverSetting
from moc_opt.study.solver_verdicts import CLOSED, COSTS, both_frames
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
    work.times |= {name: np.concatenate([run.columns["solve_us"] for run in runs]) for name, runs in timed.items()}
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


# --- sweeps ---

UNCHECKED: dict[str, Any] = {"supervisor": {"check": False}}
"""Without the supervisor's check of residuals the arm follows the answer as it is, not what would replace it."""
FALLBACKS = ("least-violation", "damping", "hold")  # of an infeasible subproblem; the default first
LATE = ("hold", "zero", "iterate")  # what answers a solve that comes too late
OPEN_FIGURES = {"primal_p50": "median primal residual", "relative_p50": "median relative residual",
                "loss_p50": "median self-motion loss"}  # fmt: skip


@dataclass(frozen=True)
class Point:
    """One value of what is swept: its label, the changed tables of a trial, and the solver with its options.

    Accuracy sweeps ask it in open loop, too.
    """

    label: str
    value: float
    solver: str = "exact"
    options: Mapping[str, Any] = field(default_factory=dict)
    changes: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Sweep:
    """A family of points, loosest first."""

    name: str
    about: str
    points: Sequence[Point]
    accuracy: bool = False


def accuracy(solver: str, option: str, values: Sequence[float], about: str, name: str = "", **fixed: Any) -> Sweep:
    """Sweep an option of one solver from loose to tight."""
    points = [
        Point(f"{option}={value:g}", float(value), solver, {**fixed, option: value}, {"control": UNCHECKED})
        for value in values
    ]
    return Sweep(name or f"{solver}.{option}", about, points, True)


def accuracy_sweeps(full: bool) -> list[Sweep]:
    """Sweep tolerances, iterations and steps; costs unscaled, so that tolerances hold for the cost itself."""
    powers = [10.0**-k for k in range(1, 10)] if full else [1e-1, 1e-5, 1e-9]
    steps = [1, 2, 3, 5, 10, 20, 30, 50, 100, 200, 300] if full else [1, 3, 10, 30, 100]
    tolerance = "tolerance on the unscaled cost, five rows"
    libraries = ("osqp", "proxqp", "piqp", "clarabel")
    found = [accuracy(name, "eps", powers, tolerance, cost_scale=1.0) for name in libraries]
    found += [
        accuracy("osqp", "max_iter", [1, 3, 10, 30, 100] if full else [1, 100], "stopped after so many iterations",
                 check_termination=1),
        accuracy("daqp", "primal_tol", powers, "primal tolerance on the unscaled cost, five rows", cost_scale=1.0),
        accuracy("rnn", "steps", steps, "inner steps a tick, explicit"),
    ]  # fmt: skip
    if full:
        about = "inner steps a tick, semi-implicit"
        found.append(accuracy("rnn", "steps", steps, about, "rnn.steps semi-implicit", method="semi-implicit"))
    return found


def damping_sweep(full: bool) -> Sweep:
    """Sweep rho from 0, the paper's, up: from a vertex that chatters to an answer that does not move."""
    values = [0.0, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2] if full else [0.0, 1e-6, 1e-5, 1e-4, 1e-3]
    points = [Point(f"rho={v:g}", v, changes={"control": {"regularization": v}}) for v in values]
    return Sweep("damping", "rho with c2 = 1e-3, solver exact", points)


def box_sweep(full: bool) -> Sweep:
    """Sweep k0 from the paper's 0.1 up, and in the narrow boxes what replaces an infeasible subproblem's answer."""
    values = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0] if full else [0.1, 0.5, 2.0, 5.0]
    points = [
        Point(f"k0={v:g} {fallback}", v, changes={"control": {"k0_per_s": v, "fallback": fallback}})
        for v in values for fallback in (FALLBACKS if full or v == values[0] else FALLBACKS[:1])
    ]  # fmt: skip
    return Sweep("k0", "velocity damper and fallback, solver exact", points)


def deadline_sweep(name: str, recorded_us: Array, shares: Sequence[float]) -> Sweep:
    """Sweep a budget that so many percent of the recorded times exceed, and what replaces a late answer.

    The times are replayed tick by tick, so that the run can be repeated exactly.
    """
    times = [round(float(t), 3) for t in recorded_us[np.isfinite(recorded_us)]]
    points = []
    for share in shares:
        budget = max(float(np.percentile(times, 100.0 - share)), 1e-3)
        for late in LATE:
            changes = {"solver": {"replay_us": times}, "control": {"supervisor": {"budget_us": budget, "late": late}}}
            points.append(Point(f"{share:g}% late, {late}", share, name, changes=changes))
    return Sweep(f"deadline.{name}", f"recorded times of {name} against a budget", points)


def sweeps(work: Work) -> None:
    """Run every point of every sweep on the same trials, and the accuracy sweeps' points in open loop."""
    part, full = work.config.sweeps, work.config.sweeps.values == "many"
    starts, lost = work.study.placed(work.config.cases(part.duration_s)[: part.trials])
    work.runs.add(*({**row, "group": "sweeps"} for row in lost))
    chosen = [*accuracy_sweeps(full), damping_sweep(full), box_sweep(full)]
    if part.values == "few":
        chosen = [Sweep(one.name, one.about, one.points[::3], one.accuracy) for one in chosen]
    chosen = [one for one in chosen if one.points[0].solver in work.names]
    chosen += _deadlines(work, starts)
    base = [Trial(case, BASELINE, tags={"group": "sweeps"}) for case in starts]
    asked = [
        Trial(case.change(**point.changes), point.solver, {**work.config.settings.get(point.solver, {}),
              **point.options}, {"group": sweep.name, "point": point.label})
        for sweep in chosen for point in sweep.points for case in starts
    ]  # fmt: skip
    rows = Results(run.row for run in work.study.trials([*base, *asked], "sweeps"))
    data = Problems.recorded("recorded", work.sequence())
    accurate = {
        (sweep.name, point.label): SolverSetting(point.solver, f"{sweep.name} {point.label}", point.options, "")
        for sweep in chosen if sweep.accuracy for point in sweep.points
    }  # fmt: skip
    limits = work.config.testsets.limits()
    answers = ask(work.runner("accuracy"), [(setting, data) for setting in accurate.values()], limits)
    opened = {key: one.summary() for key, one in zip(accurate, answers, strict=True) if not one.refused}
    closed = dict[tuple[str, str], dict[str, Any]]()
    for sweep in chosen:
        found = work.summary.setdefault(f"sweep {sweep.name}", {})
        for point in sweep.points:
            mine = rows.where(group=sweep.name, point=point.label)
            both = Results([*mine, *rows.where(group="sweeps")])
            found[point.label] = closed[sweep.name, point.label] = {"value": point.value, **figures(both, point.solver)}
    begins = {sweep.name: cost_begins(work.summary[f"sweep {sweep.name}"]) for sweep in chosen if sweep.accuracy}
    work.summary["cost_begins"] = begins
    work.summary["prediction"] = correlations(opened, closed)
    work.runs.add(*rows)
    work.sections += _sections(chosen, work.summary, len(starts))


def _deadlines(work: Work, starts: Sequence[Scenario]) -> list[Sweep]:
    """Return sweeps over recorded times; the recording is one timed run, which is kept as a file, too."""
    found = []
    for name in (name for name in work.config.sweeps.deadline_solvers if name in work.names):
        times = work.times.get(name)
        if times is None and starts:
            asked = Trial(starts[0], name, work.config.settings.get(name, {}), timed=True, keep="curves")
            (run,) = work.study.trials([asked], "recording")
            times = run.columns.get("solve_us")
        if times is not None:
            work.study.out.mkdir(parents=True, exist_ok=True)
            np.save(work.study.out / f"solve_us_{file_stem(name)}.npy", times)
            found.append(deadline_sweep(name, times, work.config.sweeps.late_percent))
    return found


def cost_begins(points: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Return metric -> label of the loosest value from which on every tighter one is as good as the tightest."""
    labels, found = list(points), dict[str, str]()
    for metric, cost in COSTS.items():
        values = [points[label].get(metric) for label in labels]
        start, last = len(labels) - 1, values[-1]
        if not last:
            continue
        while start > 0 and (v := values[start - 1]) is not None and abs(v / last - 1.0) <= cost.equal:
            start -= 1
        found[metric] = labels[start]
    return found


Figures = Mapping[Any, Mapping[str, Any]]


def correlations(opened: Figures, closed: Figures) -> dict[str, dict[str, Any]]:
    """Compute Spearman's rank correlation of each open-loop residual with each closed-loop figure.

    Both are ranked from good to bad: +1 where what is better in open loop is better in closed loop. Closed-loop
    figures that differ by less than what counts as equal share a rank, so that noise decides none.

    Returns:
        "open ~ closed" -> {rank_correlation, p_value, solvers, open, closed}; pairs without spread are left out.
    """
    found = {}
    for one in OPEN_FIGURES:
        for other, cost in COSTS.items():
            names = [n for n in opened if opened[n].get(one) is not None and closed.get(n, {}).get(other) is not None]
            a = np.array([opened[n][one] for n in names])
            b = np.array([closed[n][other] for n in names])
            b = np.round(np.log(b) / np.log1p(cost.equal)) * (-1.0 if cost.more_is_better else 1.0)
            if len(names) < 4 or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
                continue
            result = stats.spearmanr(a, b)
            found[f"{one} ~ {other}"] = {
                "rank_correlation": float(result.statistic), "p_value": float(result.pvalue), "solvers": len(names),
                "open": OPEN_FIGURES[one], "closed": cost.word,
            }  # fmt: skip
    return found


def predicted(found: Figures, trials: int) -> str:
    """Say what the correlations mean; of too few trials nothing is claimed."""
    if not found:
        return "Too few settings ran in both parts for a rank correlation."
    if few := too_few(trials):
        return f"Whether open loop predicts closed loop: {few}."
    said = []
    for cost in COSTS.values():
        mine = [entry for entry in found.values() if entry["closed"] == cost.word]
        if not mine:
            continue
        best = max(mine, key=lambda entry: abs(entry["rank_correlation"]))
        r = best["rank_correlation"]
        if best["p_value"] > 0.05:
            said.append(f"{cost.word}: no residual of open loop predicts it (the closest: {r:+.2f})")
        else:
            worse = "" if r > 0.0 else ", the wrong way round: the more accurate answers are the worse ones"
            said.append(f"{cost.word}: it follows the {best['open']} (rank correlation {r:+.2f}{worse})")
    return "; ".join(said) + "."


def _sections(chosen: Sequence[Sweep], summary: Mapping[str, Any], trials: int) -> list[Section]:
    limits = ", ".join(f"{cost.word} {100 * cost.equal:g} %" for cost in COSTS.values())
    begins = [
        {"sweep": name, **{COSTS[metric].word: label for metric, label in found.items()}}
        for name, found in summary["cost_begins"].items()
    ]  # fmt: skip
    words = [cost.word for cost in COSTS.values()]
    parts = [Table("From which setting on inaccuracy costs nothing", [Column("sweep", "sweep"), *(
        Column(word, word) for word in words)], [] if too_few(trials) else begins,
        too_few(trials) or f"Means over {trials} trials are as good as those of the tightest setting, within {limits}.",
    )]  # fmt: skip
    for sweep in chosen:
        rows = [
            {"label": label, **row, **_texts(row), "tip": both_frames(row, "tip"), "rcm": both_frames(row, "rcm"),
             "infeasible_percent": 100.0 * row.get("infeasible", 0) / max(1, row.get("ticks", 0)),
             "late_percent": 100.0 * row.get("fault_late", 0) / max(1, row.get("ticks", 0))}
            for label, row in summary[f"sweep {sweep.name}"].items()
        ]  # fmt: skip
        shown = [
            Column("label", "value"), Column("whole", "whole trials"), Column("mu_gain_percent", "mu", unit="%"),
            Column("tip", "tip own/ patient", unit="%"), Column("rcm", "RCM own/ patient", unit="%"),
            *columns("mu_mean", "mu_fraction_of_bound", "tip_error_model_mean_mm", "rcm_error_model_mean_mm",
                     "torque_rate_rms_Nm_per_s", "silently_wrong", "primal_max", "loss_max", "oscillated"),
            Column("infeasible_percent", "infeasible", unit="% of ticks"),
            Column("late_percent", "late", unit="% of ticks"),
        ]  # fmt: skip
        parts.append(Table(f"Sweep {sweep.name}: {sweep.about}", shown, rows, "Changes against DCAC."))
    pairs = Table(
        "Rank correlation of open loop with closed loop",
        [Column("open", "open loop"), Column("closed", "closed loop"),
         Column("rank_correlation", "Spearman", format="+.2f"), Column("p_value", "p", digits=2),
         Column("solvers", "settings")], list(summary["prediction"].values()),
        "Both ranked from good to bad: +1 where what is better in open loop is better in closed loop.",
    )  # fmt: skip
    return [
        Section("Where inaccuracy begins to cost", "Accuracy sweeps run without the supervisor's check of residuals, "
                "so that the arm follows the answer as it is. In deadline sweeps a late answer is replaced by the last "
                "good one (hold), by rest (zero), or by the iterate that the solver has when its budget ends.", parts),
        Section("Does open loop predict closed loop?", predicted(summary["prediction"], trials), [pairs]),
    ]  # fmt: skip
