"""Accuracy against computing time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go

from moc_opt.errors import ReportError
from moc_opt.figures.style import HEIGHT_PX, INK, MUTED, PAPER, Styles, figure, label, legend_height, log_axis

MARGIN, FLOOR = 0.12, 1e-12
Box = tuple[float, float, float, float]
"""Left, top, right, bottom [px]; y points down."""
CHARACTER_PX, LINE_PX, MARKER_PX = 6.3, 14.0, 7.0
TOLERATED_PX2 = 25.0


def accuracy_against_time(
    points: Mapping[str, tuple[float, float]], *, x_label: str = "median time [µs]", y_label: str = "largest residual"
) -> go.Figure:
    """Draw error against time on log axes, with filled points on the Pareto front.

    Args:
        points: (time, error) by name; non-finite entries are left out.

    Raises:
        ReportError: no entry is finite, a time is not positive, or an error is negative.
    """
    drawn, styles = figure(showlegend=False), Styles(points)
    known = {name: point for name, point in points.items() if np.isfinite(point).all()}
    for name, (time, error) in known.items():
        if time <= 0.0 or error < 0.0:
            raise ReportError(f"{name!r}: time {time}, error {error}: a log axis needs time > 0 and error >= 0")
    known = {name: (time, max(error, FLOOR)) for name, (time, error) in known.items()}
    log_axis(drawn, "x", x_label, [time for time, _ in known.values()], margin=MARGIN)
    log_axis(drawn, "y", y_label, [error for _, error in known.values()], powers=True, margin=MARGIN)
    front = pareto(known)
    # Draw the border of the dominated region.
    top, right = 10.0 ** drawn.layout.yaxis.range[1], 10.0 ** drawn.layout.xaxis.range[1]
    times, errors = zip(*(known[name] for name in front), strict=True)
    drawn.add_scatter(
        x=[times[0], *times, right], y=[top, *errors, errors[-1]], mode="lines", hoverinfo="skip", showlegend=False,
        line={"color": MUTED, "width": 1, "dash": "dot", "shape": "hv"},
    )  # fmt: skip
    sides = label_sides(_pixels({name: known[name] for name in dict.fromkeys([*front, *known])}))
    for name, (time, error) in known.items():
        best, style, side = name in front, styles[name], sides[name]
        drawn.add_scatter(
            x=[time], y=[error], mode="markers+text" if side else "markers", name=label(name), text=[label(name)],
            textposition=side, textfont={"size": 11, "color": INK if best else MUTED}, cliponaxis=False,
            marker={"color": style.color if best else PAPER, "symbol": style.symbol, "size": 10,
                    "line": {"color": style.color, "width": 2}}, showlegend=side is None,
            hovertemplate=f"{x_label}: %{{x:.3g}}<br>{y_label}: %{{y:.3g}}<extra>%{{fullData.name}}</extra>",
        )  # fmt: skip
    crowded = [trace.name for trace in drawn.data if trace.showlegend]
    drawn.update_layout(showlegend=bool(crowded), height=HEIGHT_PX + legend_height(crowded))
    return drawn


def pareto(points: Mapping[str, tuple[float, float]]) -> list[str]:
    """Return the names on the Pareto front (less is better), sorted by time."""
    best, front = np.inf, []
    for name in sorted(points, key=lambda name: points[name]):
        if points[name][1] < best:
            best = points[name][1]
            front.append(name)
    return front


def _pixels(points: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Return approximate positions [px] from the plot's middle, y downwards."""
    logs = np.log10(np.array(list(points.values())))
    extent = np.maximum(np.ptp(logs, axis=0), 0.5) * (1.0 + 2.0 * MARGIN)
    centres = (logs - logs.mean(axis=0)) / extent * [680.0, -310.0]
    return {name: (float(x), float(y)) for name, (x, y) in zip(points, centres, strict=True)}


def label_sides(points: Mapping[str, tuple[float, float]]) -> dict[str, str | None]:
    """Choose for each point the side on which its label covers the least area of other points and labels.

    Args:
        points: positions by name [px]; y points down.

    Returns:
        Plotly's word for each side ("top center"), or None if the label covers more than `TOLERATED_PX2` on every side.
    """
    markers = {name: (x - MARKER_PX, y - MARKER_PX, x + MARKER_PX, y + MARKER_PX) for name, (x, y) in points.items()}
    placed: list[Box] = []
    sides: dict[str, str | None] = {}
    for name, place in points.items():
        taken = [*placed, *(box for other, box in markers.items() if other != name)]
        boxes = _boxes(name, *place)
        covered = {side: sum(_shared(box, other) for other in taken) for side, box in boxes.items()}
        best = min(covered, key=lambda side: covered[side])
        sides[name] = best if covered[best] <= TOLERATED_PX2 else None
        if sides[name]:
            placed.append(boxes[best])
    return sides


def _boxes(name: str, x: float, y: float) -> dict[str, Box]:
    wide, near, far = CHARACTER_PX * len(name), MARKER_PX + 1.0, MARKER_PX + 1.0 + LINE_PX
    left, right = (x - near - wide, x - near), (x + near, x + near + wide)
    centre, middle = (x - wide / 2, x + wide / 2), (y - LINE_PX / 2, y + LINE_PX / 2)
    above, below = (y - far, y - near), (y + near, y + far)
    # In order of preference. The line of the Pareto front needs the space above and to the right of a point.
    spans = {
        "bottom center": (centre, below), "top center": (centre, above), "middle left": (left, middle),
        "middle right": (right, middle), "bottom left": (left, below), "bottom right": (right, below),
        "top left": (left, above), "top right": (right, above),
    }  # fmt: skip
    return {side: (across[0], down[0], across[1], down[1]) for side, (across, down) in spans.items()}


def _shared(one: Box, two: Box) -> float:
    wide, tall = min(one[2], two[2]) - max(one[0], two[0]), min(one[3], two[3]) - max(one[1], two[1])
    return max(wide, 0.0) * max(tall, 0.0)
