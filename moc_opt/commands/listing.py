"""moc-opt robots | tasks | metrics, and solvers --list: the names that a scenario may contain."""

from __future__ import annotations

import argparse
import inspect
from dataclasses import replace
from typing import Any

from moc_opt.commands.running import print_tables
from moc_opt.errors import MocOptError
from moc_opt.inputs.files import plain, to_json
from moc_opt.planning.self_motion import best_freedoms
from moc_opt.report.console import console, print_json
from moc_opt.report.tables import Column, Table
from moc_opt.robots import about, available_robots
from moc_opt.robots.model import load_robot
from moc_opt.scenario.tables import TaskTable
from moc_opt.solvers.registry import available, defaults
from moc_opt.tasks.paths import kinds, sizes
from moc_opt.trace.metrics import METRICS, load_plugins


def print_list(given: argparse.Namespace) -> int:
    """Print the list that the command names; returns 0."""
    table = {"robots": robots, "tasks": tasks, "metrics": metrics, "solvers": solvers}[given.command]()
    if given.json:
        first, *others = [column.key for column in table.columns]
        print_json({str(row[first]): {key: row.get(key) for key in others} for row in table.rows})
        return 0
    if given.command == "solvers":
        table = _those_here(table)
    if given.command == "tasks":
        table = replace(table, rows=[{**row, "sizes": _sizes(row["sizes"])} for row in table.rows])
    print_tables([replace(table, caption="")])
    console().print(table.caption, markup=False)  # below a narrow table it would be a narrow column
    return 0


def solvers() -> Table:
    """Return every registered solver, whether it can run here, and its settings."""
    rows = []
    for name, reason in available().items():
        settings = defaults(name) if reason is None else {}
        known = {key: _plain(value) for key, value in settings.items() if key != "kinematics"}
        rows.append({"solver": name, "here": reason or "yes", "settings": known})
    columns = [Column("solver", "solver"), Column("here", "runs here"), Column("settings", "settings")]
    return Table("Solvers: [solver] name, [solver.settings]", columns, rows)


def _plain(value: Any) -> Any:
    """Return a default as JSON can hold it, or its text: that of a plug-in may be any object."""
    try:
        to_json(value)
    except (TypeError, ValueError):
        return repr(value)
    return plain(value)


def _those_here(every: Table) -> Table:
    """Return the solvers that can run here, with the names of their settings; the caption names the others."""
    here = [row for row in every.rows if row["here"] == "yes"]
    absent = ", ".join(row["solver"] for row in every.rows if row["here"] != "yes")
    caption = f"Not installed: {absent}. " * bool(absent) + "--json: defaults of the settings, and what is missing."
    rows = [{**row, "settings": ", ".join(row["settings"]) or None} for row in here]
    return Table(every.title, [column for column in every.columns if column.key != "here"], rows, caption)


def robots() -> Table:
    """Return every arm of the package: its joints, its freedoms beside tip and shaft, and its description."""
    rows = []
    for name in available_robots():
        arm = load_robot(name)
        left = best_freedoms(arm)
        rows.append({
            "robot": name, "joints": arm.n, "real": left.real, "idle": len(left.idle),
            "tool": arm.data.tool_length, "about": about(name),
        })  # fmt: skip
    columns = [
        Column("robot", "robot"), Column("joints", "joints"), Column("real", "freedoms"), Column("idle", "idle"),
        Column("tool", "tool", "m"), Column("about", "what it is"),
    ]  # fmt: skip
    more = "A path to a robot file of your own may stand in the place of a name; `moc-opt robot check NAME` says more."
    return Table("Robots: [robot] name", columns, rows, more)


def tasks() -> Table:
    """Return every path, its sizes with their defaults, and its description."""
    rows = []
    for name, words in kinds().items():
        try:
            known = {**sizes(name), **TaskTable.DEFAULT_SIZES.get(name, {})}
        except MocOptError:
            known = {}  # it does not load: its description is the reason
        defaults = {key: None if value is inspect.Parameter.empty else value for key, value in known.items()}
        rows.append({"path": name, "sizes": defaults, "about": words})
    columns = [Column("path", "path"), Column("sizes", "sizes"), Column("about", "what it is")]
    return Table("Tasks: [task] path, [task.sizes]", columns, rows, "Lengths in m.")


def _sizes(sizes: dict[str, Any]) -> str | None:
    """Write the sizes of a path in one line; one without a default is a name alone."""
    return ", ".join(key if value is None else f"{key} = {value:g}" for key, value in sizes.items()) or None


def metrics() -> Table:
    """Return every metric with its unit."""
    load_plugins()
    rows = [{"metric": name, "unit": one.unit, "about": one.about} for name, one in METRICS.items()]
    columns = [Column("metric", "metric"), Column("unit", "unit"), Column("about", "what it is")]
    return Table("Metrics: metrics = [...] of a scenario, run --metric", columns, rows)
