"""The page of ``python -m benchmarks.speed``: its goals first, and the figures around each of them below."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike

from benchmarks import baselines as peers
from benchmarks.common.answer import Answer, Picture, goals_answer
from benchmarks.common.goals import goal_table, goals_in_words
from benchmarks.latency.runs import PARTS
from benchmarks.latency.verdict import GOALS, LOOP, PEERS, SOLVERS, TICKS
from moc_opt import figures
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table
from moc_opt.study.timing import load

Summary = Mapping[str, Any]


def _times(key: str, digits: int = 1) -> list[Column]:
    return [
        Column(f"{key}_{p}_us", p.replace("_", "."), unit="us", format=f".{digits}f", better="low")
        for p in ("p50", "p99", "p99_9")
    ]


_COLD = Column("tick_cold_p50_us", "cold", unit="us", format=".1f", better="low",
               help="median of the five calls after another entry's turn; the percentiles count them too")  # fmt: skip
_LONGEST = Column("tick_max_us", "longest", unit="us", format=".1f", better="low")
COLUMNS = {
    "tick": ("One tick, state to torque", [Column("name", "tick with"), *_times("tick"), _COLD, _LONGEST]),
    "parts": ("Parts of a tick with exact", [
        Column("name", "part"), *_times("tick", 2)[:2], Column("is", "what it is"),
    ]),
    "peers": ("One tick in other libraries, the same job on the same arm", [
        Column("name", "controller"),
        Column("level", "gives", help="a velocity still needs a servo"),
        Column("installed", "installed by"),
        *_times("tick")[:2],
        Column("times_ours", "over ours", format=".2f", help="median over the chunks"),
        Column("tip_error_max_mm", "tip", unit="mm", help="largest tip error on an ideal arm, after half a second"),
        Column("rcm_error_max_mm", "shaft", unit="mm", help="largest distance of shaft from trocar, likewise"),
        Column("mu_rise_percent", "mu", unit="%", format="+.1f", help="rise of the manipulability in that second"),
    ]),
    "adapters": ("Adapters and their libraries", [
        Column("name", "adapter"),
        Column("adapter_p50_us", "adapter", unit="us", format=".2f", better="low"),
        Column("by_hand_p50_us", "by hand", unit="us", format=".2f", help="load the numbers and solve, in a bare loop"),
        Column("ratio", "adapter / by hand", format=".3f", better="low", help="median over the chunks"),
        Column("ratio_of_exact", "exact / by hand", format=".3f", help="median over the chunks"),
    ]),
    "loop": ("The closed loop", [
        Column("name", "loop"),
        Column("factor", "real time", unit="times", format=".1f", better="high"),
        Column("us_per_tick", "all of a tick", unit="us", format=".1f", help="plant, trace and references included"),
        *_times("tick"),
    ]),
    "not_run": ("What could not run here", [Column("name", "not run"), Column("reason", "reason")]),
}  # fmt: skip
SECTIONS = {
    TICKS: (
        ("tick", "parts"),
        "Ticks recorded in a closed-loop run with the realistic plant, timed one by one in chunks of 100 that take "
        "turns, without pauses of the garbage collector. A round that is not timed comes first; after it every call "
        "counts. The parts are called by themselves, so that their sum is not exactly the whole. `c` is `moc_step`, "
        "safety filter included, in the exported program.",
    ),
    PEERS: (
        ("peers",),
        "Tip on its reference, wrist on the line through the trocar, joint speeds in their limits, the freedom left up "
        "the gradient of the manipulability. Each has its fastest solver, hard equalities where it takes them, our "
        "compiled gradient where it has none, and is timed on the states of a second on an ideal arm in which it did "
        "the job. Our tick is timed on the states of its own run with the realistic plant.",
    ),
    SOLVERS: (
        ("adapters",),
        "By hand: the same library with the same settings, set up once, its numbers loaded from the same arrays, "
        "solved, answer and multipliers read.",
    ),
    LOOP: (
        ("loop",),
        "A run includes references, plant, controller, trace and what feeds the progress bar; building the arm is "
        "set-up, and judging the answers comes after it. The limit is MuJoCo's own steps of a control period through "
        "the states of the run, and `moc_step`.",
    ),
}  # fmt: skip


def tables(summary: Summary) -> dict[str, Table]:
    """Map name to table; what was not measured is left out."""
    own, absent = summary["tick"]["exact"], summary["not_run"]
    rows = {name: _rows(summary[name]) for name in ("tick", "adapters", "loop", "not_run")}
    rows["parts"] = [{"is": PARTS[row["name"]], **row} for row in _rows(summary["tick_parts"])]
    rows["peers"] = [{"name": "moc_opt", "level": "torque", "times_ours": 1.0, **own}, *_rows(summary["peers"])]
    rows["peers"] += [
        {"name": name, "installed": f"not run: {absent[f'peer {name}']['reason']}"}
        for name in peers.PEERS if f"peer {name}" in absent
    ]  # fmt: skip
    rows["loop"] = [row for row in rows["loop"] if "factor" in row]
    found = {name: Table(title, columns, rows[name]) for name, (title, columns) in COLUMNS.items()}
    return {name: table for name, table in found.items() if table.rows}


def sentences(summary: Summary) -> str:
    own, loop = summary["tick"]["exact"]["tick_p50_us"], summary["loop"]["python"]["factor"]
    said = [f"A tick with `exact` takes {own:.1f} us (median), the closed loop runs {loop:.0f} times real time."]
    if summary["peers"]:
        name = min(summary["peers"], key=lambda peer: float(summary["peers"][peer]["times_ours"]))
        fastest = summary["peers"][name]
        said.append(
            f"The fastest other library, {name}, takes {fastest['tick_p50_us']:.1f} us for the same job, "
            f"{fastest['times_ours']:.2g} times ours."
        )
    words = goals_in_words(summary["goals"])
    return " ".join([*said, words[0].upper() + words[1:]])


def answer(summary: Summary, ticks: Mapping[str, ArrayLike]) -> Answer:
    """Make the first screen out of the summary and the times of the ticks [us]."""
    goals = goal_table(summary["goals"], GOALS)
    drawn = figures.latency_ecdf(ticks)
    picture = Picture(drawn, "Time of a tick: further left is faster, steeper is steadier.", "ticks")
    return goals_answer(
        sentences(summary), goals.title, goals.columns, goals.rows, [picture], load(timed_rows(summary))
    )


def timed_rows(summary: Summary) -> list[Mapping[str, Any]]:
    """Return the rows of the summary whose times were taken one by one."""
    names = ("tick", "tick_parts", "peers", "adapters", "loop")
    return [row for part in names for row in summary[part].values()]


def report(summary: Summary, first: Answer, environment: Mapping[str, Any]) -> Page:
    page = Page("Speed", "ticks, solvers, adapters, the loop, new processes, and other libraries, side by side")
    first.begin(page)
    shown = tables(summary)
    for title, (names, text) in SECTIONS.items():
        page.section(title)
        page.text(text)
        for name in names:
            if name in shown:
                page.table(shown[name])
    if "not_run" in shown:
        page.section("Not run")
        page.table(shown["not_run"])
    page.environment(environment)
    return page


def _rows(part: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    return [{"name": name, **found} for name, found in part.items()]
