"""The tables of the study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.solver_study.cells import answers_rightly, share_right
from benchmarks.solver_study.columns import (
    AS_MANY,
    CLAIMS,
    CLOSED,
    COUNTS,
    DUALS,
    QPBENCHMARK,
    RANKED,
    RESIDUALS,
    SOLVER,
    STEADY_STATE,
    SWEPT,
    TICKS,
    count,
    time,
    times,
)
from benchmarks.solver_study.combine import COMPARED
from benchmarks.solver_study.compare import WORDS
from benchmarks.solver_study.settings import QPSOLVERS
from benchmarks.solver_study.study import NONLINEAR
from moc_opt.figures.notation import Doubtful, Missing
from moc_opt.report.tables import Column, Table
from moc_opt.study.statistics import spread, too_few

Summary = Mapping[str, Mapping[str, Mapping[str, Any]]]

INCONSISTENT = (
    "in the inconsistent sets the six rows as given contradict each other along the shaft, by 1e-12 to 1e-4 m/s, while "
    "five of them have a certified optimum; 'infeasible' is true of the six rows but no answer for the robot, so it "
    "counts neither as right nor as wrong"
)
FOOTNOTE = (
    "The solvers nlp-* answer another problem, the nonlinear one of the same tick: a right answer of theirs lies about "
    "1e-3 m/s off A x = b, so the judge of the linear problem does not verify it. Their claims are counted under "
    "'silently wrong' by the letter of that judge, though they are right about the problem that these solvers solve. "
    f"Refused: {INCONSISTENT}."
)
STEADY = (
    "Steady ticks are those at which no controller is still moving the elbow to its optimum: the same ticks for all "
    "controllers that ran the trial."
)
MEANS = (
    "Changes are of means over the trials that both ran, the ratio of the means; where the mean of the trials' ratios "
    "disagrees in sign or verdict it stands beside it, and the change is undecided. The solvers of the first sentences "
    "run more trials than the others, so means are marked as best among those with all the trials."
)
FRAMES = (
    "Tip and RCM are given in two frames: by the robot's own kinematics from the registered trocar, what a controller "
    "can answer for; and in the frame registered at the start (patient), what the patient gets."
)


def ranked(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row with its share of right answers, and whether its times are compared."""
    if "right" not in metrics:
        return dict(metrics)
    return {**metrics, "right_percent": 100.0 * share_right(metrics), RANKED: answers_rightly(metrics)}


def tables(summary: Summary) -> dict[str, Table]:
    """Make the tables: part of the summary -> its table, in the order of the page."""
    found: dict[str, Table] = {}

    def add(part: str, title: str, columns: Sequence[Column], rows: Any = None, caption: str = "") -> None:
        given = summary.get(part)
        if given:
            made = [{"solver": name, **ranked(metrics)} for name, metrics in given.items()] if rows is None else rows
            found[part] = Table(title, list(columns), made, caption)

    add("settings", "Settings of the study", [SOLVER, Column("options", "options"), Column("reason", "why")])
    add("testsets", "All certified sets: sums of counts, largest residuals, times of the slowest set",
        [SOLVER, *COUNTS, *RESIDUALS, *times("_worst_set")], caption=FOOTNOTE)  # fmt: skip
    for part in summary:
        if part.startswith("testset "):
            footnote = FOOTNOTE if any(name.startswith(NONLINEAR) for name in summary[part]) else ""
            add(part, f"Test set {part.removeprefix('testset ')}", [SOLVER, *COUNTS, *RESIDUALS, *times()],
                caption=footnote)  # fmt: skip
    add("growth", "How times grow with the joints, under our settings", _growth_columns(summary))
    for word in ("six", "five"):
        add(f"duals on {word} rows", f"Distance between two solvers' duals on {word} rows", DUALS)
    warm = [SOLVER, *COUNTS, *RESIDUALS, *times()[:3]]
    cold = [
        SOLVER, *COUNTS[:7], *RESIDUALS, time("solve_p50_us", "cold p50"), time("solve_p99_us", "cold p99"),
        time("setup_p50_us", "set-up p50"), time("setup_p99_us", "set-up p99"),
    ]  # fmt: skip
    add("open_loop_warm", "Open loop, warm: one session through the sequence", warm, caption=FOOTNOTE)
    add("open_loop_cold", "Open loop, cold: a fresh session for each", cold)
    most = max((m.get("runs", 0) for m in summary.get("closed_loop", {}).values()), default=0)
    add("closed_loop", "Closed loop: the same trials under every controller",
        [Column("solver", "controller"), *CLOSED, *STEADY_STATE, *CLAIMS, *TICKS],
        [_with_intervals({"solver": n, **m}, most) for n, m in summary.get("closed_loop", {}).items()],
        f"{MEANS} {FRAMES} {STEADY} {FOOTNOTE}")  # fmt: skip
    for part in summary:
        if part.startswith("sweep "):
            rows = [{"solver": n, **_with_intervals(_shares(m), m.get("runs", 0))} for n, m in summary[part].items()]
            add(part, part.capitalize(), [Column("solver", "value"), *CLOSED, *CLAIMS, *SWEPT], rows)
    pairs = [
        {**v, "open": WORDS.get(v["open"], v["open"]), "closed": WORDS.get(v["closed"], v["closed"])}
        for v in summary.get("prediction", {}).values()
    ]
    add("prediction", "Rank correlation of open loop with closed loop",
        [Column("open", "open loop"), Column("closed", "closed loop"),
         Column("rank_correlation", "Spearman", format="+.2f"), Column("p_value", "p", digits=2),
         count("solvers", "solvers and settings")], pairs,
        caption="Both ranked from good to bad: +1 where what is better in open loop is better in closed loop. "
        "Closed-loop figures that differ by less than 1 % (mu), 5 % (errors) or 10 % (chatter) share a rank.",
    )  # fmt: skip
    add("qpbenchmark", "qpbenchmark's ranking beside ours", QPBENCHMARK, _beside_ours(summary),
        caption="Theirs: on feasible problems of six sets through qpsolvers, five rows; ours: the same library "
        "and settings on all certified sets, ranked by the share of right answers, then by median time. With times "
        "of microseconds and a shift of 10 s their geometric mean is an arithmetic one.")  # fmt: skip
    told = troubles(summary)
    if told:
        columns = [SOLVER, Column("part", "part"), Column("trouble", "first time")]
        found["troubles"] = Table("What solvers raised, and which gave no answer in time", columns, told)
    add("not_run", "What was not run", [Column("solver", "not run"), Column("reason", "reason")])
    return found


def _with_intervals(row: Mapping[str, Any], most: int) -> dict[str, Any]:
    """Return the row with its changes against the baseline as texts, and whether it has ``most`` trials."""
    few = too_few(row.get("compared_trials", 0))
    texts = {name: few or spread(row, name) for name in COMPARED.values() if name in row}
    compared = row.get("runs") == most and not row.get("short_runs")
    return {**row, AS_MANY: compared, **{name.replace("_percent", "_interval"): text for name, text in texts.items()}}


def troubles(summary: Summary) -> list[dict[str, Any]]:
    """List each solver and part in which it raised an exception, hung or crashed: the first time, in words."""
    return [
        {"solver": name, "part": part, "trouble": row["trouble"]}
        for part, rows in summary.items()
        if isinstance(rows, Mapping)
        for name, row in rows.items()
        if isinstance(row, Mapping) and row.get("trouble")
    ]


def _shares(metrics: Mapping[str, Any]) -> dict[str, Any]:
    late = 100.0 * (metrics.get("fault_late") or 0.0) / (metrics.get("ticks") or 1.0)
    return {**metrics, "late_percent": late}


def _growth_columns(summary: Summary) -> list[Column]:
    keys = list(dict.fromkeys(key for row in summary.get("growth", {}).values() for key in row))
    joints = sorted({int(key.rpartition("_n")[2]) for key in keys if key.startswith("solve_p50_us_n")})
    columns = [SOLVER, count("solves", "solves"), count("verified_solved", "verified", "high")]
    return [
        *columns,
        *(Column(f"solve_p50_us_n{n}", f"p50, n = {n}", unit="us", format=".1f", better="low") for n in joints),
        *(Column(f"solve_p99_us_n{n}", f"p99, n = {n}", unit="us", format=".1f") for n in joints[-1:]),
        Column("solve_p50_us_exponent", "grows as n to the", format=".2f", better="low"),
        Column("setup_p50_us_exponent", "set-up: n to the", format=".2f"),
        Column("update_p50_us_exponent", "update: n to the", format=".2f"),
        Column("reason", "not run because"),
    ]


def _beside_ours(summary: Summary) -> list[dict[str, Any]]:
    """Return qpbenchmark's rows with our figures of the library: default beside default, high accuracy beside tight."""
    ours = {
        label.removeprefix(QPSOLVERS): metrics
        for label, metrics in summary.get("testsets", {}).items()
        if label.startswith(QPSOLVERS) and metrics.get("solves")
    }
    rows: list[dict[str, Any]] = []
    for label, theirs in summary.get("qpbenchmark", {}).items():
        solver, _, settings = label.partition("@")
        word = {"default": "default", "high_accuracy": "tight"}.get(settings, "")
        rivals = {name: m for name, m in ours.items() if name.endswith(f"@{word}")}
        order = sorted(rivals, key=lambda n: (-share_right(rivals[n]), rivals[n].get("solve_p50_us_worst_set") or 1e9))
        doubted = any(isinstance(m.get("solve_p50_us_worst_set"), Doubtful) for m in rivals.values())
        rows.append({"solver": label, **theirs})
        if (name := f"{solver}@{word}") in rivals:
            rows[-1] |= {
                "our_rank": Missing("the machine was busy") if doubted else order.index(name) + 1,
                "our_p50_us": rivals[name].get("solve_p50_us_worst_set"),
                "our_right_percent": 100.0 * share_right(rivals[name]),
            }  # fmt: skip
    return rows
