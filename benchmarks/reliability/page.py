"""What the fault benchmark shows: its report, and docs/reliability.md.

docs/reliability.md is made from benchmarks/templates/reliability.md and docs/reliability.json alone.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.common import markdown, output
from benchmarks.common.answer import Answer, Picture, goals_answer
from benchmarks.reliability.verdict import Row, Summary, case_rows, headline
from moc_opt import figures
from moc_opt.figures.notation import Notation
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table
from moc_opt.trace.trace import Trace

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reliability.md"
TITLES = {
    "none": "no fault", "solver": "solver", "sensors": "sensors and packets", "plant": "plant and delay",
    "contact": "bumps and trocar", "camera": "camera",
}  # fmt: skip
EVERY, SOLVERS = "Every fault", "Solver faults"
CASES = [
    Column("case", "fault"), Column("solver", "controller"),
    Column("outcome", "outcome", help="of the trials: survived within the limits, or stopped safely"),
    Column("tip_error_max_mm", "worst tip", unit="mm", format=".2f", help="until the stop, where there was one"),
    Column("rcm_error_max_mm", "worst RCM", unit="mm", format=".2f", help="the stop included"),
    Column("trocar_force_max_N", "worst force", unit="N", format=".2f"),
    Column("rcm_mean_percent", "mean RCM", unit="%", format="+.1f", help="above the same run without the fault"),
    Column("recover_s", "recovered after", unit="s", format=".2f", help="from the fault's end, or its start where it "
           "lasts: both errors below 1.2 times the fault-free level for good; a dash: not within the run"),
    Column("stop_travel_mm", "stop travel", unit="mm", format=".1f", help="of the tip after the stop began"),
]  # fmt: skip
SEEN = [
    Column("case", "fault"), Column("solver", "controller"), Column("injected", "injected", format=".0f"),
    Column("detected", "detected", format=".0f"),
    Column("harmless", "harmless", format=".0f", help="corrupted, taken, and verified as optimal all the same"),
    Column("missed", "missed", format=".0f"),
    Column("false_alarms", "false alarms", format=".0f", help="honest answers that were refused"),
]  # fmt: skip
GOALS = [
    Column("goal", "goal"), Column("limit", "limit", align="right"),
    Column("value", "found", align="right", sections="explained"), Column("reached", "reached"),
    Column("where", "where", section=EVERY),
]  # fmt: skip


def answer(summary: Summary, goals: Sequence[Row], traces: Mapping[str, Trace]) -> Answer:
    """Make the first screen out of the summary, the goals and the traces of one trial."""
    shown = [  # the quantities have nothing in common: each is written for itself
        {**goal, "limit": f"{goal['limit']:g}", "value": Notation.of([goal["value"]])(goal["value"]),
         "explained": SOLVERS if "refused" in goal["goal"] or "noticed" in goal["goal"] else EVERY}
        for goal in goals
    ]  # fmt: skip
    says = "MOC with exact, first trial: errors and trocar force come back after a fault, or the arm has stopped."
    columns = ("tip_error_m", "rcm_error_m", "trocar_force_N")
    pictures = [Picture(figures.time_series(traces, columns), says, "faults")] if traces else []
    return goals_answer(headline(summary, goals), "Goals", GOALS, shown, pictures)


def report(summary: Summary, first: Answer, environment: Mapping[str, Any]) -> Page:
    """Make the page out of the summary and its first screen."""
    page = Page("Faults", "every fault under every controller: survived, or stopped safely")
    first.begin(page)
    page.section(EVERY)
    page.table(Table("Every fault under every controller: the worst of the trials", CASES, case_rows(summary)))
    page.section(SOLVERS)
    page.table(Table("Solver faults, injected and detected", SEEN, by_group(summary).get("solver", [])))
    page.environment(environment)
    return page


def by_group(summary: Summary) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of the cases, group by group."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in case_rows(summary):
        groups.setdefault(str(row["group"]), []).append(row)
    return groups


def page(found: Mapping[str, Any]) -> str:
    """Make docs/reliability.md from the figures of a run (``cases``, ``goals``, ``environment``)."""
    groups = by_group(found["cases"])
    return markdown.render(
        "reliability.md", **found["environment"], headline=headline(found["cases"], found["goals"]),
        goals=markdown.of_columns(GOALS, found["goals"]), seen=markdown.of_columns(SEEN, groups.get("solver", [])),
        groups=[(title, markdown.of_columns(CASES, groups[name])) for name, title in TITLES.items() if name in groups],
    )  # fmt: skip


def write_page(found: Mapping[str, Any], path: Path = PAGE) -> None:
    """Write the page, and beside it the figures that it was made from."""
    figures = path.with_suffix(".json")
    output.write_json(figures, dict(found))
    # from the file, not from the values written to it: a later reader must make the same page
    output.write_atomically(path, page(json.loads(figures.read_text(encoding="utf-8"))).encode())
