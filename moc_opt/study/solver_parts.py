"""The parts of the solver study: a recorded sequence, certified sets, and closed loop."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from moc_opt.arrays import Array
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario, run
from moc_opt.solvers.base import Status
from moc_opt.solvers.exact import Exact
from moc_opt.study import timing
from moc_opt.study.results import BASE_FRAME, ERRORS, FRAMES, Results, change_name
from moc_opt.study.show import Section, columns
from moc_opt.study.solver_answers import RIGHTLY, Limits, ask, share_right, time, totals
from moc_opt.study.solver_settings import SolverSetting, effective, in_words
from moc_opt.study.solver_verdicts import CERTIFIED, CLOSED, COSTS, INCONSISTENT, RECORDED
from moc_opt.study.statistics import spread, too_few
from moc_opt.study.testsets import TestSet
from moc_opt.study.timing import percentiles
from moc_opt.study.trials import BASELINE, Run, Trial, placed
from moc_opt.trace.meta import Ending

if TYPE_CHECKING:
    from moc_opt.study.solvers import Work

MEANING = (
    "Verified: optimal by moc_opt's residuals, whatever the solver says. Silently wrong: claimed as solved, but not "
    "verified. Right: verified, or rightly called infeasible. Problems that were refused as inconsistent do not count. "
    f"Times are compared among solvers with at least {100 * RIGHTLY:g} % right answers. Cold: the first solve of a "
    "session. Update: the part of a later solve that passes the new problem to the library. docs/solvers.md says more."
)
SOLVER = Column("solver", "solver")
RANKED = "answers_rightly"  # key of the flag that says whether a row's times are compared
COUNTS = {
    "claimed_solved": "claimed", "verified_solved": "verified", "silently_wrong": "silently wrong",
    "infeasible_right": "infeas. right", "refused_inconsistent": "refused: inconsistent",
    "infeasible_wrong": "infeas. wrong", "failed": "failed", "hung": "hung", "crashed": "crashed",
    "not_asked": "not asked",
}  # fmt: skip
FAULTS = ("silently_wrong", "infeasible_wrong", "failed", "hung", "crashed")
RESIDUALS = {
    "primal": "largest constraint violation of all answers",
    "natural": "largest natural residual (0 at an optimum) with the solver's own duals",
    "relative": "largest natural residual over the answers, with the best duals for each answer, and with the cost "
    "divided by the size of its gradient",
    "loss": "(cost of the worst answer - smallest cost) / (largest - smallest cost) over the feasible x",
}  # fmt: skip
TIMES = {
    "solve_p50_us": "p50", "solve_p99_us": "p99", "solve_p99_9_us": "p99.9", "update_p50_us": "update p50",
    "cold_p50_us": "cold p50", "cold_p99_us": "cold p99", "setup_p50_us": "set-up p50",
}  # fmt: skip

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


def answers_table(title: str, part: Mapping[str, Mapping[str, Any]], suffix: str = "", *more: Column) -> Table:
    """Make the table of an open-loop part. ``suffix`` is appended to the keys of `TIMES`."""
    rows = []
    for name, row in part.items():
        share = share_right(row) if "right" in row else None
        ranked = {} if share is None else {"right_percent": np.floor(1e4 * share) / 100.0, RANKED: share >= RIGHTLY}
        rows.append({"solver": name, **row, **ranked})
    shown = [
        SOLVER, Column("right_percent", "right", unit="%", format=".2f", better="high"),
        *(Column(key, title, format=".0f", better="low" if key in FAULTS else None) for key, title in COUNTS.items()),
        *(Column(f"{name}_max", name, format=".1e", better="low", help=text) for name, text in RESIDUALS.items()),
        *(Column(f"{key}{suffix}", title, unit="us", format=".1f", better="low", among=RANKED)
          for key, title in TIMES.items()), *more,
    ]  # fmt: skip
    return Table(title, shown, rows)


# --- the recorded sequence ---


def record(case: Scenario, ticks: int) -> Array:
    """Return the subproblem of every tick of a closed-loop run with ``exact``."""
    duration_s = ticks * case.plant.period_s
    trace = run(placed(case).change(duration_s=duration_s, judge=False, bound_samples=0))
    return np.asarray(trace.subproblem)


def recorded_sequence(work: Work) -> None:
    """Solve the sequence warm (in one session) and cold (in a new session for each problem)."""
    config = work.config.open_loop
    problems = [NullSpaceQP.from_row(np.array(row)) for row in work.sequence]
    session = Exact().start(problems[0])
    optima = [session.solve(qp) for qp in problems]  # exact decides which problems are feasible
    feasible = np.array([one.status is Status.SOLVED for one in optima])
    data = TestSet("recorded", work.sequence, np.array([one.x for one in optima]), feasible)
    limits = Limits(patience_s=2.0, setup_s=40.0, rounds=2, seconds=1.0, cold=config.cold)
    thin = data.thinned(max(1, len(data.rows) // config.cold))
    asked = ask(work.runner("recorded sequence, warm"), [(setting, data) for setting in work.recommended], limits)
    taken = [one for one in asked if not one.refused]
    work.summary["not_run"] |= {one.setting.solver: {"reason": one.refused} for one in asked if one.refused}
    apart = ask(work.runner("recorded sequence, cold"), [(one.setting, thin) for one in taken], limits, warm=False)
    measured = time(work.runner("recorded sequence, times"), taken, limits)
    warm, cold = (work.summary.setdefault(f"open_loop_{word}", {}) for word in ("warm", "cold"))
    for one, alone, times in zip(taken, apart, measured, strict=True):
        solver = one.setting.solver
        warm[solver], cold[solver] = one.summary(times), alone.summary()
        if times is not None:
            for name, prefix in (("cold", "solve"), ("setup", "setup")):
                cold[solver] |= percentiles(getattr(times, name), prefix)
            cold[solver] |= times.load
        work.answers.add(*one.rows("open_loop_warm"), *alone.rows("open_loop_cold"))
    right = {name: f"{row['right']} of {row['solves']}" for name, row in cold.items()}
    both = {name: row | {"right_cold": right[name]} for name, row in warm.items()}
    title = "One session for the whole sequence (cold: a new session for each problem)"
    table = answers_table(title, both, "", Column("right_cold", "right, cold"))
    about = f"{len(data.rows)} subproblems from successive ticks of one run with exact."
    work.sections.append(Section(RECORDED, about, [table]))


# --- the certified sets ---


def certified_sets(work: Work) -> None:
    """Solve every set under every setting, then take times."""
    config = work.config.testsets
    chosen = [TestSet.load(name).thinned(config.every) for name in config.chosen()]
    thinned = [data.thinned(config.every_other) for data in chosen]
    questions = [  # set by set, to drop a hanging solver early
        (setting, data if setting.recommended and not setting.nonlinear else thin)
        for data, thin in zip(chosen, thinned, strict=True) for setting in work.settings
    ]  # fmt: skip
    answers = ask(work.runner("certified sets, answers"), questions, config)
    of = {setting.label: [one for one in answers if one.setting == setting] for setting in work.settings}
    whole = work.summary["testsets"] = {label: totals(mine, []) for label, mine in of.items()}
    work.summary["settings"] = {
        one.label: {"options": in_words(effective(one)), "reason": one.reason} for one in work.settings
    }
    if "open_loop_warm" in work.summary:
        work.say()
    timed = {True: [*config.timed, *config.timed_too], False: config.timed}
    to_time = [one for one in answers if not one.refused and one.problems.name in timed[one.setting.recommended]]
    times = dict(zip(map(id, to_time), time(work.runner("certified sets, times"), to_time, config), strict=True))
    for label, mine in of.items():
        whole[label] = totals(mine, [found for one in mine if (found := times.get(id(one))) is not None])
        for one in mine:
            work.summary.setdefault(f"testset {one.problems.name}", {})[label] = one.summary(times.get(id(one)))
            work.answers.add(*one.rows("testset"))
    totalled = answers_table("All sets: sum of counts, largest residual, times of the slowest set", whole, "_worst_set")
    by_set = _set_by_set(work.summary, [data.name for data in chosen], work.recommended)
    work.sections.append(Section(CERTIFIED, f"{MEANING}\n\n{INCONSISTENT}", [totalled, by_set]))
    named = [Column(name, name) for name in ("solver", "setting", "options", "reason")]
    for title, shown, ours in (("Settings", [named[0], *named[2:]], True), ("Other settings", named, False)):
        rows = [{"solver": one.solver, "setting": one.name, **work.summary["settings"][one.label]}
                for one in work.settings if one.recommended is ours]  # fmt: skip
        work.sections.append(Section(title, "", [Table(title, shown, rows)]))


def _set_by_set(summary: Mapping[str, Any], names: Sequence[str], recommended: Sequence[SolverSetting]) -> Table:
    rows = []
    for setting in recommended:
        row = {"solver": setting.solver}
        for name in names:
            counts = summary[f"testset {name}"][setting.label]
            wrong, declined = counts["silently_wrong"], counts["refused_inconsistent"]
            row[name] = f"{counts['right']} of {counts['solves'] - declined}" + f", {wrong} wrong" * bool(wrong)
        rows.append(row)
    return Table(
        "Right answers per set, with recommended settings", [SOLVER, *(Column(name, name) for name in names)], rows,
        "Wrong: claimed as solved, and not verified. Problems that were refused as inconsistent are not counted.",
    )  # fmt: skip


# --- the closed loop ---


def closed_loop(work: Work) -> None:
    """Run the baseline and the solvers."""
    part = work.config.closed_loop
    cases = work.config.cases()
    number = {case.name: k for k, case in enumerate(cases)}
    starts, lost = work.study.placed(cases)
    work.runs.add(*lost)
    names = [BASELINE, *(name for name in work.names if name not in part.slow)]
    asked = []
    for case in starts:
        k = number[case.name]
        # Courses of largest mean mu are planned only in the first trials, because planning takes as long as a run.
        case = case.change(best_courses=k < part.others)
        timed = k < part.timed
        asked += [
            Trial(case, name, work.config.settings.get(name, {}), timed=timed, keep="curves" if timed else "row")
            for name in names if k < part.of(name)
        ]  # fmt: skip
    runs = work.study.trials(asked, "closed loop", keep=lambda run: timing.quiet(run.load))
    work.runs.add(*(run.row for run in runs))
    common = [case.name for case in cases[: part.others]]
    work.summary["closed_loop"] = {
        name: figures(work.runs, name, [run for run in runs if run.row["controller"] == name], common)
        for name in names
    }
    length = f"the first {part.duration_s:g} s of its task" if part.duration_s else "its whole task"
    text = f"Each trial is {length}. Its seed determines start pose, model errors of the plant, and noise."
    work.sections.append(Section(CLOSED, text, [_controllers(work.summary["closed_loop"])]))


def figures(
    rows: Results, controller: str, runs: Sequence[Run] = (), common: Container[str] | None = None
) -> dict[str, Any]:
    """Return a controller's entries for summary.json. Times are pooled over the timed ``runs``.

    Counts named "_in_common" are over the trials in ``common`` (None: all).
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
    timed = [run for run in runs if run.row["timed"] and run.columns]
    if timed:
        found |= {**timing.total(run.load for run in timed), "timed_runs": len(timed)}
        found["deadline_misses"] = sum(run.row["deadline_misses"] for run in timed)
        for name in ("solve", "tick"):
            times = [run.columns[f"{name}_us"] for run in timed if f"{name}_us" in run.columns]
            found |= percentiles(np.concatenate([np.empty(0), *times]), name)
    return found


def _controllers(rows: Mapping[str, Mapping[str, Any]]) -> Table:
    shown = []
    for name, row in rows.items():
        few = too_few(row.get("compared", 0))
        changes = {key: few or spread(row, key) for key in map(change_name, CHANGES) if key in row}
        shown.append({"solver": name, **row, **changes})
    ticks = {"tick_p50_us": "tick p50", "tick_p99_us": "tick p99", "tick_p99_9_us": "tick p99.9"}
    return Table(
        "The same trials under every controller",
        [Column("solver", "controller"), Column("trials", "trials"), Column("whole", "whole"),
         *(Column(change_name(name), f"change of {COSTS[name][0]}", unit="%") for name in CHANGES),
         *columns(*MEANS), *columns(*COUNTED),
         *(Column(key, title, unit="us", format=".1f") for key, title in ticks.items()),
         Column("deadline_misses", "misses", format=".0f")],
        shown, "Whole: completed trials. Changes: relative to DCAC, over the trials that the controller and "
        "DCAC completed, with 95 % intervals. The fractions of the best mu are from trials that every controller runs. "
        f"{FRAMES} {BASE_FRAME}",
    )  # fmt: skip
