"""The tables of the study, and its result in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.solver_study.cells import RIGHTLY, answers_rightly, share_right
from benchmarks.solver_study.closed_loop import BASELINE, COMPARED
from benchmarks.solver_study.compare import WORDS
from benchmarks.statistics import spread
from moc_opt.report.tables import Column, Table

Summary = Mapping[str, Mapping[str, Mapping[str, Any]]]

NONLINEAR = "nlp-"
FOOTNOTE = (
    "The solvers nlp-* answer another problem, the nonlinear one of the same tick: a right answer of theirs lies about "
    "1e-3 m/s off A x = b, so the judge of the linear problem does not verify it. Their claims are counted under "
    "'silently wrong' by the letter of that judge, though they are right about the problem that these solvers solve. "
    "On the inconsistent sets the answer to the five rows is certified; a solver that is given six rows and calls them "
    "infeasible is right about its numbers: it counts as right, and has a column of its own."
)


def _count(key: str, title: str, better: Any = None, text: str = "") -> Column:
    return Column(key, title, format=".0f", better=better, help=text)


RANKED = "answers_rightly"  # flag of the rows whose times are compared
COUNTS = [
    Column(
        "right_percent", "right", unit="%", format=".1f", better="high",
        help="verified, or rightly called infeasible: by the certificate, or because the six rows given contradict",
    ),
    _count("claimed_solved", "claimed", text="answers that the solver calls solved"),
    _count("verified_solved", "verified", text="of these, optimal by our residuals"),
    _count("silently_wrong", "silently wrong", "low", "claimed, but not optimal"),
    _count("infeasible_right", "infeas. right", text="called infeasible, and certified so"),
    _count(
        "infeasible_six_rows", "six rows infeas.", text="called infeasible: the six rows given do contradict"
    ),
    _count("infeasible_wrong", "infeas. wrong", "low", "called infeasible, and certified feasible"),
    _count("failed", "failed", "low", "neither claimed nor rightly called infeasible"),
    _count("hung", "hung", "low", "no answer within the time limit"),
    _count("crashed", "crashed", "low", "the process died"),
    _count("not_asked", "not asked", text="after two hangs in the set or hangs in three sets, or not supported"),
]
RESIDUALS = [
    Column(
        "primal_max",
        "primal",
        format=".1e",
        better="low",
        help="largest |A x - b| or box violation of all answers given, claimed or not",
    ),
    Column(
        "natural_max", "natural", format=".1e", help="largest natural residual with the solver's own duals"
    ),
    Column(
        "relative_max",
        "relative",
        format=".1e",
        better="low",
        help="the same, best duals, cost scaled to one",
    ),
    Column(
        "loss_max", "loss", format=".1e", better="low", help="self-motion loss: 0 optimum, 1 opposite end"
    ),
]


def _time(key: str, title: str, text: str = "") -> Column:
    return Column(key, title, unit="us", format=".1f", better="low", help=text, among=RANKED)


def _times(suffix: str = "") -> list[Column]:
    return [
        _time(f"solve_p50_us{suffix}", "warm p50"),
        _time(f"solve_p99_us{suffix}", "warm p99"),
        _time(f"solve_p99_9_us{suffix}", "warm p99.9"),
        _time(
            f"update_p50_us{suffix}", "update p50",
            "of a warm solve, the part that hands the new problem to the library",
        ),
        _time(f"cold_p50_us{suffix}", "cold p50"),
        _time(f"cold_p99_us{suffix}", "cold p99"),
        _time(f"setup_p50_us{suffix}", "set-up p50"),
    ]  # fmt: skip


SOLVER = Column("solver", "solver")
SETTLED = (
    "Settled are the ticks of a trial at which the elbow of no controller with a third level is on its way to its "
    "optimum: the same ticks for all controllers. Tip and RCM errors are by the robot's own kinematics, from the "
    "registered trocar: what a controller can answer for."
)
TRIALS = _count("runs", "trials", text="each from a pose of its own, drawn by its seed")
CLOSED = [
    TRIALS,
    Column("mu_mean", "mu", format=".4f", better="high"),
    Column(
        "mu_fraction_of_bound",
        "of bound",
        digits=3,
        better="high",
        help="of the largest mu on the self-motion",
    ),
    Column("mu_gain_interval", "gain", unit="%", help="of the mean over DCAC's, with its 95 % interval"),
    Column("tip_error_model_mean_mm", "tip", unit="mm", digits=3, better="low"),
    Column("tip_error_model_max_mm", "tip max", unit="mm", digits=3, better="low"),
    Column("tip_change_interval", "change of tip", unit="%", help="against DCAC's mean, with its 95 % interval"),
    Column("rcm_error_model_mean_mm", "RCM", unit="mm", digits=3, better="low"),
    Column("tip_error_registered_mean_mm", "tip, registered frame", unit="mm", digits=3, better="low"),
    Column("rcm_error_registered_mean_mm", "RCM, registered frame", unit="mm", digits=3, better="low"),
    Column("rcm_change_interval", "change of RCM", unit="%", help="against DCAC's mean, with its 95 % interval"),
    Column("rcm_error_model_max_mm", "RCM max", unit="mm", digits=3, better="low"),
    Column("rcm_error_mean_mm", "RCM, true trocar", unit="mm", digits=3, better="low"),
    Column("travelling_percent", "travelling", unit="%", digits=2, help="of the time the elbow is on its way"),
    Column("trocar_force_mean_N", "force", unit="N", digits=2, better="low"),
    Column("torque_rate_rms_Nm_per_s", "chatter", unit="Nm/s", format=".0f", better="low"),
]
AT_REST = [
    Column("tip_error_model_settled_mean_mm", "tip settled", unit="mm", digits=3, better="low"),
    Column("rcm_error_model_settled_mean_mm", "RCM settled", unit="mm", digits=3, better="low"),
    _count("settled_ticks", "settled ticks", text="of all trials, the same for all controllers"),
]
CLAIMS = [
    _count("claimed_solved", "claimed"), _count("verified_solved", "verified"),
    _count("silently_wrong", "silently wrong", "low"),
]  # fmt: skip
TICKS = [
    _count("deadline_misses", "misses", "low", "ticks longer than the deadline"),
    Column("tick_p50_us", "tick p50", unit="us", format=".1f", better="low"),
    Column("tick_p99_us", "tick p99", unit="us", format=".1f", better="low"),
    Column("tick_p99_9_us", "tick p99.9", unit="us", format=".1f", better="low"),
    _count("broke_off", "broke off", "low"), _count("oscillated", "oscillated", "low"),
]
SWEPT = [
    Column("infeasible_percent", "infeasible", unit="% of ticks", digits=3),
    Column("late_percent", "late", unit="% of ticks", digits=3),
    Column("primal_max", "primal max", format=".1e"), Column("loss_max", "loss max", format=".1e"),
    _count("broke_off", "broke off", "low"), _count("oscillated", "oscillated", "low"),
]  # fmt: skip
DUALS = [
    Column("solver", "pair"), Column("p50", "distance p50", digits=2, help="over the size of the cost"),
    Column("max", "distance max", digits=2), Column("along_p50", "along the free direction, p50", digits=2),
    Column("across_p50", "across it, p50", digits=2), Column("across_max", "across it, max", digits=2),
    _count("problems", "problems"),
]  # fmt: skip
QPBENCHMARK = [
    SOLVER, _count("rank", "their rank"), Column("success_percent", "success", unit="%", format=".0f", better="high"),
    Column("shgeom_us", "their mean", unit="us", digits=4, better="low", help="shifted geometric mean, shift 10 s"),
    Column("runtime_p50_us", "their p50", unit="us", format=".1f", better="low"),
    _count("our_rank", "our rank"), Column("our_p50_us", "our p50", unit="us", format=".1f"),
    Column("our_right_percent", "right by us", unit="%", format=".1f", better="high"),
]  # fmt: skip


def ranked(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """A row with its share of right answers, and whether its times are compared."""
    if "right" not in metrics:
        return dict(metrics)
    return {**metrics, "right_percent": 100.0 * share_right(metrics), RANKED: answers_rightly(metrics)}


def tables(summary: Summary) -> dict[str, Table]:
    """Part of the summary -> its table, in the order of the page."""
    found: dict[str, Table] = {}

    def add(part: str, title: str, columns: Sequence[Column], rows: Any = None, caption: str = "") -> None:
        given = summary.get(part)
        if given:
            made = [{"solver": name, **ranked(metrics)} for name, metrics in given.items()] if rows is None else rows
            found[part] = Table(title, list(columns), made, caption)

    add("settings", "Settings of the study", [SOLVER, Column("options", "options"), Column("reason", "why")])
    add("testsets", "All certified sets: sums of counts, largest residuals, times of the slowest set",
        [SOLVER, *COUNTS, *RESIDUALS, *_times("_worst_set")], caption=FOOTNOTE)  # fmt: skip
    for part in summary:
        if part.startswith("testset "):
            footnote = FOOTNOTE if any(name.startswith(NONLINEAR) for name in summary[part]) else ""
            add(part, f"Test set {part.removeprefix('testset ')}", [SOLVER, *COUNTS, *RESIDUALS, *_times()],
                caption=footnote)  # fmt: skip
    add("growth", "How times grow with the joints, under our settings", _growth_columns(summary))
    for count in ("six", "five"):
        add(f"duals on {count} rows", f"Distance between two solvers' duals on {count} rows", DUALS)
    warm = [SOLVER, *COUNTS, *RESIDUALS, *_times()[:3]]
    cold = [
        SOLVER, *COUNTS[:7], *RESIDUALS, _time("solve_p50_us", "cold p50"), _time("solve_p99_us", "cold p99"),
        _time("setup_p50_us", "set-up p50"), _time("setup_p99_us", "set-up p99"),
    ]  # fmt: skip
    add("open_loop_warm", "Open loop, warm: one session through the sequence", warm, caption=FOOTNOTE)
    add("open_loop_cold", "Open loop, cold: a fresh session for each", cold)
    add("closed_loop", "Closed loop: the same trials under every controller",
        [Column("solver", "controller"), *CLOSED, *AT_REST, *CLAIMS, *TICKS],
        [_with_intervals({"solver": n, **m}) for n, m in summary.get("closed_loop", {}).items()],
        f"{SETTLED} {FOOTNOTE}")  # fmt: skip
    for part in summary:
        if part.startswith("sweep "):
            rows = [{"solver": name, **_with_intervals(_shares(metrics))} for name, metrics in summary[part].items()]
            add(part, part.capitalize(), [Column("solver", "value"), *CLOSED, *CLAIMS, *SWEPT], rows)
    pairs = [
        {**v, "open": WORDS.get(v["open"], v["open"]), "closed": WORDS.get(v["closed"], v["closed"])}
        for v in summary.get("prediction", {}).values()
    ]
    add("prediction", "Rank correlation of open loop with closed loop",
        [Column("open", "open loop"), Column("closed", "closed loop"),
         Column("rank_correlation", "Spearman", format="+.2f"), Column("p_value", "p", digits=2),
         _count("solvers", "solvers and settings")], pairs,
        caption="Both ranked from good to bad: +1 where what is better in open loop is better in closed loop. "
        "Closed-loop figures that differ by less than 1 % (mu), 5 % (errors) or 10 % (chatter) share a rank.",
    )  # fmt: skip
    add("qpbenchmark", "qpbenchmark's ranking beside ours", QPBENCHMARK, _beside_ours(summary),
        caption="Theirs: on feasible problems of six sets through qpsolvers, five rows; ours: the same library "
        "and settings on all certified sets, ranked by how many answers are right, then by median time. With times "
        "of microseconds and a shift of 10 s their geometric mean is an arithmetic one.")  # fmt: skip
    told = troubles(summary)
    if told:
        columns = [SOLVER, Column("part", "part"), Column("trouble", "first time")]
        found["troubles"] = Table("What solvers raised, and which gave no answer in time", columns, told)
    add("not_run", "What could not run here", [Column("solver", "not run"), Column("reason", "reason")])
    return found


def _with_intervals(row: Mapping[str, Any]) -> dict[str, Any]:
    """The row with its changes against the baseline as texts, each with its interval."""
    texts = {name: spread(row, name) for name in COMPARED.values()}
    return {**row, **{name.replace("_percent", "_interval"): text for name, text in texts.items()}}


def troubles(summary: Summary) -> list[dict[str, Any]]:
    """A row for each solver and part in which it raised an exception, hung or crashed: the first time, in words."""
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
    columns = [SOLVER, _count("solves", "solves"), _count("verified_solved", "verified", "high")]
    for n in joints:
        columns.append(Column(f"solve_p50_us_n{n}", f"p50, n = {n}", unit="us", format=".1f", better="low"))
    if joints:
        columns.append(
            Column(f"solve_p99_us_n{joints[-1]}", f"p99, n = {joints[-1]}", unit="us", format=".1f")
        )
    return [
        *columns,
        Column("solve_p50_us_exponent", "grows as n to the", format=".2f", better="low"),
        Column("setup_p50_us_exponent", "set-up: n to the", format=".2f"),
        Column("update_p50_us_exponent", "update: n to the", format=".2f"),
        Column("reason", "not run because"),
    ]


def _beside_ours(summary: Summary) -> list[dict[str, Any]]:
    """qpbenchmark's rows with our figures of the same library: default beside default, high accuracy beside tight."""
    ours = {}
    for label, metrics in summary.get("testsets", {}).items():
        if label.startswith("qpsolvers:") and metrics.get("solves"):
            ours[label.removeprefix("qpsolvers:")] = metrics
    rows = []
    for label, theirs in summary.get("qpbenchmark", {}).items():
        solver, _, settings = label.partition("@")
        word = {"default": "default", "high_accuracy": "tight"}.get(settings, "")
        rivals = {name: m for name, m in ours.items() if name.endswith(f"@{word}")}
        order = sorted(
            rivals,
            key=lambda n: (-rivals[n]["right"], rivals[n].get("solve_p50_us_worst_set") or 1e9),
        )
        mine = rivals.get(f"{solver}@{word}")
        extra = {} if mine is None else {
            "our_rank": order.index(f"{solver}@{word}") + 1, "our_p50_us": mine.get("solve_p50_us_worst_set"),
            "our_right_percent": 100.0 * share_right(mine),
        }  # fmt: skip
        rows.append({"solver": label, **theirs, **extra})
    return rows


def headline(summary: Summary, words: Mapping[str, str]) -> str:
    """The result in words, computed."""
    parts = []
    sets = {
        n.partition("@")[0]: m for n, m in summary.get("testsets", {}).items() if n.endswith("@recommended")
    }
    linear = {n: m for n, m in sets.items() if not n.startswith(NONLINEAR)}
    if linear:
        right = [n for n, m in linear.items() if m["right"] == m["solves"]]
        text = f"{len(right)} of {len(linear)} solvers answered every problem of the certified sets rightly"
        timed = {
            n: v for n, m in linear.items()
            if answers_rightly(m) and (v := m.get("solve_p50_us_worst_set")) is not None
        }  # fmt: skip
        if timed:
            fastest = min(timed, key=lambda n: timed[n])
            text += (
                f"; of those right at {100 * RIGHTLY:g} % or more the fastest is {fastest} "
                f"({100 * share_right(linear[fastest]):.1f} %) with a median of {timed[fastest]:.1f} us on its slowest "
                "set"
            )
        parts.append(text)
        wrong = {n: m["silently_wrong"] for n, m in linear.items() if m["silently_wrong"]}
        if wrong:
            parts.append("claimed success for wrong answers under our settings (how often): " + _listed(wrong))
    every = {n: m for n, m in summary.get("testsets", {}).items() if not n.startswith(NONLINEAR)}
    default = {n.partition("@")[0]: m["silently_wrong"] for n, m in every.items() if n.endswith("@default")}
    if any(default.values()):
        wrong = {n: k for n, k in default.items() if k}
        parts.append("claimed success for wrong answers as the libraries come (how often): " + _listed(wrong))
    hung = {n: m["hung"] for n, m in every.items() if m["hung"]}
    if hung:
        parts.append("never returned: " + ", ".join(hung))
    crashed = {n: m["crashed"] for n, m in every.items() if m["crashed"]}
    if crashed:
        parts.append("took their process with them: " + ", ".join(crashed))
    ratios = {
        name: (value, key.rpartition("us_")[2].split("_over_"))
        for name, row in summary.get("growth", {}).items()
        for key, value in row.items()
        if key.startswith("solve_p50_us_") and "_over_" in key
    }
    if ratios:
        least, most = min(ratios, key=lambda n: ratios[n][0]), max(ratios, key=lambda n: ratios[n][0])
        last, first = ratios[most][1]
        parts.append(
            f"from {first} to {last} joints the median time grows {ratios[least][0]:.1f} times with {least} and "
            f"{ratios[most][0]:.1f} times with {most}"
        )
    closed = summary.get("closed_loop", {})
    gains = {n: m["mu_gain_percent"] for n, m in closed.items() if n != BASELINE and "mu_gain_percent" in m}
    if gains:
        best, worst = max(gains, key=lambda n: gains[n]), min(gains, key=lambda n: gains[n])
        trials = closed[best]["runs"]
        parts.append(
            f"in closed loop, over {trials} {'trial' if trials == 1 else 'trials'} from random poses, manipulability "
            f"changed by {spread(closed[best], 'mu_gain_percent')} % with {best} and by "
            f"{spread(closed[worst], 'mu_gain_percent')} % with {worst}"
        )
    text = ". ".join(part[0].upper() + part[1:] for part in parts) + "." if parts else "Nothing was run."
    return " ".join([text, *(words[key] for key in ("prediction",) if key in words)])


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} ({count})" for name, count in counts.items())
