"""The replay as one HTML file: the arm moves in a small WebGL viewer, its curves move along, nothing is fetched."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from moc_opt.errors import ReportError
from moc_opt.figures.series import PANELS
from moc_opt.figures.style import DARK, Styles
from moc_opt.model.robot_model import RobotModel
from moc_opt.redundancy.showable import check
from moc_opt.report.document import render, save_document
from moc_opt.report.replay.arm import arm_parts
from moc_opt.report.replay.tracks import Block, frame_times, run_track
from moc_opt.report.runs import load_runs
from moc_opt.trace.trace import Trace

MOST_RUNS = 4


class Replay:
    """One to four runs of one arm, side by side at the same time.

    The file needs a browser of 2023 or later, no server and no network. Append ``#t=3.2`` to its address to
    open it at that second.
    """

    def __init__(
        self, traces: Mapping[str, Trace], robot: RobotModel, *, title: str = "", styles: Styles | None = None
    ) -> None:
        """Check the runs.

        Args:
            traces: name -> run, in the order in which they are shown.
            robot: their arm; `robot_of` finds it from a trace.
            title: of the page; from the names if empty.
            styles: of each run, as in a report's figures; None assigns colours anew.

        Raises:
            ReportError: no runs, too many, or one that cannot be shown with this arm.
        """
        if not 1 <= len(traces) <= MOST_RUNS:
            raise ReportError(f"{len(traces)} runs: give 1 to {MOST_RUNS}, more are too small to see")
        for name, trace in traces.items():
            check(name, trace, robot)
        self.traces, self.robot = MappingProxyType(dict(traces)), robot
        self.title = title or " and ".join(traces)
        self._styles = styles or Styles(traces)

    @classmethod
    def load(cls, files: Sequence[str | os.PathLike[str]]) -> Self:
        """Load a replay of saved traces, named as their files are.

        Raises:
            ReportError: they are not of one robot and tool, or cannot be shown.
            TraceError: a file is missing, damaged, or no trace.
        """
        traces, robot = load_runs(files)
        return cls(traces, robot)

    def data(self) -> tuple[dict[str, Any], str]:
        """Return what the page shows: a JSON value, and the block of numbers it points into."""
        block, times = Block(), frame_times(self.traces)
        runs = []
        for name, trace in self.traces.items():
            color = self._styles[name].color
            track = run_track(name, trace, self.robot, times, block)
            runs.append({**track, "color": {"light": color, "dark": DARK.get(color, color)}})
        panels = [{"title": PANELS[column][0], "zero": column != "mu"} for column in PANELS]
        value = {
            "times": block.put(times), "runs": runs, "panels": panels,
            "parts": [part.plain() for part in arm_parts(self.robot)],
            "reach": float(np.linalg.norm(self.robot.chain.origins, axis=1).sum() + self.robot.data.tool_length),
        }  # fmt: skip
        return value, block.packed()

    def html(self) -> str:
        """Return the whole file as text."""
        value, packed = self.data()
        robot = self.robot.data
        return render(
            "replay.html", title=self.title, subtitle=f"{robot.name}, tool of {robot.tool_length:.2f} m",
            bound=", ".join(dict.fromkeys(
                str(trace.meta["mu_bound_method"]) for trace in self.traces.values() if "mu_bound_method" in trace.meta
            )),
            value=json.dumps(value, allow_nan=False, separators=(",", ":")), numbers=packed,
        )  # fmt: skip

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the file, all or nothing: an older one of that name stays until the new one is there.

        Raises:
            ReportError: it would be larger than `document.MAX_BYTES`, or cannot be written.
        """
        return save_document(
            path, self.html(), "replay", lambda: "show fewer runs, or a part of them (`trace.select`)"
        )
