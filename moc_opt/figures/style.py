"""The style of all figures, with colours for colour-blind readers."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from numpy.typing import ArrayLike

from moc_opt.errors import ReportError
from moc_opt.figures.notation import pretty_power, pretty_units, printable

INK, MUTED, GRID, PAPER = "#1f2328", "#5f6871", "#e3e6e9", "#ffffff"
GOOD, BAD, WORST = "#3b7fb8", "#c9ccd1", "#c4421a"
"""Colours of answers: optimal, failed, and wrong but reported as optimal."""

# The palette of Okabe and Ito, without yellow and black. Keys are for a light page, values for a dark page.
SERIES = {
    "#0072b2": "#4da3dd", "#d55e00": "#f0834a", "#009e73": "#3fc39d", "#b6569a": "#dc8fc4",
    "#c98a00": "#e8b33f", "#3fa0d0": "#8accf0", "#77787b": "#a9abb0", "#6a4fb3": "#a994ea",
}  # fmt: skip
DARK = {
    INK: "#e4e7ea", MUTED: "#9aa3ac", GRID: "#31373d", PAPER: "#15181b", GOOD: "#4f95d0", BAD: "#565c63",
    WORST: "#f2693c", **SERIES,
}  # fmt: skip
"""The dark page's colour for each colour of a light page."""

DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "triangle-down", "cross", "x", "pentagon", "star")
FONT = "Inter, 'Helvetica Neue', Helvetica, Arial, 'Liberation Sans', sans-serif"
HEIGHT_PX, LEGEND_PX, MAX_POWERS = 380, 620.0, 6


@dataclass(frozen=True)
class Style:
    """The style of one run or solver."""

    color: str
    dash: str
    symbol: str


class Styles(dict[str, Style]):
    """Styles by name."""

    def __init__(self, names: Iterable[str]) -> None:
        colors = list(SERIES)
        for place, name in enumerate(dict.fromkeys(names)):
            dash = DASHES[place // len(colors) % len(DASHES)]
            self[name] = Style(colors[place % len(colors)], dash, SYMBOLS[place % len(SYMBOLS)])

    def __missing__(self, name: str) -> Style:
        raise ReportError(f"no style for {name!r}: make Styles with this name; known are {', '.join(self) or 'none'}")


def _axis() -> dict[str, object]:
    return {
        "showline": True, "linecolor": MUTED, "linewidth": 1, "gridcolor": GRID, "gridwidth": 1, "zeroline": False,
        "ticks": "outside", "ticklen": 4, "tickcolor": MUTED, "automargin": True, "exponentformat": "e",
        "title": {"standoff": 8},
    }  # fmt: skip


TEMPLATE = go.layout.Template(
    layout={
        "font": {"family": FONT, "size": 12, "color": INK},
        "colorway": list(SERIES), "paper_bgcolor": "rgba(0,0,0,0)", "plot_bgcolor": "rgba(0,0,0,0)",
        "xaxis": _axis(), "yaxis": _axis(),
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": MUTED, "activecolor": INK},
        "margin": {"l": 56, "r": 16, "t": 16, "b": 48}, "height": HEIGHT_PX,
        "legend": {
            "orientation": "h", "x": 0.0, "xanchor": "left", "y": 1.02, "yanchor": "bottom",
            "bgcolor": "rgba(0,0,0,0)", "font": {"size": 12}, "title": {"text": ""}, "tracegroupgap": 0,
        },
        "hoverlabel": {"bgcolor": PAPER, "bordercolor": MUTED, "font": {"family": FONT, "size": 12, "color": INK}},
        "uirevision": "keep", "hovermode": "closest",
    }
)  # fmt: skip


def label(name: object) -> str:
    """Escape a name, so that plotly shows it literally."""
    return html.escape(printable(str(name)), quote=False)


def figure(**layout: object) -> go.Figure:
    """Make an empty figure."""
    return go.Figure(layout={"template": TEMPLATE, **layout})


def legend_height(names: Iterable[str]) -> int:
    """Return the height [px] of a legend."""
    lengths = [len(name) for name in names]
    columns = max(1, int(LEGEND_PX / (6.6 * max(lengths, default=1) + 46.0)))
    return 20 * math.ceil(len(lengths) / columns)


def log_axis(
    drawn: go.Figure, axis: str, title: str, values: ArrayLike, *, powers: bool = False, margin: float = 0.05
) -> None:
    """Make the axis "x" or "y" logarithmic.

    Args:
        powers: label the axis with powers of ten.
        margin: free space at each end, as a fraction of the range.

    Raises:
        ReportError: there is no value, or a value is not positive.
    """
    shown = np.asarray(values, dtype=np.float64)
    if shown.size == 0 or not (shown > 0.0).all():
        raise ReportError(f"{title}: a log axis needs values, and only positive ones; omit the figure and say why")
    low, high = math.log10(shown.min()), math.log10(shown.max())
    free = margin * max(high - low, 0.5)
    low, high, step = low - free, high + free, 1
    ticks: dict[str, object] = {"nticks": 7, "exponentformat": "none"}
    if powers:
        step = max(1, math.ceil((high - low) / MAX_POWERS))
        exponents = range(step * math.ceil(low / step), math.floor(high) + 1, step)
        ticks = {"tickvals": [10.0**power for power in exponents], "ticktext": [*map(pretty_power, exponents)]}
    # Without dtick, plotly would draw thousands of minor ticks.
    minor = {"ticks": "outside", "ticklen": 2, "tickcolor": MUTED, "dtick": "D1" if step == 1 else 1}
    layout = {"type": "log", "title": {"text": pretty_units(title)}, "minor": minor, "range": [low, high], **ticks}
    drawn.update_layout({f"{axis}axis": {"tickangle": 0, **layout}})


def rule(drawn: go.Figure, axis: str, at: float, text: str) -> None:
    """Draw a dashed line across the figure where an axis has the value ``at``, and write ``text`` at the line's end."""
    line = {"color": WORST, "width": 1.2, "dash": "dash"}
    note = {"text": text, "showarrow": False, "font": {"size": 11, "color": WORST}, "yanchor": "bottom"}
    # On a log axis, plotly places a text by the logarithm.
    place = math.log10(at) if drawn.layout[f"{axis}axis"].type == "log" else at
    if axis == "x":
        drawn.add_shape(type="line", x0=at, x1=at, y0=0, y1=1, yref="paper", line=line)
        drawn.add_annotation(x=place, y=1.0, yref="paper", **note)
    else:
        drawn.add_shape(type="line", y0=at, y1=at, x0=0, x1=1, xref="paper", line=line)
        drawn.add_annotation(y=place, x=1.0, xref="paper", xanchor="right", **note)
