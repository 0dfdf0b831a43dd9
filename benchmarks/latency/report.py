"""The tables, the page and the headline of ``python -m benchmarks.speed``, all from its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike

from benchmarks import baselines as peers
from benchmarks.common.answer import Answer, Picture, goals_answer, interval_picture
from benchmarks.latency.goals import Summary, reason
from benchmarks.latency.tick import PARTS
from moc_opt import figures
from moc_opt.figures.notation import Notation
from moc_opt.figures.style import GOOD
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table

WHY, IN_TICKS, IN_PEERS, IN_SOLVERS, IN_ADAPTERS, IN_LOOP = (
    "How to read this", "Ticks", "Other libraries", "Solvers", "Adapters", "Loop",
)  # fmt: skip
"""Titles of sections."""
GOALS = [
    Column("what", "goal"),
    Column("kind", ""),
    Column("goal", "limit"),
    Column("value", "measured", sections="explained"),
    Column("unit", "unit"),
    Column("reached", "reached", section=WHY),
]
EXPLAINED = {
    "tick_p50": IN_TICKS, "tick_p99_9": IN_TICKS, "c_tick": IN_TICKS, "adapters": IN_ADAPTERS, "peers": IN_PEERS,
    "peers_c": IN_PEERS, "exact_p50": IN_SOLVERS, "exact_any_n": IN_SOLVERS, "exact_primal": IN_SOLVERS,
    "exact_natural": IN_SOLVERS, "exact_batch": IN_SOLVERS, "exact_batch_all": IN_SOLVERS,
}  # fmt: skip
"""Goal -> section with the figures around it; that of all others is the loop's."""
_COLD = "median of the five calls after another entry's turn; the percentiles count them too"
_WORST = [
    Column("tick_cold_p50_us", "cold", unit="us", format=".1f", better="low", help=_COLD),
    Column("tick_max_us", "longest", unit="us", format=".1f", better="low"),
]
TICKS = [
    Column("name", "tick with"),
    Column("tick_p50_us", "p50", unit="us", format=".1f", better="low"),
    Column("tick_p99_us", "p99", unit="us", format=".1f", better="low"),
    Column("tick_p99_9_us", "p99.9", unit="us", format=".1f", better="low"),
    *_WORST,
    Column("beyond_us", "beyond", unit="us", format=".1f", help="beyond our own part and the library driven by hand"),
]
PARTS_COLUMNS = [
    Column("name", "part"),
    Column("tick_p50_us", "p50", unit="us", format=".2f"),
    Column("tick_p99_us", "p99", unit="us", format=".2f"),
    Column("is", "what it is"),
]
PEERS = [
    Column("name", "controller"),
    Column("level", "gives", help="a velocity still needs a servo"),
    Column("installed", "installed by"),
    Column("tick_p50_us", "p50", unit="us", format=".1f", better="low"),
    Column("tick_p99_us", "p99", unit="us", format=".1f", better="low"),
    *_WORST,
    Column("times_ours", "over ours", format=".2f", help="its median over that of our tick in Python"),
    Column("times_c", "over ours in C", format=".2f"),
    Column("tip_error_max_mm", "tip", unit="mm", help="largest tip error on an ideal arm, after half a second"),
    Column("rcm_error_max_mm", "shaft", unit="mm", help="largest distance of the shaft from the trocar, likewise"),
    Column("mu_rise_percent", "mu", unit="%", format="+.1f", help="rise of the manipulability in that second"),
]
EXACT = [
    Column("name", "subproblems"),
    Column("solve_p50_us", "p50", unit="us", format=".2f", better="low"),
    Column("solve_p99_us", "p99", unit="us", format=".2f", better="low"),
    Column("kernel_us", "kernel", unit="us", format=".3f", help="inside compiled code, best of five"),
    Column("solve_cold_p50_us", "cold", unit="us", format=".2f", help=_COLD),
    Column("batch_one_thread_per_s", "batch, one thread", unit="1/s", format=".3g", help="solves per second"),
    Column("batch_all_cores_per_s", "batch, all cores", unit="1/s", format=".3g", help="solves per second"),
    Column("batch_threads", "cores", format=".0f"),
    Column("primal_max", "primal", format=".1e"),
    Column("natural_max", "natural", format=".1e"),
    Column("loss_max", "loss", format=".1e"),
]
ADAPTERS = [
    Column("name", "adapter"),
    Column("adapter_p50_us", "adapter", unit="us", format=".2f", better="low"),
    Column("by_hand_p50_us", "by hand", unit="us", format=".2f", help="load the numbers and solve, in a bare loop"),
    Column("library_p50_us", "library", unit="us", format=".2f", help="update and solve alone"),
    Column("ratio", "adapter / by hand", format=".3f", better="low", help="median over the chunks"),
    Column("ratio_low", "from", format=".3f", help="lower quartile of the chunks"),
    Column("ratio_high", "to", format=".3f", help="upper quartile of the chunks"),
    Column("ratio_to_library", "adapter / library", format=".2f"),
]
LOOP = [
    Column("name", "loop"),
    Column("factor", "real time", unit="times", format=".1f", better="high"),
    Column("factor_cpu", "of its own processor time", unit="times", format=".1f", better="high"),
    Column("factor_best", "best run", unit="times", format=".1f"),
    Column("us_per_tick", "all of a tick", unit="us", format=".1f", help="plant, trace and references included"),
    Column("tick_p50_us", "controller p50", unit="us", format=".1f"),
    Column("tick_p99_us", "p99", unit="us", format=".1f"),
    Column("tick_p99_9_us", "p99.9", unit="us", format=".1f"),
]
FACTS = [Column("what", "what"), Column("value", "value"), Column("unit", "unit")]
OTHER = {
    ("loop", "two processes", "speed_up"): ("two processes over one", ""),
    ("loop", "limit", "steps_us"): ("MuJoCo's own steps of a control period, through the run's states", "us"),
    ("loop", "limit", "steps_alone_us"): ("the same of an arm left alone", "us"),
    ("loop", "limit", "limit_us"): ("limit of a tick of the loop: these and the tick in C", "us"),
    ("loop", "memory", "growth_bytes_per_tick"): ("memory that a tick leaves behind, besides the trace", "byte"),
    ("loop", "memory", "trace_bytes_per_tick"): ("the trace itself, per tick", "byte"),
    ("loop", "memory", "kept_short_kB"): ("held after a short run, besides its trace", "kB"),
    ("loop", "memory", "kept_long_kB"): ("held after a long run, besides its trace", "kB"),
    ("loop", "memory", "resident_growth_kB"): ("growth of the process over four more long runs", "kB"),
    ("setup", "moc_opt", "import_s"): ("import moc_opt", "s"),
    ("setup", "moc_opt", "import_process_s"): ("the same as a process of its own, interpreter included", "s"),
    ("setup", "moc_opt", "first_tick_s"): ("first torque of a new process", "s"),
    ("setup", "moc_opt", "libraries_s"): ("of that: loading libraries", "s"),
    ("setup", "moc_opt", "model_s"): ("of that: model and controller", "s"),
    ("setup", "moc_opt", "start_and_tick_s"): ("of that: start and first tick", "s"),
    ("embedded", "c", "own_mean_us"): ("exported C program, a tick in its own loop: mean", "us"),
    ("embedded", "c", "own_p99_9_us"): ("the same with the clock: p99.9", "us"),
    ("embedded", "c", "difference_Nm"): ("largest torque difference between C and Python", "Nm"),
    ("clock", "cost", "p50_us"): ("reading the clock twice, left inside every time", "us"),
}


def tables(summary: Summary) -> dict[str, Table]:
    """Map name to table, in the order of the page; what was not measured is left out."""
    beyond = {name: found["beyond_us"] for name, found in summary["beyond_the_library"].items()}
    ticks = [{"name": name, "beyond_us": beyond.get(name), **found} for name, found in summary["tick"].items()]
    parts = [{"name": name, "is": PARTS.get(name, ""), **found} for name, found in summary["tick_parts"].items()]
    own, c = summary["tick"]["exact"], summary["tick"].get("c")
    rivals = [{"name": "moc_opt", "level": "torque", "times_ours": 1.0, **own}]
    if c is not None:
        rivals.append({"name": "moc_opt in C", "level": "torque", "times_c": 1.0, **c})
    for name, found in summary["peers"].items():
        p50 = found["tick_p50_us"]
        over = {"times_ours": p50 / own["tick_p50_us"], "times_c": p50 / c["tick_p50_us"] if c else None}
        rivals.append({"name": name, **found, **over})
    for name in peers.PEERS:
        if f"peer {name}" in summary["not_run"]:
            rivals.append({"name": name, "installed": f"not run: {summary['not_run'][f'peer {name}']['reason']}"})
    loops = [{"name": name, **found} for name, found in summary["loop"].items() if "factor" in found]
    other = [
        {"what": what, "unit": unit, "value": f"{value:.3g}"}
        for (part, name, key), (what, unit) in OTHER.items()
        if (value := summary[part].get(name, {}).get(key)) is not None
    ]
    goals = [
        {**found, "goal": f"{found['goal']:g}", "value": _short(found["value"]), "why": reason(key, summary),
         "explained": EXPLAINED.get(key, IN_LOOP)}
        for key, found in summary["goals"].items()
    ]  # fmt: skip
    missed = [goal for goal in goals if goal["reached"] == "no"]
    found = {
        "goals": Table("Goals", GOALS, goals),
        "missed": Table("Goals that are missed, and why", [GOALS[0], Column("why", "why")], missed),
        "tick": Table("One tick, state to torque", TICKS, ticks),
        "parts": Table("Parts of a tick with exact", PARTS_COLUMNS, parts),
        "peers": Table("One tick in other libraries, the same job on the same arm", PEERS, rivals),
        "exact": Table("The solver exact", EXACT, _rows(summary["exact"])),
        "adapters": Table("Adapters and their libraries", ADAPTERS, _rows(summary["adapters"])),
        "loop": Table("The closed loop", LOOP, loops),
        "other": Table("Set-up, memory, processes", FACTS, other),
    }
    if summary["not_run"]:
        columns = [Column("name", "not run"), Column("reason", "reason")]
        found["not_run"] = Table("What could not run here", columns, _rows(summary["not_run"]))
    return {name: table for name, table in found.items() if table.rows}


def headline(summary: Summary) -> str:
    """Return the result in words, computed."""
    goals = summary["goals"].values()
    reached = sum(goal["reached"] == "yes" for goal in goals)
    missed = [f"{goal['what']} ({_short(goal['value'])})" for goal in goals if goal["reached"] == "no"]
    own, loop = summary["tick"]["exact"]["tick_p50_us"], summary["loop"]["python"]["factor"]
    said = [f"A tick with `exact` takes {own:.1f} us (median), the closed loop runs {loop:.0f} times real time"]
    if summary["peers"]:
        best = min(summary["peers"], key=lambda name: float(summary["peers"][name]["tick_p50_us"]))
        said.append(f"the fastest peer, {best}, takes {summary['peers'][best]['tick_p50_us']:.1f} us for the same job")
    said.append(f"{reached} of {len(summary['goals'])} goals are reached")
    if missed:
        more = [f"and {len(missed) - 3} more"] if len(missed) > 3 else []
        said.append("not reached: " + "; ".join([*missed[:3], *more]))
    return ". ".join(part[0].upper() + part[1:] for part in said) + "."


TEXTS = {
    "goals": (WHY, "Times depend on the machine, and on what else it does; ratios are measured side by side."),
    "tick": (
        IN_TICKS,
        "Ticks recorded in a closed-loop run with the realistic plant, timed one by one in chunks of 100 that take "
        "turns, without pauses of the garbage collector. A round that is not timed comes first; after it every call "
        "counts. The parts are called by themselves, so that their sum is not exactly "
        "the whole; those with a dash are compiled into the call above them.",
    ),
    "peers": (
        IN_PEERS,
        "Tip on its reference, wrist on the line through the trocar, joint speeds in their limits, and the freedom "
        "left up the gradient of the manipulability. Each has its fastest solver, hard equalities where it takes them, "
        "our compiled gradient where it has none, and is timed on the states of a second on an ideal arm in which it "
        "did the job; one that did not, or is not installed, is listed with the reason. Our tick also runs a momentum "
        "observer and follows the "
        "compliance law of the paper; it is timed on the states of its own run with the realistic plant.",
    ),
    "exact": (
        IN_SOLVERS, "Residuals are judged by the one measure of all solvers, on the recorded and on random arms.",
    ),
    "adapters": (
        IN_ADAPTERS,
        "By hand: the same library with the same settings, set up once, its numbers loaded from the same arrays, "
        "solved, answer and multipliers read. Library: update and solve alone, on numbers that are loaded already.",
    ),
    "loop": (
        IN_LOOP,
        "A run includes references, plant, controller and trace; building the arm is set-up. *judged* also judges "
        "every answer and scans for the largest mu.",
    ),
}  # fmt: skip


def answer(summary: Summary, ticks: Mapping[str, ArrayLike]) -> Answer:
    """Make the first screen out of the summary and the times of the ticks [us]: what was wanted, and what it takes."""
    pictures = [
        Picture(figures.latency_ecdf(ticks), "Time of a tick: further left is faster, steeper is steadier.", "ticks"),
        Picture(figures.latency_ecdf(ticks, tail=True), "The rare late ones: lower at the right is better.", "tail"),
    ]
    parts = {name: found for name, found in summary["tick_parts"].items() if not name.startswith("-")}
    if parts:
        longest = max(parts, key=lambda name: float(parts[name]["tick_p50_us"]))
        ends = {
            name: (of["tick_p50_us"], of["tick_p50_us"], of["tick_p99_us"]) for name, of in parts.items()
        }
        says = f"Where the time of a tick with `exact` goes, median to p99: most of it in `{longest}`."
        drawn = interval_picture(ends, dict.fromkeys(ends, GOOD), "time of a part of the tick [us]", {})
        pictures.append(Picture(drawn, says, "parts"))
    found = tables(summary)["goals"]
    return goals_answer(headline(summary), found.title, found.columns, found.rows, pictures)


def report(summary: Summary, first: Answer, environment: Mapping[str, Any]) -> Page:
    """Make the page out of the summary and its first screen."""
    page = Page("Speed", "ticks, solvers, adapters, the loop, set-up, and other libraries, side by side")
    first.begin(page)
    for name, table in tables(summary).items():
        if name in TEXTS:
            title, text = TEXTS[name]
            page.section(title)
            page.text(text)
        if name != "goals":  # its table is the first screen's
            page.table(table)
    page.environment(environment)
    return page


def _rows(part: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    return [{"name": name, **found} for name, found in part.items()]


def _short(value: float | None) -> str | None:
    return None if value is None else Notation.of([value])(value)
