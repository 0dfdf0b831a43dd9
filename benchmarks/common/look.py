"""Views of one trial for a benchmark: the elbows on the manipulability map, and a replay of two arms."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from moc_opt.errors import MocOptError
from moc_opt.figures.style import Styles
from moc_opt.planning.swivel_map import FEASIBLE, SwivelMap, manipulability_map
from moc_opt.report.page import Page
from moc_opt.report.replay import Replay
from moc_opt.robots.model import RobotModel
from moc_opt.trace.trace import Trace

COLUMNS_PER_S, COLUMNS, ROWS = 12.0, (10, 96), 120
"""Of a map: a column takes 20 ms, and a run of 1 s shows no more in a hundred of them than in a dozen."""
REPLAY = "replay.html"


def trial_map(robot: RobotModel, traces: Mapping[str, Trace]) -> SwivelMap | str:
    """Return the map of one trial, or the reason why there is none: a report is not lost for want of one figure."""
    if not traces:
        return "no run of this trial came to its end"
    low, high = COLUMNS
    longest = max(float(trace.t_s[-1] - trace.t_s[0]) for trace in traces.values())
    try:
        found = manipulability_map(
            robot, traces, times=min(max(round(COLUMNS_PER_S * longest), low), high), swivels=ROWS
        )
    except MocOptError as error:
        return str(error)
    return found if (found.limit == FEASIBLE).any() else "no pose on it is within the joint limits"


def add_replay(
    page: Page, folder: Path, robot: RobotModel, traces: Mapping[str, Trace], title: str, styles: Styles
) -> None:
    """Write the replay beside the report, and link to it; the reason where there is none.

    Args:
        folder: that it will lie in.
        traces: name -> run, the baseline first.
    """
    try:
        Replay(traces, robot, title=title, styles=styles).save(folder / REPLAY)
    except MocOptError as error:
        page.text(f"There is no replay: {error}")
        return
    page.link(
        REPLAY, f"Watch {' beside '.join(traces)} in 3-D",
        f": `{REPLAY}`, a file beside this one that opens by itself; this report is complete without it.",
    )  # fmt: skip
