"""The manipulability map as a figure."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from moc_opt.report.errors import ReportError
from moc_opt.report.figures.style import BAD, INK, MUTED, Style, Styles, figure, label, legend_height
from moc_opt.report.map import FEASIBLE, OTHER_BRANCH_RAD, UNREACHABLE, Course, SwivelMap

Array = NDArray[np.float64]

# Light to dark, so that lines of any of the house's colours with a white edge stand out; the same on dark pages.
SCALE = ((0.0, "#f4f1e6"), (0.25, "#cfe0cf"), (0.5, "#8fc4bd"), (0.75, "#3f8f9c"), (1.0, "#143f5c"))
EDGE, BEST = "#fffffe", "#17191b"
HEIGHT_PX = 460


def map_figure(
    found: SwivelMap, styles: Styles | None = None, *, titles: Mapping[str, str] | None = None
) -> go.Figure:
    """Time to the right, swivel upwards, mu as colour, grey where no pose is allowed; a line for every run.

    A run that folds the arm another way than the map is dotted: the colours under it are not its own.

    Args:
        found: of `manipulability_map`.
        styles: how each run looks, as in other figures; None deals colours out anew.
        titles: the runs that are drawn -> what the legend calls them; None: all, by their names.

    Raises:
        ReportError: no pose of the map is allowed.
    """
    styles = styles or Styles(found.courses)
    titles = {name: name for name in found.courses} if titles is None else titles
    allowed = found.limit == FEASIBLE
    if not allowed.any():
        raise ReportError("no pose on the map is within the joint limits: check trocar and path")
    degrees = np.degrees(found.swivel_rad)
    drawn = figure(height=HEIGHT_PX + legend_height([*titles.values(), "best", "not allowed"]))
    words = [f"joint {j} beyond its limit" for j in range(1, found.q_rad.shape[2] + 1)]
    reasons = np.where(found.limit == UNREACHABLE, "out of reach", np.array(["", *words])[found.limit])
    drawn.add_heatmap(
        x=found.t_s, y=degrees, z=np.where(allowed, np.nan, 0.0).T, customdata=reasons.T, showscale=False,
        colorscale=[[0.0, BAD], [1.0, BAD]], hovertemplate="%{x:.2f} s, %{y:.0f}°: %{customdata}<extra></extra>",
    )  # fmt: skip
    drawn.add_heatmap(
        x=found.t_s.astype(np.float32), y=degrees.astype(np.float32),
        z=np.where(allowed, found.mu, np.nan).astype(np.float32).T, colorscale=SCALE, hoverongaps=False,
        hovertemplate="%{x:.2f} s, %{y:.0f}°: µ = %{z:.3f} m³<extra></extra>",
        colorbar={
            "title": {"text": "µ [m³]", "side": "top"}, "thickness": 12, "outlinewidth": 0, "len": 0.9, "y": 0.45,
        },
    )  # fmt: skip
    t_best, y_best = _broken(found.t_s, np.degrees(found.best_swivel_rad))
    _edge(drawn, t_best, y_best, "best")
    for name, title in titles.items():
        course, style = found.courses[name], styles[name]
        if course.gap_rad > OTHER_BRANCH_RAD:
            style = Style(style.color, "dot", style.symbol)
        t, y = _broken(course.t_s, np.degrees(course.swivel_rad))
        _line(drawn, t, y, style, (name, title), np.interp(t, course.t_s, course.mu))
        _start(drawn, course, style, name)
    # Above the others: a run that has arrived lies on it.
    _best(drawn, t_best, y_best, np.interp(t_best, found.t_s, found.best_mu))
    drawn.add_scatter(
        x=[None], y=[None], mode="markers", name="not allowed",
        marker={"symbol": "square", "size": 11, "color": BAD, "line": {"color": MUTED, "width": 0.5}},
    )  # fmt: skip
    step = degrees[1] - degrees[0]
    drawn.update_xaxes(
        title_text="time [s]", showgrid=False, range=[found.t_s[0], found.t_s[-1]], constrain="domain"
    )
    drawn.update_yaxes(
        title_text="elbow swivel [°]", showgrid=False, dtick=30, range=_shown(degrees, allowed, float(step))
    )
    drawn.update_layout(margin_t=24)
    return drawn


HOVER = "%{x:.2f} s, %{y:.0f}°: µ = %{customdata:.3f} m³<extra>%{fullData.name}</extra>"


def _edge(drawn: go.Figure, t: Array, y: Array, group: str) -> None:
    """What makes a line visible on any colour."""
    drawn.add_scatter(
        x=t, y=y, mode="lines", line={"color": EDGE, "width": 4.6}, legendgroup=group, showlegend=False,
        hoverinfo="skip", connectgaps=False,
    )  # fmt: skip


def _line(drawn: go.Figure, t: Array, y: Array, style: Style, names: tuple[str, str], mu: Array) -> None:
    name, title = names
    _edge(drawn, t, y, name)
    drawn.add_scatter(
        x=t, y=y, mode="lines", name=label(title), legendgroup=name, customdata=mu, connectgaps=False,
        line={"color": style.color, "width": 2.4, "dash": style.dash}, hovertemplate=HOVER,
    )  # fmt: skip


def _best(drawn: go.Figure, t: Array, y: Array, mu: Array) -> None:
    line = {"width": 2.0, "dash": "dot"}
    drawn.add_scatter(
        x=t, y=y, mode="lines", name="best", legendgroup="best", customdata=mu, connectgaps=False,
        line={"color": BEST, **line}, showlegend=False, hovertemplate=HOVER,
    )  # fmt: skip
    # The map is light on dark pages too, the legend is not: its sample has the colour of the text.
    drawn.add_scatter(
        x=[None], y=[None], mode="lines", name="best", legendgroup="best", line={"color": INK, **line}
    )


def _start(drawn: go.Figure, course: Course, style: Style, name: str) -> None:
    drawn.add_scatter(
        x=course.t_s[:1], y=np.degrees(course.swivel_rad[:1]), mode="markers", legendgroup=name, showlegend=False,
        hoverinfo="skip", cliponaxis=False,
        marker={"color": style.color, "symbol": style.symbol, "size": 10, "line": {"color": EDGE, "width": 1.5}},
    )  # fmt: skip


def _broken(t: Array, degrees: Array, jump: float = 25.0) -> tuple[Array, Array]:
    """The line with a gap wherever it leaps."""
    leaps = np.flatnonzero(np.abs(np.diff(degrees)) > jump) + 1
    return np.insert(t, leaps, np.nan), np.insert(degrees, leaps, np.nan)


def _shown(degrees: Array, allowed: NDArray[np.bool_], step: float) -> list[float]:
    """The allowed rows and a margin of grey: nobody needs a page of grey."""
    rows = np.flatnonzero(allowed.any(axis=0))
    low, high = degrees[rows[0]] - 15.0, degrees[rows[-1]] + 15.0
    return [max(low, degrees[0] - 0.5 * step), min(high, degrees[-1] + 0.5 * step)]
