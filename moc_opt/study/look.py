"""Where the elbow goes in one trial: the map of manipulability with every run on it, and a replay of two of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from moc_opt.errors import MocOptError
from moc_opt.figures.style import Styles
from moc_opt.planning.swivel_map import FEASIBLE, SwivelMap, manipulability_map
from moc_opt.report.map_page import add_map
from moc_opt.report.page import Page
from moc_opt.report.replay import Replay
from moc_opt.robots.model import RobotModel
from moc_opt.study.trials import BASELINE
from moc_opt.trace.trace import Trace

COLUMNS_PER_S, COLUMNS, ROWS = 12.0, (10, 96), 120
"""Of a map: a column takes 20 ms, and a run of 1 s shows no more in a hundred of them than in a dozen."""
EQUAL = 1e-3  # mean mu that differs by less is no reason to prefer one run to another
REPLAY = "replay.html"


def add_look(page: Page, folder: Path, robot: RobotModel, traces: Mapping[str, Trace], trial: str) -> None:
    """Append the map of a trial, and write the replay of the baseline beside the best to ``folder``.

    A reason stands in place of what cannot be drawn: a report is not lost for want of a figure.
    """
    styles = Styles(traces)
    found = trial_map(robot, traces)
    if isinstance(found, str):
        page.text(f"There is no map of trial {trial}: {found}")
    else:
        page.text("Of controllers whose elbows go the same way one is drawn; the table names the others.")
        add_map(page, found, what=f"trial {trial}", styles=styles)
    pair = {name: traces[name] for name in baseline_and_best(traces)}
    try:
        Replay(pair, robot, title=f"Trial {trial}: {' and '.join(pair)}", styles=styles).save(folder / REPLAY)
    except MocOptError as error:
        page.text(f"There is no replay: {error}")
        return
    page.link(
        REPLAY, f"Watch {' beside '.join(pair)} in 3-D",
        f": `{REPLAY}`, a file beside this one that opens by itself; this report is complete without it.",
    )  # fmt: skip


def trial_map(robot: RobotModel, traces: Mapping[str, Trace]) -> SwivelMap | str:
    """Return the map of one trial, or the reason why there is none."""
    if not traces:
        return "no run of this trial came to its end"
    low, high = COLUMNS
    longest = max(float(trace.t_s[-1] - trace.t_s[0]) for trace in traces.values())
    times = min(max(round(COLUMNS_PER_S * longest), low), high)
    try:
        found = manipulability_map(robot, traces, times=times, swivels=ROWS)
    except MocOptError as error:
        return str(error)
    return found if (found.limit == FEASIBLE).any() else "no pose on it is within the joint limits"


def baseline_and_best(traces: Mapping[str, Trace]) -> list[str]:
    """Return the baseline, and the run with the largest mean mu: the first of those that are as good."""
    means = {name: float(trace.mu.mean()) for name, trace in traces.items() if name != BASELINE}
    best = [name for name, mean in means.items() if mean >= (1.0 - EQUAL) * max(means.values())]
    return [name for name in (BASELINE, *best[:1]) if name in traces]
