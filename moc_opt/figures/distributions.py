"""Distributions of solve times and of residuals, on log axes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import ReportError
from moc_opt.figures.style import PAPER, Style, Styles, figure, label, legend_height, log_axis, rule

Floats = NDArray[np.float64]
Samples = Mapping[str, ArrayLike]
CLOCK_US = 1e-3
"""Times below a clock's nanosecond are drawn there: zero has no place on a log axis."""

_ECDF_POINTS, _STRIP_POINTS, _KERNEL_POINTS = 400, 160, 161


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
        known = known_samples(name, values)
        count, times = len(known), np.maximum(np.sort(known[np.isfinite(known)]), CLOCK_US)
        if not len(times):
            drawn.add_scatter(x=[], y=[], name=f"{label(name)} (no sample)", line_color=styles[name].color)
            continue
        # Few quantiles suffice in the middle; each of the slowest has its own step.
        ranks = _ranks(len(times))
        share = 1.0 - ranks / count if tail else (ranks + 1) / count
        drawn.add_scatter(
            x=times[ranks], y=share, mode="lines", name=label(name), line={
                "color": styles[name].color, "dash": styles[name].dash, "width": 1.8, "shape": "vh" if tail else "hv",
            }, hovertemplate="%{y:.4g} at %{x:.4g} µs<extra>%{fullData.name}</extra>",
        )  # fmt: skip
    lines = [line for line in drawn.data if len(line.x)]
    ends = [time for line in lines for time in (line.x[0], line.x[-1])]
    log_axis(drawn, "x", "time [µs]", _span(ends, deadline_us))
    if tail:
        rarest = min(line.y[-1] for line in lines)
        log_axis(drawn, "y", "fraction that takes as long", [rarest, 1.0], powers=True)
    else:
        drawn.update_yaxes(title_text="fraction done within", range=[0, 1.02], tickformat=".0%")
    if deadline_us is not None:
        rule(drawn, "x", deadline_us, "deadline")
    return drawn


def latency_violin(samples: Samples, deadline_us: float | None = None) -> go.Figure:
    """Draw one violin per name on a log axis of time: density of log10(time), median, quartiles, 99th percentile.

    Infinite times have no place on the axis: their number stands beside the name.

    Arguments and errors are those of `latency_ecdf`.
    """
    drawn, styles = figure(showlegend=False), Styles(samples)
    names, ends = list(samples)[::-1], []
    for row, name in enumerate(names):
        known, style = known_samples(name, samples[name]), styles[name]
        times = np.maximum(known[np.isfinite(known)], CLOCK_US)
        if not len(times):
            continue
        at, density = _log_density(times)
        ends += [at[0], at[-1]]
        outline = np.concatenate([row + 0.4 * density, row - 0.4 * density[::-1]])
        q1, q25, q50, q75, q99 = np.percentile(times, (1, 25, 50, 75, 99))
        text = f"median {q50:.3g} µs, 1 % {q1:.3g}, 99 % {q99:.3g}, longest {times.max():.3g}, n = {len(times)}"
        drawn.add_scatter(
            x=np.concatenate([at, at[::-1]]), y=outline, fill="toself", fillcolor=style.fill(0.28), mode="lines",
            line={"color": style.color, "width": 1}, hoveron="fills", text=text, hoverinfo="text", name=label(name),
        )  # fmt: skip
        _bar(drawn, row, (q25, q75), style)
        _marks(drawn, row, name, style, {"median": q50, "99 %": q99, "longest": times.max()})
    log_axis(drawn, "x", "time [µs]", _span(ends, deadline_us))
    _rows(drawn, names, samples)
    if deadline_us is not None:
        rule(drawn, "x", deadline_us, "deadline")
    return drawn


def residual_strip(
    samples: Samples, value_label: str, *, limit: float | None = None, floor: float = 1e-18
) -> go.Figure:
    """Draw one row per name on a log axis: its residuals as points, the middle half as a bar, the worst as a cross.

    Args:
        samples: name -> residuals, not negative; NaN is left out, zeros and less than `floor` are drawn at `floor`,
            the number of infinite ones, or that there is none, stands beside the name.
        value_label: of the axis, with the unit.
        limit: drawn as a line: the largest residual that still counts as solved.
        floor: the smallest value drawn.

    Raises:
        ReportError: there is no finite residual at all, or one is negative.
    """
    drawn, styles = figure(showlegend=False), Styles(samples)
    names, ends = list(samples)[::-1], []
    for row, name in enumerate(names):
        known, style = known_samples(name, samples[name]), styles[name]
        values = np.sort(np.maximum(known[np.isfinite(known)], floor))
        if not len(values):
            continue
        ends += [values[0], values[-1]]
        shown = values[np.unique(np.linspace(0, len(values) - 1, _STRIP_POINTS).astype(int))]
        # A spread that is the same in every report: the golden section fills a band evenly.
        spread = ((np.arange(len(shown)) * 0.618034) % 1.0 - 0.5) * 0.5
        drawn.add_scatter(
            x=shown, y=row + spread, mode="markers", name=label(name), hovertemplate="%{x:.3g}",
            marker={"color": style.fill(0.35), "size": 4},
        )  # fmt: skip
        q25, q50, q75 = np.percentile(values, (25, 50, 75))
        _bar(drawn, row, (q25, q75), style)
        _marks(drawn, row, name, style, {"median": q50, "largest": values[-1]})
    log_axis(drawn, "x", value_label, _span(ends, limit), powers=True)
    _rows(drawn, names, samples)
    if limit is not None:
        rule(drawn, "x", limit, "limit")
    return drawn


def _rows(drawn: go.Figure, names: list[str], samples: Samples) -> None:
    """Put names at the left instead of numbers, and a height that gives each its room."""
    words = []
    for name in names:
        known = known_samples(name, samples[name])
        infinite = int(np.isinf(known).sum())
        words.append(label(name) + (f" ({infinite} × ∞)" if infinite else "" if len(known) else " (no sample)"))
    drawn.update_yaxes(
        tickvals=list(range(len(names))), ticktext=words, range=[-0.6, len(names) - 0.4],
        showgrid=False, ticks="", showline=False,
    )  # fmt: skip
    drawn.update_layout(height=90 + 42 * max(len(names), 2), margin_t=28)


def _bar(drawn: go.Figure, row: int, ends: tuple[float, float], style: Style) -> None:
    """Draw the middle half of the samples as a thick line."""
    drawn.add_scatter(
        x=list(ends), y=[row, row], mode="lines", line={"color": style.color, "width": 6}, hoverinfo="skip"
    )


def _marks(drawn: go.Figure, row: int, name: str, style: Style, values: Mapping[str, float]) -> None:
    """Draw the median as a disc, the last value as a cross, anything between as a stroke."""
    last = len(values) - 1
    symbols = ["circle", *["line-ns-open"] * (last - 1), "x-thin-open"]
    rims = [PAPER, *[style.color] * last]
    drawn.add_scatter(
        x=list(values.values()), y=[row] * len(values), mode="markers", name=label(name), text=list(values),
        marker={"color": style.color, "symbol": symbols, "size": [10, *[14] * (last - 1), 8],
                "line": {"width": 2, "color": rims}},
        hovertemplate="%{text}: %{x:.4g}<extra>%{fullData.name}</extra>",
    )  # fmt: skip


def known_samples(name: str, values: ArrayLike, *, signed: bool = False) -> Floats:
    """Return the samples that are not NaN, maybe none; not negative unless `signed`."""
    known = np.asarray(values, dtype=np.float64).ravel()
    known = known[~np.isnan(known)]
    if not signed and (known < 0.0).any():
        raise ReportError(f"{name!r} has the sample {known.min()}: times and residuals are not negative")
    return known


def _span(ends: list[float], limit: float | None) -> list[float]:
    """Return what the axis must show; there must be a sample, not a limit alone."""
    if not ends:
        raise ReportError("no name has a finite sample: leave the figure out and say why")
    return ends if limit is None else [*ends, limit]


def _ranks(count: int) -> NDArray[np.int64]:
    """Return which of `count` sorted samples to draw: evenly, and every one of the largest."""
    even = np.linspace(0, count - 1, _ECDF_POINTS)
    return np.unique(np.concatenate([even, count - np.geomspace(1, count, _ECDF_POINTS).astype(int)]).astype(np.int64))


def _log_density(times: Floats) -> tuple[Floats, Floats]:
    """Return kernel density of log10(times), its highest point 1; over the samples' own range and no further."""
    logs = np.log10(times)
    middle = np.subtract(*np.percentile(logs, (75, 25))) / 1.34
    spread = min(float(logs.std()), middle) if middle > 0.0 else float(logs.std())
    width = max(0.9 * spread * len(logs) ** -0.2, 4e-3)
    at = np.linspace(logs.min() - 2 * width, logs.max() + 2 * width, _KERNEL_POINTS)
    edges = np.linspace(at[0], at[-1], 1 + 8 * _KERNEL_POINTS)
    weight, _ = np.histogram(logs, edges)
    centre, used = 0.5 * (edges[1:] + edges[:-1]), weight > 0
    density = np.exp(-0.5 * ((at[:, None] - centre[used]) / width) ** 2) @ weight[used]
    return 10.0**at, density / density.max()
