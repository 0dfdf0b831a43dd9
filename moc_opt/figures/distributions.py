"""Cumulative distributions and box plots on a log axis."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import ReportError
from moc_opt.figures.style import Styles, figure, label, legend_height, log_axis

Floats = NDArray[np.float64]
Samples = Mapping[str, ArrayLike]
CLOCK_US = 1e-3  #: The clock's resolution [us]. Shorter times are drawn at this time.
ECDF_POINTS = 400


def latency_ecdf(samples: Samples) -> go.Figure:
    """Draw the fraction of solves or ticks done within a time [us].

    NaN (no solve) is left out. Infinity counts as never done.

    Raises:
        ReportError: no time is finite, or a time is negative.
    """
    drawn, styles = figure(legend_y=1.08, height=320 + legend_height(samples)), Styles(samples)
    for name, values in samples.items():
        known = _known(name, values)
        times = np.maximum(np.sort(known[np.isfinite(known)]), CLOCK_US)
        if not len(times):
            drawn.add_scatter(x=[], y=[], name=f"{label(name)} (no sample)", line_color=styles[name].color)
            continue
        # The thinned curve keeps a step for each of the slowest times.
        slowest = len(times) - np.geomspace(1, len(times), ECDF_POINTS)
        ranks = np.unique(np.append(np.linspace(0, len(times) - 1, ECDF_POINTS), np.ceil(slowest)).astype(np.int64))
        drawn.add_scatter(
            x=times[ranks], y=(ranks + 1) / len(known), mode="lines", name=label(name),
            line={"color": styles[name].color, "dash": styles[name].dash, "width": 1.8, "shape": "hv"},
            hovertemplate="%{y:.4g} at %{x:.4g} µs<extra>%{fullData.name}</extra>",
        )  # fmt: skip
    ends = [time for line in drawn.data if len(line.x) for time in (line.x[0], line.x[-1])]
    log_axis(drawn, "x", "time [µs]", ends)
    drawn.update_yaxes(title_text="fraction done within", range=[0, 1.02], tickformat=".0%")
    return drawn


def box_plots(groups: Mapping[str, Samples], value_label: str) -> go.Figure:
    """Draw box plots of ``groups[controller][task]`` on a log axis.

    Whiskers reach at most 1.5 box lengths (Tukey) in logarithms. Of the samples beyond, at most 40 are drawn.

    Raises:
        ReportError: a sample is infinite, or not positive.
    """
    drawn, styles = figure(boxmode="group", boxgap=0.3, boxgroupgap=0.25, margin_b=32), Styles(groups)
    shown: list[float] = []
    for name, group in groups.items():
        known = {task: _known(f"{name}, {task}", values) for task, values in group.items()}
        boxes = {task: _box(f"{name}, {task}", values) for task, values in known.items() if len(values)}
        shown += [value for *five, beyond in boxes.values() for value in (*five, *beyond)]
        lower, q1, median, q3, upper, beyond = zip(*boxes.values(), strict=True) if boxes else [()] * 6
        drawn.add_box(
            x=[label(task) for task in boxes], lowerfence=lower, q1=q1, median=median, q3=q3, upperfence=upper,
            # If the first list in y is empty, plotly draws none of the controller's boxes.
            y=[points or [middle] for points, middle in zip(beyond, median, strict=True)],
            boxpoints="outliers", name=label(name), offsetgroup=name,
            fillcolor=f"{styles[name].color}48",  # opacity 0.28
            line={"color": styles[name].color, "width": 1.4}, marker={"size": 3, "opacity": 0.6}, whiskerwidth=0.5,
        )  # fmt: skip
    tasks = dict.fromkeys(label(task) for group in groups.values() for task in group)
    drawn.update_xaxes(
        showgrid=False, ticks="", type="category", categoryarray=list(tasks), range=[-0.5, len(tasks) - 0.5]
    )
    log_axis(drawn, "y", value_label, shown, powers=True)
    return drawn


def _box(name: str, values: Floats) -> tuple[float, float, float, float, float, list[float]]:
    """Return lower whisker, quartiles, upper whisker, and samples beyond the whiskers."""
    values = np.sort(values)
    if np.isinf(values).any() or values[0] <= 0.0:
        raise ReportError(f"{name!r} reaches from {values[0]} to {values[-1]}: a log axis needs finite values above 0")
    scale = np.log10(values)
    q1, q3 = np.percentile(scale, (25, 75))
    reach = 1.5 * (q3 - q1) + 1e-12 * abs(q3)  # the second term absorbs rounding
    near = (scale >= q1 - reach) & (scale <= q3 + reach)
    inside, beyond = values[near], values[~near]
    kept = beyond[np.unique(np.linspace(0, len(beyond) - 1, min(len(beyond), 40)).astype(int))]
    q1, median, q3 = np.percentile(values, (25, 50, 75))
    return float(inside[0]), float(q1), float(median), float(q3), float(inside[-1]), kept.tolist()


def _known(name: str, values: ArrayLike) -> Floats:
    known = np.asarray(values, dtype=np.float64).ravel()
    known = known[~np.isnan(known)]
    if (known < 0.0).any():
        raise ReportError(f"{name!r} has the sample {known.min()}: times and residuals cannot be negative")
    return known
