"""The manipulability map as a figure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from moc_opt.errors import ReportError
from moc_opt.figures.style import BAD, INK, MUTED, Style, Styles, figure, label, legend_height
from moc_opt.numerics.arrays import Array
from moc_opt.redundancy.manipulability_map import (
    FEASIBLE,
    OTHER_BRANCH_RAD,
    UNREACHABLE,
    SwivelMap,
    Trajectory,
)
from moc_opt.redundancy.map_analysis import alike

# Light to dark, so that lines of any of the house's colours with a white edge stand out; the same on dark pages.
SCALE = ((0.0, "#f4f1e6"), (0.25, "#cfe0cf"), (0.5, "#8fc4bd"), (0.75, "#3f8f9c"), (1.0, "#143f5c"))
EDGE, BEST = "#fffffe", "#17191b"
HEIGHT_PX = 460
SHARED = ("9px,9px", "5px,13px", "3px,15px")
"""Dashes of the second, third and further trajectories on one line: the colours of all of them show."""


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


LEAP_DEG = 25.0
"""From one time to the next: a line that turns by more has a gap there."""
HOVER = "%{x:.2f} s, %{y:.0f}°: µ = %{customdata:.3f} m³<extra>%{fullData.name}</extra>"


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
    """Draw what makes a line visible on any colour."""
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
    """Return the range of swivels to draw: the allowed rows with 15 degrees of grey on either side."""
    rows = np.flatnonzero(allowed.any(axis=0))
    low, high = degrees[rows[0]] - 15.0, degrees[rows[-1]] + 15.0
    return [max(low, degrees[0] - 0.5 * step), min(high, degrees[-1] + 0.5 * step)]
