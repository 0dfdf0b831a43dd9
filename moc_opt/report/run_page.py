"""Show runs on one page: curves, metrics and map."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from moc_opt.errors import MocOptError
from moc_opt.figures import Styles, time_series
from moc_opt.planning.swivel_map import manipulability_map
from moc_opt.report.map_page import add_map
from moc_opt.report.page import Page
from moc_opt.report.replay import load_runs
from moc_opt.report.run_table import description, part, remarks, run_tables, title_of
from moc_opt.robots.model import RobotModel
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace


def load_report(files: Sequence[str | os.PathLike[str]]) -> Page:
    """Make the page of saved runs. Raise the errors of `load_runs`."""
    traces, robot = load_runs(files)
    return run_page(traces, {name: summarize(trace) for name, trace in traces.items()}, robot)


def run_page(traces: Mapping[str, Trace], metrics: Mapping[str, Mapping[str, float]], robot: RobotModel) -> Page:
    """Make the page of runs of one arm; only the runs in ``metrics`` appear in the title."""
    judged = {name: traces[name] for name in metrics}
    styles, page = Styles(traces), Page(title_of(judged), f"runs: {'; '.join(traces)}")
    every = {**metrics, **{name: summarize(trace) for name, trace in traces.items() if name not in metrics}}
    page.section("How it ended")
    for name in every:
        ended = f"{name}{part(traces[name])} {traces[name].meta.get('ended', 'unknown')}"
        page.text("; ".join(filter(None, [ended, description(traces[name]), *remarks(traces[name])])) + ".")
    page.section("Over time")
    page.figure(
        time_series(traces, styles=styles),
        "From top to bottom: manipulability, tip error, distance of the shaft from the trocar, force on the trocar. "
        "The dotted line is the largest manipulability of all poses with the same tip and shaft. If runs coincide, "
        "only the last is visible. A click on a run's name in the legend hides the run.", name="curves",
    )  # fmt: skip
    page.section("Main metrics")
    for table in run_tables(traces, every, first=True):
        page.table(table)
    page.section("Where the elbow went")
    longest = max(float(trace.t_s[-1] - trace.t_s[0]) for trace in traces.values())
    columns = min(max(round(12.0 * longest), 10), 96)
    try:
        add_map(page, manipulability_map(robot, traces, times=columns, swivels=120), styles=styles)
    except MocOptError as error:
        page.text(f"There is no map: {error}")
    page.section("All metrics")
    for table in run_tables(traces, every, explained=True):
        page.table(table)
    return page
