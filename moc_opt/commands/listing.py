"""moc-opt robots | tasks | metrics, and solvers --list: the names that a scenario may contain."""

from __future__ import annotations

import argparse
import inspect
import json
from typing import Any

from moc_opt.commands.running import print_tables
from moc_opt.errors import MocOptError
from moc_opt.figures.notation import pretty_unit
from moc_opt.planning.self_motion import best_freedoms
from moc_opt.report.console import console, print_json
from moc_opt.report.tables import Column, Table
from moc_opt.robots import about, available_robots
from moc_opt.robots.model import load_robot
from moc_opt.solvers.registry import available, defaults
from moc_opt.tasks.paths import kinds, sizes
from moc_opt.trace.metrics import METRICS, load_plugins

Rows = dict[str, dict[str, Any]]
TITLES = {"real": "freedoms", "idle": "idle joints", "tool": "tool [m]", "about": "what it is"}


def print_list(given: argparse.Namespace) -> int:
    """Print the list of a command."""
    title, rows, note = {"robots": robots, "tasks": tasks, "metrics": metrics, "solvers": solvers}[given.command]()
    if given.json:
        print_json(rows)
        return 0
    shown = [{"name": name, **{key: _shown(key, value) for key, value in row.items()}}
             for name, row in rows.items() if row.get("here", "yes") == "yes"]  # fmt: skip
    keys = dict.fromkeys(key for row in rows.values() for key in row if key != "here")
    print_tables([Table(title, [Column("name", "name"), *(Column(key, TITLES.get(key, key)) for key in keys)], shown)])
    console().print(note, markup=False)  # a caption would wrap at the table's width
    return 0


def _shown(key: str, value: Any) -> Any:
    if key == "unit":
        return pretty_unit(value)
    if not isinstance(value, dict):
        return value
    words = {key: f"{of:g}" if isinstance(of, float) else json.dumps(of) for key, of in value.items()}  # as in TOML
    return ", ".join(key if of is None else f"{key} = {words[key]}" for key, of in value.items()) or None


def solvers() -> tuple[str, Rows, str]:
    """List the registered solvers: title, rows and note."""
    rows = {}
    for name, reason in available().items():
        settings = {key: value for key, value in defaults(name).items() if key != "kinematics"} if not reason else {}
        # A plug-in's default may not fit into JSON.
        rows[name] = {"here": reason or "yes", "settings": json.loads(json.dumps(settings, default=repr))}
    absent = ", ".join(name for name, row in rows.items() if row["here"] != "yes")
    note = f"Not installed: {absent}; --json says what is missing." if absent else ""
    return "Solvers, for the keys name and settings of [solver]", rows, note


def robots() -> tuple[str, Rows, str]:
    """List the robots."""
    rows = {}
    for name in available_robots():
        arm = load_robot(name)
        left = best_freedoms(arm)
        rows[name] = {"joints": arm.n, "real": left.real, "idle": len(left.idle), "tool": arm.data.tool_length,
                      "about": about(name)}  # fmt: skip
    more = (
        "Freedoms: independent joint motions with tip and wrist at rest. Idle joints, which never move tip or wrist, "
        "do not count. A name can also be the path of your own robot file. `moc-opt robot check NAME` checks an arm."
    )
    return "Robots, for the key name of [robot]", rows, more


def tasks() -> tuple[str, Rows, str]:
    """List the paths."""
    rows = {}
    for name, words in kinds().items():
        try:
            known = sizes(name)
        except MocOptError:
            known = {}  # a plug-in that does not load: `words` says why
        given = {key: None if value is inspect.Parameter.empty else value for key, value in known.items()}
        rows[name] = {"sizes": given, "about": words}
    return "Tasks, for the keys path and sizes of [task]", rows, "Lengths in m."


def metrics() -> tuple[str, Rows, str]:
    """List the metrics."""
    load_plugins()
    rows = {name: {"unit": one.unit, "about": one.about} for name, one in METRICS.items()}
    return "Metrics, for the key `metrics` of a scenario, or for `moc-opt run --metric`", rows, ""
