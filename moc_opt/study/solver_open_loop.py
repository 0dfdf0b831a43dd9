"""The parts of the solver study in open loop: a recorded sequence, and the certified sets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from moc_opt import figures
from moc_opt.arrays import Array
from moc_opt.figures.notation import Doubtful
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario, run
from moc_opt.study.show import Picture, Section
from moc_opt.study.solver_answers import (
    RIGHTLY,
    Limits,
    Problems,
    ask,
    share_right,
    time,
    totals,
)
from moc_opt.study.solver_settings import SolverSetting, effective, in_words
from moc_opt.study.solver_verdicts import CERTIFIED, INCONSISTENT, RECORDED
from moc_opt.study.timing import percentiles
from moc_opt.study.trials import placed

if TYPE_CHECKING:
    from moc_opt.study.solvers import Work

MEANING = (
    "An answer is verified when its primal residual is at most 1e-6, its relative natural residual 1e-3 and its "
    "self-motion loss 1e-2; the solver is not asked. Silently wrong: claimed as solved, and not verified. Claims of "
    "infeasibility are right where the set's certificate says so; a wrong one counts among the failed, too. Right: "
    "verified, or rightly called infeasible, as a share of the problems that were not refused as inconsistent. Times "
    f"are compared among solvers that are right at {100 * RIGHTLY:g} % of the problems or more. Hung: no answer within "
    "the time limit, and the process was ended; the rest of a set is not asked after two of them, and no further set "
    "after three such sets. Update: of a warm solve, the part that hands the new problem to the library. A time marked "
    "? was spoilt by other work on the machine. The solvers nlp-* answer the nonlinear problem of the tick: a right "
    "answer of theirs lies about 1e-3 m/s off A x = b, so that the judge of the linear problem counts it as silently "
    "wrong."
)
SOLVER = Column("solver", "solver")
RANKED = "answers_rightly"  # flag of the rows whose times are compared


def _count(key: str, title: str, better: Any = None, about: str = "") -> Column:
    return Column(key, title, format=".0f", better=better, help=about)


def _time(key: str, title: str) -> Column:
    return Column(key, title, unit="us", format=".1f", better="low", among=RANKED)


COUNTS = [
    SOLVER, Column("right_percent", "right", unit="%", format=".2f", better="high"),
    _count("claimed_solved", "claimed"), _count("verified_solved", "verified"),
    _count("silently_wrong", "silently wrong", "low"), _count("infeasible_right", "infeas. right"),
    _count("refused_inconsistent", "refused: inconsistent"), _count("infeasible_wrong", "infeas. wrong", "low"),
    _count("failed", "failed", "low", "neither claimed nor rightly called infeasible"), _count("hung", "hung", "low"),
    _count("crashed", "crashed", "low"), _count("not_asked", "not asked"),
]  # fmt: skip


def residual_columns() -> list[Column]:
    """Return the columns of the largest residuals."""
    titles = {
        "primal": "of all answers, claimed or not", "natural": "with the solver's own duals",
        "relative": "with the best duals, the cost scaled to one", "loss": "0 optimum, 1 opposite end",
    }  # fmt: skip
    return [Column(f"{name}_max", name, format=".1e", better="low", help=text) for name, text in titles.items()]


def time_columns(suffix: str = "") -> list[Column]:
    """Return the columns of warm, cold and set-up times."""
    titles = {
        "solve_p50_us": "p50", "solve_p99_us": "p99", "solve_p99_9_us": "p99.9", "update_p50_us": "update p50",
        "cold_p50_us": "cold p50", "cold_p99_us": "cold p99", "setup_p50_us": "set-up p50",
    }  # fmt: skip
    return [_time(f"{key}{suffix}", title) for key, title in titles.items()]


def _shown(part: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    rows = []
    for name, row in part.items():
        share = share_right(row) if "right" in row else None
        ranked = {} if share is None else {"right_percent": np.floor(1e4 * share) / 100.0, RANKED: share >= RIGHTLY}
        rows.append({"solver": name, **row, **ranked})
    return rows


def record(case: Scenario, ticks: int) -> Array:
    """Record the subproblems of a closed-loop run with ``exact``, one a tick; in a worker."""
    duration_s = ticks * case.plant.period_s
    trace = run(placed(case).change(duration_s=duration_s, judge=False, bound_samples=0))
    return np.asarray(trace.subproblem)


def recorded_sequence(work: Work) -> None:
    """Ask every solver warm and cold for the recorded sequence, under the recommended settings; times one by one."""
    config = work.config.open_loop
    data = Problems.recorded("recorded", work.sequence)
    limits = Limits(max(2.0, work.config.testsets.patience_s), rounds=2, seconds=1.0, cold=config.cold)
    thin = data.thinned(max(1, len(data.rows) // config.cold))
    asked = ask(work.runner("recorded sequence, warm"), [(setting, data) for setting in work.recommended], limits)
    taken = [one for one in asked if not one.refused]
    work.summary["not_run"] |= {one.setting.solver: {"reason": one.refused} for one in asked if one.refused}
    apart = ask(work.runner("recorded sequence, cold"), [(one.setting, thin) for one in taken], limits, warm=False)
    measured = time(work.runner("recorded sequence, times"), taken, limits)
    warm, cold = (work.summary.setdefault(f"open_loop_{word}", {}) for word in ("warm", "cold"))
    samples = {}
    for one, alone, times in zip(taken, apart, measured, strict=True):
        solver = one.setting.solver
        warm[solver], cold[solver] = one.summary(times), alone.summary()
        if times is not None:
            samples[solver] = times.solve.ravel()
            for name, prefix in (("cold", "solve"), ("setup", "setup")):
                cold[solver] |= percentiles(getattr(times, name), prefix, times.cold_load)
            cold[solver] |= times.cold_load.entries()
        work.answers.add(*one.rows("open_loop_warm"), *alone.rows("open_loop_cold"))
    parts: list[Table | Picture] = [
        Table("Warm: one session through the sequence", [*COUNTS, *residual_columns(), *time_columns()[:3]],
              _shown(warm)),
        Table("Cold: a fresh session for each problem", [*COUNTS[:6], *residual_columns(), *time_columns()[:2],
              _time("setup_p50_us", "set-up p50")], _shown(cold)),
    ]  # fmt: skip
    if samples:
        spoilt = [name for name in samples if isinstance(warm[name].get("solve_p99_us"), Doubtful)]
        says = "Solve time, warm: how rare are the late ones, and where is the deadline of a tick? " + (
            f"Other work on the machine spoilt it for {', '.join(spoilt)}." if spoilt else ""
        )
        drawn = figures.latency_ecdf(samples, work.config.scenario.deadline_us, tail=True)
        parts.append(Picture(drawn, says, "solve-times"))
    work.sections.append(Section(RECORDED, f"{len(data.rows)} subproblems of one run with exact, a tick apart.", parts))


def certified_sets(work: Work) -> None:
    """Ask every solver under every setting for every set; the answers several at a time, the times one by one."""
    config = work.config.testsets
    chosen = [Problems.certified(name, config.every) for name in config.chosen()]
    thinned = [data.thinned(config.every_other) for data in chosen]
    limits = config.limits()
    questions = [
        (setting, data) for setting in work.settings
        for data in (chosen if setting.recommended and not setting.nonlinear else thinned)
    ]  # fmt: skip
    answers = ask(work.runner("certified sets, answers"), questions, limits)
    whole = work.summary.setdefault("testsets", {})
    for setting in work.settings:
        whole[setting.label] = totals([one for one in answers if one.setting == setting], [])
    work.summary["settings"] = {
        one.label: {"options": in_words(effective(one)), "reason": one.reason} for one in work.settings
    }
    if "open_loop_warm" in work.summary:
        work.say()
    timed = {True: [*config.timed, *config.timed_too], False: config.timed}
    to_time = [one for one in answers if not one.refused and one.problems.name in timed[one.setting.recommended]]
    times = dict(zip(map(id, to_time), time(work.runner("certified sets, times"), to_time, limits), strict=True))
    for setting in work.settings:
        mine = [one for one in answers if one.setting == setting]
        measured = [found for one in mine if (found := times.get(id(one))) is not None]
        whole[setting.label] = totals(mine, measured)
        for one in mine:
            by_set = work.summary.setdefault(f"testset {one.problems.name}", {})
            by_set[setting.label] = one.summary(times.get(id(one)))
            work.answers.add(*one.rows("testset"))
    names = [data.name for data in chosen]
    work.sections += [_certified_section(work.summary, names, work.recommended), _settings_section(work.settings)]


def _certified_section(
    summary: Mapping[str, Any], names: Sequence[str], recommended: Sequence[SolverSetting]
) -> Section:
    rows = []
    for setting in recommended:
        row = {"solver": setting.solver}
        for name in names:
            counts = summary[f"testset {name}"][setting.label]
            wrong, declined = counts["silently_wrong"], counts["refused_inconsistent"]
            row[name] = f"{counts['right']} of {counts['solves'] - declined}" + f", {wrong} wrong" * bool(wrong)
        rows.append(row)
    by_set = Table(
        "Right answers, set by set, under our settings", [SOLVER, *(Column(name, name) for name in names)], rows,
        "Wrong: claimed as solved, and not verified. Problems that were refused as inconsistent are not counted.",
    )  # fmt: skip
    totalled = Table(
        "All sets: sums of counts, largest residuals, times of the slowest set",
        [*COUNTS, *residual_columns(), *time_columns("_worst_set")], _shown(summary["testsets"]),
    )  # fmt: skip
    return Section(CERTIFIED, f"{MEANING}\n\n{INCONSISTENT}", [totalled, by_set])


def _settings_section(settings: Sequence[SolverSetting]) -> Section:
    rows = [
        {"solver": one.solver, "setting": one.name, "options": in_words(effective(one)), "reason": one.reason}
        for one in settings
    ]  # fmt: skip
    columns = [SOLVER, Column("setting", "setting"), Column("options", "what it gets"), Column("reason", "why")]
    return Section("Settings", "", [Table("Every setting of every solver", columns, rows)])
