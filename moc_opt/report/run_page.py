"""Runs as one page: how each ended, its metrics, its curves, and where it took the elbow."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from moc_opt.errors import MocOptError, ReportError
from moc_opt.figures import Styles, time_series
from moc_opt.planning.swivel_map import manipulability_map
from moc_opt.report.map_page import add_map
from moc_opt.report.page import Page
from moc_opt.report.run_table import asked, below_best, in_short, part, refusals, run_table, warnings
from moc_opt.report.tables import Column, Table
from moc_opt.robots.model import RobotModel
from moc_opt.trace.trace import Trace

COLUMNS_PER_S, COLUMNS = 12.0, (10, 96)
"""Of the map."""


def run_page(
    traces: Mapping[str, Trace], metrics: Mapping[str, Mapping[str, float]], robot: RobotModel, title: str = ""
) -> Page:
    """Make the page.

    Args:
        traces: name -> run, of one arm; a baseline first.
        metrics: name -> metric -> number, of those runs that get a table.
        title: of the page; from the names if empty.

    Raises:
        ReportError: there is no run, or none has a column that can be drawn.
    """
    if not traces:
        raise ReportError("no run: give one trace or more")
    styles, page = Styles(traces), Page(title or " and ".join(traces), f"{robot.data.name}, simulated")
    page.section("How it ended")
    for name in sorted(traces, key=lambda name: name not in metrics):  # what was asked for before its baseline
        trace = traces[name]
        told = [f"{name} {trace.meta.get('ended', 'unknown')}{part(trace)}."]
        told += [f"Asked for: {asked(trace)}."] if asked(trace) else []
        figures = in_short(metrics[name]) if name in metrics and not part(trace) else ""
        below = below_best(trace) if name in metrics else ""
        told += [f"{said[0].upper()}{said[1:]}." for said in (figures, below) if said]
        page.text(" ".join([*told, *(f"{line}." for line in refusals(trace) + warnings(trace))]))
    page.section("What to look at first")
    short = {name: run_table(name, traces[name], values, first=True) for name, values in metrics.items()}
    for shown in beside(short, traces):
        page.table(shown)
    page.section("Over time")
    page.figure(
        time_series(traces, styles=styles),
        "Manipulability with the largest that the self-motion allows (dotted, where it was scanned), tip error by the "
        "robot's own kinematics where that is known, distance of the shaft from the trocar, force on it.",
        name="curves",
    )  # fmt: skip
    page.section("Where the elbow went")
    longest = max(float(trace.t_s[-1] - trace.t_s[0]) for trace in traces.values())
    times = min(max(round(COLUMNS_PER_S * longest), COLUMNS[0]), COLUMNS[1])
    try:
        add_map(page, manipulability_map(robot, traces, times=times, swivels=120), styles=styles)
    except MocOptError as error:
        page.text(f"There is no map: {error}")
    page.section("All metrics")
    whole = {name: run_table(name, traces[name], values, explained=True) for name, values in metrics.items()}
    for shown in beside(whole, traces):
        page.table(shown)
    return page


def beside(tables: Mapping[str, Table], traces: Mapping[str, Trace]) -> list[Table]:
    """Make one table of those of several runs, a column for each run.

    Where a run was broken off they stay apart: figures of a part are no peers of a whole run's.

    Args:
        tables: name of a run -> `run_table` of it, with what each figure says.
        traces: name -> run.
    """
    if len(tables) < 2 or any(part(traces[name]) for name in tables):
        return list(tables.values())
    rows: dict[str, dict[str, Any]] = {}
    for k, run in enumerate(tables.values()):
        for row in run.rows:
            said = row.get("says", "")
            joint = rows.setdefault(row["metric"], {"metric": row["metric"], "says": said})
            joint[f"run {k}"] = row["value"]
            joint["says"] = said if joint["says"] == said else ""
    runs = [Column(f"run {k}", name) for k, name in enumerate(tables)]
    captions = dict.fromkeys(run.caption for run in tables.values() if run.caption)
    columns = [Column("metric", "metric"), *runs, Column("says", "what it says")]
    return [Table(" and ".join(tables), columns, list(rows.values()), "\n".join(captions))]
