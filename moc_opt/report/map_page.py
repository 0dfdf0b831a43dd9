"""The manipulability map: mu as colour over time and swivel."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.errors import ReportError
from moc_opt.figures.notation import Missing
from moc_opt.figures.style import BAD, INK, MUTED, Styles, figure, label, legend_height
from moc_opt.planning.swivel_map import (
    CLOSE_RAD,
    END,
    FEASIBLE,
    NEAR,
    OTHER_BRANCH_RAD,
    UNREACHABLE,
    End,
    Reading,
    SwivelMap,
    manipulability_map,
    read_trajectory,
)
from moc_opt.report.page import Page
from moc_opt.report.replay import load_runs
from moc_opt.report.run_table import below_best, listed, title_of
from moc_opt.report.tables import Column, Table
from moc_opt.trace.trace import Trace

SCALE = ((0.0, "#f4f1e6"), (0.25, "#cfe0cf"), (0.5, "#8fc4bd"), (0.75, "#3f8f9c"), (1.0, "#143f5c"))
EDGE, BEST = "#fffffe", "#17191b"
HEIGHT_PX = 460
LEAP_DEG = 25.0  # Where the swivel jumps by more, its line has a gap.
HOVER = "%{x:.2f} s, %{y:.0f}°: µ = %{customdata:.3f} m³<extra>%{fullData.name}</extra>"
COLUMNS = (
    Column("name", "trajectory"),
    Column(
        "near", "at the optimum", unit="%", format=".0f", better="high",
        help=f"share of the time with mu at most {100 * NEAR:.0f} % below the best mu at the same time",
    ),
    Column("from_s", "optimal from", unit="s", format=".1f", better="low", help="time after which mu stays optimal"),
    Column("mu_percent", "of the best mu", unit="%", format=".1f", better="high", help="mean mu / mean best mu"),
    Column("travel", "elbow turns", unit="deg", format="+.0f", help="swivel at the end of the run minus at its start"),
    Column(
        "at_edge", "at the feasible edge", unit="%", format=".0f", better="low",
        help="share of the time at a forbidden pose or next to one on the map",
    ),
    Column(
        "end", "in the end",
        help=f"state in the last {100 * END:.0f} % of the time. Local maximum: mu falls to both sides. Edge: mu rises "
        "further only at forbidden poses. At rest: the elbow rests, though no maximum or edge is within "
        f"{np.degrees(CLOSE_RAD):.0f} deg. A reason can be that the controller's bounds on elbow motion are tighter "
        "than the map's. Another branch of the inverse kinematics: the map does not apply to this run",
    ),
)  # fmt: skip


def add_map(page: Page, found: SwivelMap, *, styles: Styles | None = None) -> None:
    """Append the figure and the table of one map to a page."""
    drawn = map_figure(found, styles)
    if found.held:
        page.text(
            f"With tip and shaft fixed, this arm has {len(found.held) + 1} independent motions. The map shows only "
            f"poses with {listed(found.held)} at the {'positions' if len(found.held) > 1 else 'position'} that the "
            "longest run has at the same time. Other poses may have a larger mu."
        )
    times, swivels = found.mu.shape
    page.figure(
        drawn, "The manipulability mu over time and over the swivel angle of the elbow, at poses with the run's tip "
        f"and shaft ({times} by {swivels} poses). At grey poses, a joint would be beyond its limit, or the arm does "
        "not reach the pose. Each line that begins at a marker is a run. The dotted line without a marker joins the "
        "best poses; its jumps are not motions of the arm.", name="map",
    )  # fmt: skip
    rows = [_row(read_trajectory(found, trajectory)) for trajectory in found.trajectories]
    page.table(Table("Trajectories on the map", COLUMNS, rows))


def _row(reading: Reading) -> dict[str, Any]:
    return {
        "name": reading.name, "near": 100.0 * reading.near,
        "from_s": reading.from_s if reading.end is End.OPTIMUM else Missing("not at the optimum at the end of the run"),
        "mu_percent": 100.0 * reading.mu_share, "travel": np.degrees(reading.travel_rad),
        "at_edge": 100.0 * reading.at_edge,
        "end": f"{reading.end}, joint {reading.joint}" if reading.joint else str(reading.end),
    }  # fmt: skip


def load_map(files: Sequence[str | os.PathLike[str]]) -> Page:
    """Make a page with the map of saved runs, and of the best course from each run's start if it was saved."""
    traces, robot = load_runs(files)
    page = Page(f"Manipulability map of {title_of(traces)}", f"runs: {'; '.join(traces)}")
    courses: dict[str, Trace] = {}
    for name, trace in traces.items():
        if sentence := below_best(trace):
            page.text(f"{name}: {sentence}.")
        course = trace.columns.get("q_best_from_start_rad")
        if course is not None and not any(np.array_equal(course[0], other.q_rad[0]) for other in courses.values()):
            courses[f"best course from the start of {name}"] = trace.with_columns(q_rad=course)
    add_map(page, manipulability_map(robot, {**traces, **courses}))
    return page


# --- the figure ---


def map_figure(found: SwivelMap, styles: Styles | None = None) -> go.Figure:
    """Draw mu as colour, with a line for every run, dotted for a run on another branch.

    Raise a ReportError if no pose is allowed.
    """
    styles, allowed = styles or Styles(found.trajectories), found.limit == FEASIBLE
    if not allowed.any():
        raise ReportError("no pose on the map is within the joint limits: check trocar and path")
    runs = found.trajectories
    drawn = figure(height=HEIGHT_PX + legend_height([*runs, "best", "not allowed"]), margin_t=64)
    _colors(drawn, found, allowed)
    best = _edged(drawn, "best", found.t_s, found.best_swivel_rad, found.best_mu)
    for name, run in runs.items():
        dash = "dot" if run.gap_rad > OTHER_BRANCH_RAD else styles[name].dash
        line = {"color": styles[name].color, "width": 2.4, "dash": dash}
        drawn.add_scatter(**_edged(drawn, name, run.t_s, run.swivel_rad, run.mu), name=label(name), line=line)
    # The best poses are drawn last, because runs at the optimum coincide with them.
    # The legend has a separate line, because a dark page recolours the legend, but not the map.
    dotted = {"width": 2.0, "dash": "dot"}
    drawn.add_scatter(**best, name="best", showlegend=False, line={"color": BEST, **dotted})
    drawn.add_scatter(x=[None], y=[None], mode="lines", legendgroup="best", name="best", line={"color": INK, **dotted})
    starts = [(run.t_s[0], math.degrees(run.swivel_rad[0])) for run in runs.values()]
    drawn.add_scatter(
        x=[t for t, _ in starts], y=[swivel for _, swivel in starts], mode="markers", showlegend=False,
        hoverinfo="skip", cliponaxis=False, marker={"color": BEST, "size": 10, "line": {"color": EDGE, "width": 1.8}},
    )  # fmt: skip
    drawn.add_scatter(
        x=[None], y=[None], mode="markers", name="not allowed",
        marker={"symbol": "square", "size": 11, "color": BAD, "line": {"color": MUTED, "width": 0.5}},
    )  # fmt: skip
    degrees = np.degrees(found.swivel_rad)
    shown, half = degrees[allowed.any(axis=0)], 0.5 * (degrees[1] - degrees[0])
    span = [max(shown[0] - 15.0, degrees[0] - half), min(shown[-1] + 15.0, degrees[-1] + half)]
    drawn.update_xaxes(title_text="time [s]", showgrid=False, range=[found.t_s[0], found.t_s[-1]], constrain="domain")
    drawn.update_yaxes(title_text="elbow swivel [°]", showgrid=False, dtick=30, range=span)
    return drawn


def _colors(drawn: go.Figure, found: SwivelMap, allowed: NDArray[np.bool_]) -> None:
    """Draw mu at all reachable poses, then grey over the forbidden ones, so that their edge is smooth."""
    mu, degrees = np.where(found.limit == UNREACHABLE, np.nan, found.mu), np.degrees(found.swivel_rad)
    low, high = float(mu[allowed].min()), float(mu[allowed].max())
    drawn.add_heatmap(
        x=found.t_s.astype(np.float32), y=degrees.astype(np.float32), z=mu.astype(np.float32).T, colorscale=SCALE,
        zmin=low, zmax=high, zsmooth="best", hoverongaps=False,
        hovertemplate="%{x:.2f} s, %{y:.0f}°: µ = %{z:.3f} m³<extra></extra>",
        colorbar={
            "title": {"text": "µ [m³]", "side": "top"}, "thickness": 12, "outlinewidth": 0, "len": 0.9, "y": 0.45,
            "nticks": 8,
        },
    )  # fmt: skip
    words = [f"joint {j} beyond its limit" for j in range(1, found.q_rad.shape[2] + 1)]
    reasons = np.where(found.limit == UNREACHABLE, "out of reach", np.array(["", *words])[found.limit])
    drawn.add_heatmap(
        x=found.t_s, y=degrees, z=np.where(allowed, np.nan, 0.0).T, customdata=reasons.T, showscale=False,
        colorscale=[[0.0, BAD], [1.0, BAD]], hoverongaps=False,
        hovertemplate="%{x:.2f} s, %{y:.0f}°: %{customdata}<extra></extra>",
    )  # fmt: skip


def _edged(drawn: go.Figure, group: str, t: Array, swivel_rad: Array, mu: Array) -> dict[str, Any]:
    """Draw a line's white edge; return plotly's arguments for the line."""
    leaps = np.flatnonzero(np.abs(np.diff(swivel_rad)) > np.radians(LEAP_DEG)) + 1
    x, y, values = (np.insert(of, leaps, np.nan) for of in (t, np.degrees(swivel_rad), mu))
    line = {"x": x, "y": y, "mode": "lines", "connectgaps": False, "legendgroup": group}
    drawn.add_scatter(**line, line={"color": EDGE, "width": 4.6}, showlegend=False, hoverinfo="skip")
    return {**line, "customdata": values, "hovertemplate": HOVER}
