"""What ``python -m benchmarks.plan --page`` writes into docs/planning.md, between the marks of its section."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.common import markdown
from benchmarks.planning.tables import LOOPS, tables

PAGE = Path(__file__).resolve().parents[2] / "docs" / "planning.md"
COMMANDS: Mapping[str, str] = {
    "plan": "python -m benchmarks.plan --page",
    "plan-limits": "python -m benchmarks.plan benchmarks/configs/plan-limits.toml --page",
}
"""Configuration that ships, which is also its section of the page -> command. Of the second one the closed loops alone
are shown."""

Summary = Mapping[str, Any]


def page_text(section: str, summary: Summary, environment: Summary) -> str:
    """Return the text of a section, one of `COMMANDS`, from summary and environment of its run."""
    machine, config = environment["machine"], environment["config"]
    trials = ", ".join(f"{robot} {found['trials']}" for robot, found in summary["courses"].items())
    where = f"{machine['cores']} cores, {machine['processor']}, {config['processes']} trials at a time"
    said = f"`{COMMANDS[section]}` (seed {environment['seed']}; poses: {trials}; {where}; means with 95 % intervals):"
    return "\n\n".join([said, *(_whole(summary) if section == "plan" else [_loops(summary)])])


def _whole(summary: Summary) -> Iterator[str]:
    """Yield goals, closed loops, courses, and the checks of map and program."""
    yield _goals(summary)
    for table in tables(summary):
        if table.title != "Goals":
            yield f"{table.title}:\n\n{markdown.of_columns(table.columns, table.rows)}"


def _goals(summary: Summary) -> str:
    """Return a row a goal and a column an arm."""
    robots = list(summary["courses"])
    found: dict[tuple[str, float], dict[str, str]] = {}
    for row in summary["goals"]:
        cell = "not measured" if row["verdict"] == "not measured" else f"{row['value']}: {row['verdict']}"
        found.setdefault((row["goal"], row["limit"]), {})[row["robot"]] = cell
    rows = [[goal, f"{limit:g}", *(cells.get(robot, "") for robot in robots)] for (goal, limit), cells in found.items()]
    return markdown.table(["goal", "at most", *robots], rows)


def _loops(summary: Summary) -> str:
    (table,) = (table for table in tables(summary) if table.columns is LOOPS)
    return markdown.of_columns(table.columns, table.rows)
