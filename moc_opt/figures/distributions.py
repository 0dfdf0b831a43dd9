"""Distributions: solve times on a log axis, and box plots in the manner of the paper's Figure 7."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import ReportError
from moc_opt.figures.notation import pretty_units
from moc_opt.figures.style import Styles, figure, label, legend_height, log_axis, rule

Floats = NDArray[np.float64]
Samples = Mapping[str, ArrayLike]
CLOCK_US = 1e-3
"""Times below a clock's nanosecond are drawn there: zero has no place on a log axis."""
ECDF_POINTS = 400


def latency_ecdf(samples: Samples, deadline_us: float | None = None, *, tail: bool = False) -> go.Figure:
    """Draw the fraction of solves or ticks that are done within a time, on a log axis of time.

    Args:
        samples: name -> times [us]; NaN (no solve) is left out, infinity (never done) counts as late; a name
            without samples says so.
        deadline_us: drawn as a line.
        tail: draw instead the fraction that takes as long or longer, on a log axis: for the rare late ones.

    Raises:
        ReportError: there is no finite time at all, or one is negative.
    """
    drawn, styles = figure(legend_y=1.08, height=320 + legend_height(samples)), Styles(samples)
    for name, values in samples.items():
        known = _known(name, values)
        count, times = len(known), np.maximum(np.sort(known[np.isfinite(known)]), CLOCK_US)
        if not len(times):
            drawn.add_scatter(x=[], y=[], name=f"{label(name)} (no sample)", line_color=styles[name].color)
            continue
        # Few quantiles suffice in the middle; each of the slowest has its own step.
        slowest = len(times) - np.geomspace(1, len(times), ECDF_POINTS)
        ranks = np.unique(np.append(np.linspace(0, len(times) - 1, ECDF_POINTS), np.ceil(slowest)).astype(np.int64))
        share = 1.0 - ranks / count if tail else (ranks + 1) / count
        drawn.add_scatter(
            x=times[ranks], y=share, mode="lines", name=label(name), line={
                "color": styles[name].color, "dash": styles[name].dash, "width": 1.8, "shape": "vh" if tail else "hv",
            }, hovertemplate="%{y:.4g} at %{x:.4g} µs<extra>%{fullData.name}</extra>",
        )  # fmt: skip
    lines = [line for line in drawn.data if len(line.x)]
    if not lines:  # a limit alone is no figure
        raise ReportError("no name has a finite sample: leave the figure out and say why")
    ends = [time for line in lines for time in (line.x[0], line.x[-1])]
    log_axis(drawn, "x", "time [µs]", ends if deadline_us is None else [*ends, deadline_us])
    if tail:
        rarest = min(line.y[-1] for line in lines)
        log_axis(drawn, "y", "fraction that takes as long", [rarest, 1.0], powers=True)
    else:
        drawn.update_yaxes(title_text="fraction done within", range=[0, 1.02], tickformat=".0%")
    if deadline_us is not None:
        rule(drawn, "x", deadline_us, "deadline")
    return drawn


def box_plots(groups: Mapping[str, Samples], value_label: str, *, log: bool = False) -> go.Figure:
    """Draw box plots grouped by task, one colour per controller, in the manner of the paper's Figure 7.

    Boxes are quartiles with the median; whiskers reach the last sample within 1.5 box lengths (Tukey); samples
    beyond are points, at most forty a box, the outermost always among them.

    Args:
        groups: controller -> task -> samples; NaN is left out, and a box without samples leaves its place empty.
        value_label: of the value axis, with the unit.
        log: a log axis of values; the whiskers are then those of the logarithms.

    Raises:
        ReportError: a sample is infinite, or not positive under `log`.
    """
    drawn, styles = figure(boxmode="group", boxgap=0.3, boxgroupgap=0.25, margin_b=32), Styles(groups)
    shown: list[float] = []
    for name, group in groups.items():
        known = {task: _known(f"{name}, {task}", values, signed=True) for task, values in group.items()}
        boxes = {task: _box(f"{name}, {task}", values, log) for task, values in known.items() if len(values)}
        shown += [value for *five, beyond in boxes.values() for value in (*five, *beyond)]
        lower, q1, median, q3, upper, beyond = zip(*boxes.values(), strict=True) if boxes else [()] * 6
        drawn.add_box(
            x=[label(task) for task in boxes], lowerfence=lower, q1=q1, median=median, q3=q3, upperfence=upper,
            # plotly draws nothing of a name whose first list of points is empty; a point in the box it hides.
            y=[points or [middle] for points, middle in zip(beyond, median, strict=True)],
            boxpoints="outliers", name=label(name), offsetgroup=name,
            fillcolor=f"{styles[name].color}48",  # an opacity of 0.28; a dark page exchanges the first seven characters
            line={"color": styles[name].color, "width": 1.4}, marker={"size": 3, "opacity": 0.6}, whiskerwidth=0.5,
        )  # fmt: skip
    tasks = dict.fromkeys(label(task) for group in groups.values() for task in group)
    drawn.update_xaxes(
        showgrid=False, ticks="", type="category", categoryarray=list(tasks), range=[-0.5, len(tasks) - 0.5]
    )
    drawn.update_yaxes(title_text=pretty_units(value_label), rangemode="normal" if log else "tozero")
    if log and shown:
        log_axis(drawn, "y", value_label, shown, powers=True)
    return drawn


def _box(name: str, values: Floats, log: bool) -> tuple[float, float, float, float, float, list[float]]:
    """Return lower whisker, quartiles, upper whisker, and the samples beyond, thinned."""
    values = np.sort(values)
    if np.isinf(values).any() or (log and values[0] <= 0.0):
        raise ReportError(f"{name!r} reaches from {values[0]} to {values[-1]}: this axis cannot show that")
    scale = np.log10(values) if log else values
    q1, q3 = np.percentile(scale, (25, 75))
    reach = 1.5 * (q3 - q1) + 1e-12 * abs(q3)  # the latter for rounding, where all samples are the same
    near = (scale >= q1 - reach) & (scale <= q3 + reach)
    inside, beyond = values[near], values[~near]
    kept = beyond[np.unique(np.linspace(0, len(beyond) - 1, min(len(beyond), 40)).astype(int))]
    q1, median, q3 = np.percentile(values, (25, 50, 75))
    return float(inside[0]), float(q1), float(median), float(q3), float(inside[-1]), kept.tolist()


def _known(name: str, values: ArrayLike, *, signed: bool = False) -> Floats:
    """Return the samples that are not NaN, maybe none; not negative unless `signed`."""
    known = np.asarray(values, dtype=np.float64).ravel()
    known = known[~np.isnan(known)]
    if not signed and (known < 0.0).any():
        raise ReportError(f"{name!r} has the sample {known.min()}: times and residuals are not negative")
    return known
