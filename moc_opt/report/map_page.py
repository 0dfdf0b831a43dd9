"""The manipulability map: a figure, a part of a page with its result in words and numbers, a page of its own."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.errors import ReportError
from moc_opt.figures.notation import Missing
from moc_opt.figures.style import BAD, INK, MUTED, Style, Styles, figure, label, legend_height
from moc_opt.planning.swivel_map import (
    ALIKE_RAD,
    CLOSE_RAD,
    END,
    FEASIBLE,
    NEAR,
    OTHER_BRANCH_RAD,
    UNREACHABLE,
    End,
    Reading,
    SwivelMap,
    Trajectory,
    alike,
    manipulability_map,
    read_trajectory,
)
from moc_opt.report.page import Page
from moc_opt.report.replay import load_runs
from moc_opt.report.run_table import below_best
from moc_opt.report.tables import Column, Table
from moc_opt.trace.trace import Trace

MOST_LINES = 8
# Light to dark, so that lines of any of the house's colours with a white edge stand out; the same on dark pages.
SCALE = ((0.0, "#f4f1e6"), (0.25, "#cfe0cf"), (0.5, "#8fc4bd"), (0.75, "#3f8f9c"), (1.0, "#143f5c"))
EDGE, BEST = "#fffffe", "#17191b"
HEIGHT_PX = 460
SHARED = ("9px,9px", "5px,13px", "3px,15px")
"""Dashes of the second, third and further trajectories on one line: the colours of all of them show."""
LEAP_DEG = 25.0
"""From one time to the next: a line that turns by more has a gap there."""
HOVER = "%{x:.2f} s, %{y:.0f}°: µ = %{customdata:.3f} m³<extra>%{fullData.name}</extra>"
COLUMNS = (
    Column("name", "trajectory"),
    Column(
        "near", "at the optimum", unit="%", format=".0f", better="high",
        help=f"of the time: mu at most {100 * NEAR:.0f} % below the best at that time",
    ),
    Column("from_s", "for good from", unit="s", format=".1f", better="low", help="from then on it stays there"),
    Column("mu_percent", "of the best mu", unit="%", format=".1f", better="high", help="mean over mean"),
    Column("travel", "elbow turns", unit="deg", format="+.0f", help="from its start to its end"),
    Column(
        "at_edge", "at the feasible edge", unit="%", format=".0f", better="low",
        help="of the time: no farther than a row of the map from a pose that is not allowed",
    ),
    Column(
        "end", "in the end",
        help=f"over the last {100 * END:.0f} % of the time; held by a local maximum or the feasible edge: less than "
        f"{np.degrees(CLOSE_RAD):.0f} deg before it, mu rising",
    ),
)  # fmt: skip


def add_map(
    page: Page, found: SwivelMap, *, name: str = "map", what: str = "", styles: Styles | None = None
) -> list[Reading]:
    """Append words, figure and table of one map.

    Of more than eight trajectories those that cannot be told apart are drawn as one.

    Args:
        found: of `manipulability_map`.
        name: of the figure's file.
        what: it is a map of, in a few words, for caption and table.
        styles: of each run, as in the page's other figures.

    Returns:
        What each trajectory amounts to, those that are not drawn among them.

    Raises:
        ReportError: no pose of the map is allowed.
    """
    kinds, titles = kinds_of(found), lines(found)
    readings = {trajectory: read_trajectory(found, trajectory) for trajectory in found.trajectories}
    figure = map_figure(found, styles, titles=titles)
    if found.held:
        page.text(slice_words(found.held))
    page.text(in_words([readings[first] for first in kinds], titles))
    page.figure(figure, caption(found, what), name=name)
    page.table(trajectory_table(readings, kinds, what))
    return list(readings.values())


def kinds_of(found: SwivelMap) -> dict[str, list[str]]:
    """Return the trajectories to speak of -> those that go the same way and are not spoken of, where there are many."""
    return alike(found) if len(found.trajectories) > MOST_LINES else {name: [] for name in found.trajectories}


def lines(found: SwivelMap) -> dict[str, str]:
    """Return the trajectories to draw, eight at most -> what to call each in the legend."""
    kinds = list(kinds_of(found).items())[:MOST_LINES]
    return {first: first + (f" and {len(others)} more" if others else "") for first, others in kinds}


def caption(found: SwivelMap, what: str = "") -> str:
    """Say what the figure shows, and how finely."""
    times, swivels = found.mu.shape
    begin = f"{what[:1].upper()}{what[1:]}: every" if what else "Every"
    return (
        f"{begin} pose that keeps tip and trocar, over time ({times} by {swivels} poses): upwards the swivel of the "
        "elbow, as colour the manipulability mu; grey where a joint would be beyond its limit or the arm does not "
        "reach. A line is the trajectory of a run, from the marker at its start, and of several colours where runs go "
        "the same way; the dotted one joins the best poses, and may leap where no arm can follow."
    )


def slice_words(held: Sequence[str]) -> str:
    """Say which poses a map of several freedoms leaves out."""
    several = len(held) > 1
    return (
        f"A slice: tip and trocar leave this arm {len(held) + 1} freedoms, and the map shows one. {', '.join(held)} "
        f"{'stand' if several else 'stands'} as in the longest run; poses with {'them' if several else 'it'} elsewhere "
        "may have a larger mu than the best shown here."
    )


def in_words(readings: Sequence[Reading], titles: Mapping[str, str] | None = None) -> str:
    """Say which runs are at the optimum, which are not, and why.

    Args:
        titles: name -> what the figure calls it.
    """
    called = {reading.name: (titles or {}).get(reading.name, reading.name) for reading in readings}
    known = sorted((r for r in readings if np.isfinite(r.near)), key=lambda reading: -reading.near)
    timed = []
    for reading in known:
        if not _never(reading):
            once = reading.from_s > 0.0 and reading.near < 1.0
            since = f" (from {reading.from_s:.1f} s on for good)" if once else ""
            timed.append(f"{called[reading.name]} for {100.0 * reading.near:.0f} %{since}")
    limit = f"mu at most {100.0 * NEAR:.0f} % below the best pose of that time"
    said = [f"At the optimum ({limit}), as a share of the time: {'; '.join(timed) or 'none'}."] if known else []
    groups: dict[str, list[str]] = {}
    for reading in readings:
        never = "never at the optimum; " if _never(reading) else ""
        for words in (edge_in_words(reading), never + end_in_words(reading)):
            groups.setdefault(words, []).append(called[reading.name])
    groups.pop("", None)
    return " ".join([*said, *(f"{', '.join(names)}: {words}." for words, names in groups.items())])


def _never(reading: Reading) -> bool:
    return reading.near < 0.005


def end_in_words(reading: Reading) -> str:
    """Say how a trajectory ends."""
    limit = f"the limit of joint {reading.joint}" if reading.joint else "the arm's reach"
    return {
        End.OPTIMUM: "in the end at the optimum",
        End.LOCAL_MAXIMUM: "in the end at a local maximum, where to either side mu falls before it rises to the best",
        End.FEASIBLE_EDGE: f"in the end at the edge of the feasible poses, where mu rises beyond {limit}",
        End.STILL: "at rest in the end, though mu rises to one side (joint limits are in the map, the narrower box of "
        "the third level is not)",
        End.RISING: "still gaining mu when the run ends",
        End.FALLING: "losing mu when the run ends",
        End.OTHER_BRANCH: "on another branch of the inverse kinematics, where the map does not hold",
        End.UNKNOWN: "nowhere on the map, where no pose is allowed",
    }[reading.end]


def edge_in_words(reading: Reading) -> str:
    """Say where on the way it touches the feasible edge; nothing for one that keeps away from it."""
    if not reading.at_edge > 0.0 or reading.end is End.FEASIBLE_EDGE:
        return ""
    joints = [f"joint {joint}" for joint in reading.limits]
    return f"on the way at the feasible edge ({', '.join(joints) or 'out of reach'})"


def trajectory_table(readings: Mapping[str, Reading], kinds: Mapping[str, Sequence[str]], what: str = "") -> Table:
    """Make a table with one row for each kind of trajectory, in their order."""
    rows = []
    for first in kinds:
        reading = readings[first]
        rows.append(
            {
                "name": first, "near": 100.0 * reading.near, "from_s": reading.from_s,
                "mu_percent": 100.0 * reading.mu_share, "travel": np.degrees(reading.travel_rad),
                "at_edge": 100.0 * reading.at_edge,
                "end": f"{reading.end}, joint {reading.joint}" if reading.joint else str(reading.end),
            }
        )  # fmt: skip
        if reading.end is not End.OPTIMUM:
            rows[-1]["from_s"] = Missing("not there in the end")
    stand_for = [f"{first} stands for {', '.join(others)} too" for first, others in kinds.items() if others]
    apart = f"within {np.degrees(ALIKE_RAD):.0f} deg of its elbow at all times"
    note = f"{'; '.join(stand_for)}: {apart}." if stand_for else ""
    return Table(f"Trajectories on the map{': ' * bool(what)}{what}", COLUMNS, rows, note)


def load_map(files: Sequence[str | os.PathLike[str]]) -> Page:
    """Return a page with the map of saved traces, named as their files are.

    Raises:
        ReportError: they are not of one robot, tool and path, or cannot be shown.
        RobotError: the arm has no elbow whose angle tells its poses apart.
        TraceError: a file is missing, damaged, or no trace.
    """
    traces, robot = load_runs(files)
    page = Page("Manipulability along the path", " and ".join(traces))
    for name, sentence in ((name, below_best(trace)) for name, trace in traces.items()):
        if sentence:
            page.text(f"{name}: {sentence}.")
    add_map(page, manipulability_map(robot, {**traces, **best_courses(traces)}))
    return page


def best_courses(traces: Mapping[str, Trace]) -> dict[str, Trace]:
    """Return the best courses that the traces hold as trajectories of their own, one for each start."""
    found: dict[str, Trace] = {}
    for name, trace in traces.items():
        course = trace.columns.get("q_best_from_start_rad")
        if course is not None and not any(np.array_equal(course[0], other.q_rad[0]) for other in found.values()):
            found[f"best course from the start of {name}"] = trace.with_columns(q_rad=course)
    return found


# --- the figure ---


def map_figure(
    found: SwivelMap, styles: Styles | None = None, *, titles: Mapping[str, str] | None = None
) -> go.Figure:
    """Draw mu as colour over time and swivel, grey where no pose is allowed, and a line for every run.

    A run that folds the arm another way than the map is dotted: the colours under it are not its own. Where several
    runs go the same way, the line changes between their colours.

    Args:
        found: of `manipulability_map`.
        styles: of each run, as in other figures; None assigns colours anew.
        titles: the runs that are drawn -> what the legend calls them; None: all, by their names.

    Raises:
        ReportError: no pose of the map is allowed.
    """
    styles = styles or Styles(found.trajectories)
    titles = {name: name for name in found.trajectories} if titles is None else titles
    allowed = found.limit == FEASIBLE
    if not allowed.any():
        raise ReportError("no pose on the map is within the joint limits: check trocar and path")
    degrees = np.degrees(found.swivel_rad)
    drawn = figure(height=HEIGHT_PX + legend_height([*titles.values(), "best", "not allowed"]))
    _colors(drawn, found, degrees, allowed)
    t_best, y_best = _broken(found.t_s, np.degrees(found.best_swivel_rad))
    _edge(drawn, t_best, y_best, "best")
    places = {name: k for first, others in alike(found).items() for k, name in enumerate([first, *others])}
    # First what has a white edge, then what shares its line with one of these.
    for name in sorted(titles, key=lambda name: min(places[name], 1)):
        trajectory, style = found.trajectories[name], styles[name]
        if trajectory.gap_rad > OTHER_BRANCH_RAD:
            style = Style(style.color, "dot", style.symbol)
        elif places[name] and len(titles) > 1:
            style = Style(style.color, SHARED[min(places[name], len(SHARED)) - 1], style.symbol)
        t, y = _broken(trajectory.t_s, np.degrees(trajectory.swivel_rad))
        if style.dash not in SHARED:
            _edge(drawn, t, y, name)
        drawn.add_scatter(
            x=t, y=y, mode="lines", name=label(titles[name]), legendgroup=name, connectgaps=False,
            legendrank=list(titles).index(name) + 1, customdata=np.interp(t, trajectory.t_s, trajectory.mu),
            line={"color": style.color, "width": 2.4, "dash": style.dash}, hovertemplate=HOVER,
        )  # fmt: skip
    # Above the others: a run that has arrived lies on it.
    _best(drawn, t_best, y_best, np.interp(t_best, found.t_s, found.best_mu))
    _starts(drawn, [found.trajectories[name] for name in titles])
    drawn.add_scatter(
        x=[None], y=[None], mode="markers", name="not allowed",
        marker={"symbol": "square", "size": 11, "color": BAD, "line": {"color": MUTED, "width": 0.5}},
    )  # fmt: skip
    step = degrees[1] - degrees[0]
    drawn.update_xaxes(title_text="time [s]", showgrid=False, range=[found.t_s[0], found.t_s[-1]], constrain="domain")
    drawn.update_yaxes(
        title_text="elbow swivel [°]", showgrid=False, dtick=30, range=_shown(degrees, allowed, float(step))
    )
    drawn.update_layout(margin_t=24)
    return drawn


def _colors(drawn: go.Figure, found: SwivelMap, degrees: Array, allowed: NDArray[np.bool_]) -> None:
    """Draw mu as colour, of forbidden poses too, so that it can be smoothed up to their edge, and grey over them."""
    mu = np.where(found.limit == UNREACHABLE, np.nan, found.mu)
    words = [f"joint {j} beyond its limit" for j in range(1, found.q_rad.shape[2] + 1)]
    reasons = np.where(found.limit == UNREACHABLE, "out of reach", np.array(["", *words])[found.limit])
    drawn.add_heatmap(
        x=found.t_s.astype(np.float32), y=degrees.astype(np.float32), z=mu.astype(np.float32).T, colorscale=SCALE,
        zmin=float(mu[allowed].min()), zmax=float(mu[allowed].max()), zsmooth="best", hoverongaps=False,
        hovertemplate="%{x:.2f} s, %{y:.0f}°: µ = %{z:.3f} m³<extra></extra>",
        colorbar={
            "title": {"text": "µ [m³]", "side": "top"}, "thickness": 12, "outlinewidth": 0, "len": 0.9, "y": 0.45,
            "tickformat": ".2f",
        },
    )  # fmt: skip
    drawn.add_heatmap(
        x=found.t_s, y=degrees, z=np.where(allowed, np.nan, 0.0).T, customdata=reasons.T, showscale=False,
        colorscale=[[0.0, BAD], [1.0, BAD]], hoverongaps=False,
        hovertemplate="%{x:.2f} s, %{y:.0f}°: %{customdata}<extra></extra>",
    )  # fmt: skip


def _edge(drawn: go.Figure, t: Array, y: Array, group: str) -> None:
    drawn.add_scatter(
        x=t, y=y, mode="lines", line={"color": EDGE, "width": 4.6}, legendgroup=group, showlegend=False,
        hoverinfo="skip", connectgaps=False,
    )  # fmt: skip


def _best(drawn: go.Figure, t: Array, y: Array, mu: Array) -> None:
    line = {"width": 2.0, "dash": "dot"}
    drawn.add_scatter(
        x=t, y=y, mode="lines", name="best", legendgroup="best", customdata=mu, connectgaps=False,
        line={"color": BEST, **line}, showlegend=False, hovertemplate=HOVER,
    )  # fmt: skip
    # The map is light on dark pages too, the legend is not: its sample has the colour of the text.
    drawn.add_scatter(x=[None], y=[None], mode="lines", name="best", legendgroup="best", line={"color": INK, **line})


def _starts(drawn: go.Figure, trajectories: Iterable[Trajectory]) -> None:
    """Draw one marker where several begin: runs of one trial begin at one pose."""
    starts: list[tuple[float, float]] = []
    for trajectory in trajectories:
        t, y = float(trajectory.t_s[0]), float(np.degrees(trajectory.swivel_rad[0]))
        if all(abs(t - other[0]) > 0.1 or abs(y - other[1]) > 2.0 for other in starts):
            starts.append((t, y))
    drawn.add_scatter(
        x=[t for t, _ in starts], y=[y for _, y in starts], mode="markers", showlegend=False, hoverinfo="skip",
        cliponaxis=False, marker={"color": BEST, "size": 10, "line": {"color": EDGE, "width": 1.8}},
    )  # fmt: skip


def _broken(t: Array, degrees: Array) -> tuple[Array, Array]:
    """Return the line with a gap wherever it leaps."""
    leaps = np.flatnonzero(np.abs(np.diff(degrees)) > LEAP_DEG) + 1
    return np.insert(t, leaps, np.nan), np.insert(degrees, leaps, np.nan)


def _shown(degrees: Array, allowed: NDArray[np.bool_], step: float) -> list[float]:
    rows = np.flatnonzero(allowed.any(axis=0))
    low, high = degrees[rows[0]] - 15.0, degrees[rows[-1]] + 15.0
    return [max(low, degrees[0] - 0.5 * step), min(high, degrees[-1] + 0.5 * step)]
