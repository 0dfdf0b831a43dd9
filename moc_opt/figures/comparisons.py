"""Comparisons of solvers: accuracy over time, and claims over verified answers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go

from moc_opt.errors import ReportError
from moc_opt.figures.labels import label_sides
from moc_opt.figures.style import (
    BAD,
    FAIR,
    GOOD,
    HEIGHT_PX,
    INK,
    MUTED,
    PAPER,
    WORST,
    Styles,
    figure,
    label,
    legend_height,
    log_axis,
)

MARGIN = 0.12

OUTCOMES = {
    "verified": ("claimed and verified", GOOD, ""),
    "unclaimed": ("optimal, not claimed", FAIR, "/"),
    "failed": ("not solved, and said so", BAD, ""),
    "silently_wrong": ("claimed, but wrong", WORST, "x"),
}
"""Outcome -> its words, colour and hatching, from the best to the worst."""


def accuracy_against_time(
    points: Mapping[str, tuple[float, float]], *, x_label: str = "median time [µs]", y_label: str = "largest residual",
    floor: float = 1e-18,
) -> go.Figure:  # fmt: skip
    """Draw error over time, both on log axes; the Pareto front (nobody is both faster and more accurate) is marked.

    Args:
        points: name -> (time, error); both at least 0, errors below `floor` are drawn at `floor`; entries that
            are not finite are left out.
        x_label, y_label: of the axes, with units.
        floor: the smallest error drawn.

    Raises:
        ReportError: no entry is finite, a time is not positive, or an error is negative.
    """
    drawn, styles = figure(showlegend=False), Styles(points)
    known = {name: point for name, point in points.items() if np.isfinite(point).all()}
    for name, (time, error) in known.items():
        if time <= 0.0 or error < 0.0:
            raise ReportError(f"{name!r}: time {time}, error {error}: a log axis needs time > 0 and error >= 0")
    known = {name: (time, max(error, floor)) for name, (time, error) in known.items()}
    log_axis(drawn, "x", x_label, [time for time, _ in known.values()], margin=MARGIN)
    log_axis(drawn, "y", y_label, [error for _, error in known.values()], powers=True, margin=MARGIN)
    front = pareto(known)
    _staircase(drawn, [known[name] for name in front])
    sides = label_sides(_pixels(known), front)
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


def _staircase(drawn: go.Figure, front: list[tuple[float, float]]) -> None:
    """Draw the border of the dominated region, from the top of the plot to its right."""
    top, right = 10.0 ** drawn.layout.yaxis.range[1], 10.0 ** drawn.layout.xaxis.range[1]
    steps = [(front[0][0], top), *front, (right, front[-1][1])]
    drawn.add_scatter(
        x=[time for time, _ in steps], y=[error for _, error in steps], mode="lines", hoverinfo="skip",
        showlegend=False, line={"color": MUTED, "width": 1, "dash": "dot", "shape": "hv"},
    )  # fmt: skip


def _pixels(points: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Return where the points lie in a plot of usual size, from its middle, y downwards [px]."""
    logs = np.log10(np.array(list(points.values())))
    extent = np.maximum(np.ptp(logs, axis=0), 0.5) * (1.0 + 2.0 * MARGIN)
    centres = (logs - logs.mean(axis=0)) / extent * [680.0, -310.0]
    return {name: (float(x), float(y)) for name, (x, y) in zip(points, centres, strict=True)}


def pareto(points: Mapping[str, tuple[float, float]]) -> list[str]:
    """Return the names that no other beats in both coordinates (less is better), by the first coordinate."""
    best, front = np.inf, []
    for name in sorted(points, key=lambda name: points[name]):
        if points[name][1] < best:
            best = points[name][1]
            front.append(name)
    return front


def solution_quality(counts: Mapping[str, Mapping[str, float]]) -> go.Figure:
    """Draw a stacked bar per solver: how many answers were optimal, said to have failed, or wrong.

    Args:
        counts: name -> outcome -> number of answers; the outcomes are the keys of `OUTCOMES`, absent ones are 0.

    Raises:
        ReportError: an outcome that is not one of those, or a negative number.
    """
    names = list(counts)[::-1]
    for name, outcomes in counts.items():
        for outcome, number in outcomes.items():
            if outcome not in OUTCOMES or not number >= 0.0:
                raise ReportError(f"{name!r}: {outcome!r} = {number}: give numbers >= 0 of {', '.join(OUTCOMES)}")
    totals = np.array([sum(counts[name].values()) for name in names])
    drawn = figure(barmode="stack", bargap=0.35)
    for outcome, (words, color, shape) in OUTCOMES.items():
        numbers = np.array([counts[name].get(outcome, 0.0) for name in names])
        if outcome == "unclaimed" and not numbers.any():
            continue
        hatch = {"shape": shape, "fgcolor": PAPER, "bgcolor": color, "size": 5, "solidity": 0.25}
        drawn.add_bar(
            y=[label(name) for name in names], x=100.0 * numbers / np.maximum(totals, 1.0), orientation="h",
            name=words, customdata=numbers, marker={"color": color, "line": {"width": 0}, "pattern": hatch},
            hovertemplate="%{customdata:d} (%{x:.3g} %)<extra>%{fullData.name}</extra>",
        )  # fmt: skip
    drawn.update_xaxes(title_text="answers [%]", range=[0, 100])
    drawn.update_yaxes(showgrid=False, ticks="", showline=False, type="category")
    drawn.update_layout(height=110 + 30 * max(len(names), 2), legend_traceorder="normal")
    return drawn


def outcomes(summary: Mapping[str, float], total: float) -> dict[str, float]:
    """Return the outcomes of `solution_quality` from a summary's claimed_solved, verified_solved and silently_wrong.

    Args:
        summary: with those three metrics.
        total: number of subproblems, those without an answer included.
    """
    both = summary["claimed_solved"] - summary["silently_wrong"]
    unclaimed = summary["verified_solved"] - both
    failed = total - summary["claimed_solved"] - unclaimed
    return {"verified": both, "unclaimed": unclaimed, "failed": failed, "silently_wrong": summary["silently_wrong"]}
