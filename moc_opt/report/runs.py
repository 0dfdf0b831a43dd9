"""Saved runs as the pictures want them: named, of one arm, and that arm."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from moc_opt.errors import ReportError
from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.trace.trace import Trace


def load_runs(files: Sequence[str | os.PathLike[str]]) -> tuple[dict[str, Trace], RobotModel]:
    """Load saved traces under the names of their files, and the arm that they share.

    Raises:
        ReportError: there are none, or they are not of one robot and tool.
        TraceError: a file is missing, damaged, or no trace.
    """
    traces: dict[str, Trace] = {}
    for file in map(Path, files):
        name = file.stem if file.stem not in traces else str(file)
        traces[name] = Trace.load(file)
    arms = {name: _robot_table(trace) for name, trace in traces.items()}
    if not traces or len(set(map(str, arms.values()))) > 1:
        raise ReportError(f"traces of {arms or 'nothing'}: give traces of one robot with one tool")
    return traces, robot_of(next(iter(traces.values())))


def robot_of(trace: Trace) -> RobotModel:
    """Load the arm that a trace was run with, from its `meta`.

    Raises:
        ReportError: the trace does not say.
        RobotError, UnknownNameError: that robot cannot be loaded here.
    """
    table = _robot_table(trace)
    if not table.get("name"):
        raise ReportError("the trace does not say which robot it is of: load it yourself with load_robot")
    return load_robot(table["name"], tool_length=table.get("tool_length_m"), tool_mass=table.get("tool_mass_kg"))


def _robot_table(trace: Trace) -> dict[str, Any]:
    table = dict((trace.meta.get("scenario") or {}).get("robot") or {})
    return {**table, "name": table.get("name") or trace.meta.get("robot")}
