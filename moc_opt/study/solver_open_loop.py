"""The parts of the solver study in open loop: a recorded sequence, the certified sets, more joints, and duals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from moc_opt import figures
from moc_opt.arrays import Array
from moc_opt.figures.notation import Doubtful
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario, run
from moc_opt.solvers.registry import accepts
from moc_opt.study.show import Picture, Section
from moc_opt.study.solver_answers import (
    RIGHTLY,
    Answers,
    Limits,
    Problems,
    Times,
    ask,
    share_right,
    time,
    totals,
)
from moc_opt.study.solver_settings import SolverSetting, effective, in_words
from moc_opt.study.solver_verdicts import CERTIFIED, INCONSISTENT, RECORDED
from moc_opt.study.timing import Disturbance, percentiles
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
    data = Problems.recorded("recorded", work.sequence())
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
    to_time = [
        one for one in answers if not one.refused and one.problems.name in config.times(one.setting.recommended)
    ]  # fmt: skip
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


def more_joints(work: Work) -> None:
    """Measure how times grow with the joints, under the recommended settings; nlp-* have no arm to go with."""
    limits, joints = work.config.testsets.limits(), work.config.growth.joints
    sets = {n: Problems.recorded(f"n={n}", np.array([qp.row for qp in smooth_sequence(n)])) for n in joints}
    settings = [setting for setting in work.recommended if not setting.nonlinear]
    answers = ask(work.runner("more joints, answers"), [(s, data) for s in settings for data in sets.values()], limits)
    times = time(work.runner("more joints, times"), answers, limits)
    found = work.summary.setdefault("growth", {})
    for k, setting in enumerate(settings):
        mine = dict(zip(joints, zip(answers[k * len(joints) :], times[k * len(joints) :], strict=False), strict=False))
        found[setting.solver] = _growth(mine)
    shown = [
        SOLVER, Column("verified_solved", "verified"), Column("solves", "solves"),
        *(_time(f"solve_p50_us_n{n}", f"p50, n = {n}") for n in joints),
        _time(f"solve_p99_us_n{joints[-1]}", f"p99, n = {joints[-1]}"),
        Column("solve_p50_us_exponent", "grows as n to the", format=".2f"), Column("reason", "not run because"),
    ]  # fmt: skip
    grown = {name: row["solve_p50_us_ratio"] for name, row in found.items() if "solve_p50_us_ratio" in row}
    text = "" if len(grown) < 2 else (
        f"From {joints[0]} to {joints[-1]} joints the median time of a solve grows by a factor of "
        f"{min(grown.values()):.1f} with `{min(grown, key=grown.__getitem__)}` and of {max(grown.values()):.1f} with "
        f"`{max(grown, key=grown.__getitem__)}`."
    )  # fmt: skip
    work.sections.append(Section("More joints", text, [Table("How times grow with the joints", shown, _shown(found))]))


def _growth(by_joints: Mapping[int, tuple[Answers, Times | None]]) -> dict[str, Any]:
    """Return one solver's counts and times by the joints, and the slope of log time over log n."""
    found: dict[str, Any] = {"verified_solved": 0, "solves": 0}
    medians, loads = dict[int, float](), list[dict[str, Any]]()
    for n, (answers, times) in by_joints.items():
        if answers.refused:
            found["reason"] = answers.refused
            continue
        counts = answers.counts()
        found |= {key: found[key] + counts[key] for key in ("verified_solved", "solves")}
        if times is not None:
            own = times.figures()
            loads.append(own)
            found |= {f"{key}_n{n}": own[key] for key in ("solve_p50_us", "solve_p99_us", "setup_p50_us") if key in own}
            if not isinstance(own["solve_p50_us"], Doubtful):
                medians[n] = own["solve_p50_us"]
    if len(medians) > 1:
        joints, values = np.array(list(medians)), np.array(list(medians.values()))
        found["solve_p50_us_exponent"] = float(np.polyfit(np.log(joints), np.log(values), 1)[0])
        found["solve_p50_us_ratio"] = float(values[-1] / values[0])
    return found | Disturbance.total(loads).entries()


def smooth_sequence(n: int, count: int = 32, period_s: float = 0.002) -> list[NullSpaceQP]:
    """Make feasible subproblems with n joints, neighbours 2 ms apart: a rigid tool, and otherwise random Jacobians."""
    rng = np.random.default_rng([5, n])
    axes, arms, turn = rng.normal(size=(3, n)), rng.normal(scale=0.4, size=(3, n)), rng.normal(size=(2, 3, n))
    tool, gradient, phase = 0.38 * _unit(rng.normal(size=3)), rng.normal(scale=0.1, size=(2, n)), rng.uniform(0, 6, n)
    lower, upper = -rng.uniform(0.3, 3.0, n), rng.uniform(0.3, 3.0, n)
    found = []
    for t in period_s * np.arange(count):
        J_wrist, spin = arms + 0.3 * t * turn[0], axes + 0.3 * t * turn[1]
        J_tip = J_wrist + np.cross(spin.T, tool).T
        x = 0.4 * np.minimum(-lower, upper) * np.cos(phase + np.pi * t)
        grad_mu = gradient[0] + t * gradient[1]
        found.append(NullSpaceQP(J_tip, J_wrist, J_tip @ x, J_wrist @ x, grad_mu, lower=lower, upper=upper))
    return found


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)


def duals(work: Work) -> None:
    """Measure how far apart any two solvers' multipliers are on the same problems, with six rows and with five."""
    sets = [Problems.certified(name, max(2, work.config.testsets.every)) for name in ("circle", "random")]
    names = [name for name in work.names if accepts(name, "rows")]
    problems = [NullSpaceQP.from_row(np.array(row)) for data in sets for row in data.rows]
    columns = [
        Column("pair", "pair"), Column("p50", "distance p50", digits=2), Column("max", "distance max", digits=2),
        Column("along_p50", "along the free direction, p50", digits=2),
        Column("across_p50", "across it, p50", digits=2),
        Column("across_max", "across it, max", digits=2), Column("problems", "problems"),
    ]  # fmt: skip
    tables: list[Table | Picture] = []
    found = {}
    for rows, words in ((6, "six rows"), (5, "five rows")):
        settings = [
            SolverSetting(name, words, {**work.config.settings.get(name, {}), "rows": rows}, "") for name in names
        ]
        asked = [(setting, data) for setting in settings for data in sets]
        answers = ask(work.runner(f"duals on {words}"), asked, work.config.testsets.limits())
        given = {
            setting.solver: np.concatenate([
                np.where((one.status == "solved")[:, None], one.y, np.nan) for one in answers if one.setting == setting
            ])
            for setting in settings
        }  # fmt: skip
        found[rows] = work.summary[f"duals on {words}"] = dual_distances(problems, given)
        shown = [{"pair": pair, **row} for pair, row in found[rows].items()]
        tables.append(Table(f"Distance between two solvers' duals on {words}", columns, shown,
                            "Over the size of the cost, c2 |grad mu|_inf."))  # fmt: skip
    work.sections.append(Section("Duals", said_of_duals(found[6], found[5]), tables))


def dual_distances(problems: Sequence[NullSpaceQP], given: Mapping[str, Array]) -> dict[str, dict[str, Any]]:
    """Measure how far the multipliers (k, 6) of any two solvers lie apart on the same problems.

    Each distance is |y_a - y_b|_inf over c2 |grad_mu|_inf, so that 1 is the size of the whole cost. ``along`` is the
    part on the null vector [u; -u] of the six rows, which no optimality condition determines; ``across`` the rest.

    Returns:
        "a | b" -> {p50, max, along_p50, across_p50, across_max, problems}.
    """
    u = np.array([np.linalg.svd(qp.J_tip - qp.J_wrist)[0][:, 2] for qp in problems])
    null = np.concatenate([u, -u], axis=1) / np.sqrt(2.0)
    scale = np.array([max(qp.c2 * np.abs(qp.grad_mu).max(), 1e-300) for qp in problems])
    found = {}
    for a, b in combinations(given, 2):
        both = np.isfinite(given[a]).all(axis=1) & np.isfinite(given[b]).all(axis=1)
        if not both.any():
            continue
        gap = (given[a] - given[b])[both] / scale[both, None]
        along = np.einsum("ki,ki->k", gap, null[both])
        across = np.abs(gap - along[:, None] * null[both]).max(axis=1)
        size = np.abs(gap).max(axis=1)
        found[f"{a} | {b}"] = {
            "p50": float(np.median(size)), "max": float(size.max()), "along_p50": float(np.median(np.abs(along))),
            "across_p50": float(np.median(across)), "across_max": float(across.max()), "problems": int(both.sum()),
        }  # fmt: skip
    return found


def said_of_duals(six: Mapping[str, Any], five: Mapping[str, Any]) -> str:
    """Say what the distances mean."""
    if not six or not five:
        return "Fewer than two solvers gave duals on six and on five rows."
    worst, best = (max(rows, key=lambda pair, rows=rows: rows[pair]["p50"]) for rows in (six, five))  # type: ignore[misc]
    return (
        f"On six rows the duals of {worst.replace(' | ', ' and ')} lie {six[worst]['p50']:.2g} times the whole cost "
        f"apart (median), {six[worst]['across_p50']:.1g} of it across the direction that the dependent row leaves "
        f"free. On five rows no two lie further apart than {five[best]['p50']:.2g} ({best.replace(' | ', ' and ')})."
    )


