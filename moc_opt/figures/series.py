"""Runs over time, in stacked panels."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import ArrayLike, NDArray
from plotly.subplots import make_subplots

from moc_opt.errors import ReportError, shown
from moc_opt.figures.style import TEMPLATE, Styles, label, legend_height

Floats = NDArray[np.float64]
Columns = Mapping[str, NDArray[Any]]
PANELS = {
    "mu": ("µ [m³]", 1.0),
    "tip_error_m": ("tip error, base frame [mm]", 1e3),
    "rcm_error_m": ("RCM error, base frame [mm]", 1e3),
    "trocar_force_N": ("|force| [N]", 1.0),
}
"""Each column's label, and the factor to the label's unit."""
TIPS = {
    "tip_error_model_m": ("tip error, kinematic model [mm]", 1e3),
    "tip_error_registered_m": ("tip error, frame registered at the start [mm]", 1e3),
}
LABELS = {**PANELS, **TIPS}
LARGEST = "largest feasible µ"
HOVER = "%{y:.4g}<extra>%{fullData.name}</extra>"


def time_series(
    runs: Mapping[str, Any], panels: Sequence[str] | None = None, *, styles: Styles | None = None
) -> go.Figure:
    """Draw runs over time, with one panel per column.

    A dotted line is the largest mu of all feasible poses with the same tip and shaft.

    Args:
        runs: for each name, a `Trace` or a dict of columns. Of a column (N, k), the norm of each row is drawn.
        panels: columns. None: ``PANELS``, with `tip_error_m` replaced by the columns of ``TIPS`` that all runs have.

    Raises:
        ReportError: ``panels`` is empty or not a list, a column is missing or has texts, or a run has no `t_s`.
    """
    styles = styles or Styles(runs)
    data: dict[str, Columns] = {name: getattr(run, "columns", run) for name, run in runs.items()}
    for name, columns in data.items():
        if "t_s" not in columns:
            raise ReportError(f"run {name!r} has no column t_s: give the time of each row [s]")
    if panels is None:
        tips = [name for name in TIPS if all(name in columns for columns in data.values())] or ["tip_error_m"]
        panels = ["mu", *tips, "rcm_error_m", "trocar_force_N"]
    else:
        _check(panels, data)
    drawn = make_subplots(rows=len(panels), cols=1, shared_xaxes=True, vertical_spacing=0.22 / len(panels))
    for row, column in enumerate(panels, start=1):
        words, factor = LABELS.get(column, (label(column), 1.0))
        for rank, (name, columns) in enumerate(data.items()):
            if column not in columns:
                continue
            values, line = columns[column], {"color": styles[name].color, "width": 1.3}
            sizes = np.linalg.norm(values, axis=1) if values.ndim == 2 else values.astype(np.float64)
            t, y = envelope(columns["t_s"], factor * sizes)
            drawn.add_scatter(
                x=t.astype(np.float32), y=y.astype(np.float32), mode="lines", name=label(name), legendgroup=name,
                row=row, col=1, connectgaps=False, line={**line, "dash": styles[name].dash}, hovertemplate=HOVER,
                legendrank=rank,
            )  # fmt: skip
            if column == "mu" and np.isfinite(bound := columns.get("mu_bound", np.zeros(0))).any():
                scanned = ~np.isnan(bound)
                drawn.add_scatter(
                    x=columns["t_s"][scanned], y=bound[scanned], mode="lines", name=LARGEST, legendgroup="largest",
                    row=row, col=1, opacity=0.8, line={**line, "dash": "dot"}, hovertemplate=HOVER,
                    legendrank=len(data),
                )  # fmt: skip
        drawn.update_yaxes(row=row, col=1, rangemode="normal" if column == "mu" else "tozero", nticks=5)
        # On a narrow screen, there is no place beside the panel.
        drawn.add_annotation(
            text=words, xref="paper", x=0.0, xanchor="left", yref=f"y{row if row > 1 else ''} domain", y=1.0,
            yanchor="bottom", showarrow=False, font={"size": 12}, xshift=-2,
        )  # fmt: skip
    if not drawn.data:
        raise ReportError(f"no run has any of the columns {', '.join(panels)}: choose columns that exist in a trace")
    groups = [trace.legendgroup for trace in drawn.data]
    for k, trace in enumerate(drawn.data):
        trace.showlegend = trace.legendgroup not in groups[:k]
    drawn.update_xaxes(title_text="time [s]", row=len(panels), col=1)
    height = 70 + 155 * len(panels) + legend_height([*data, LARGEST])
    drawn.update_layout(template=TEMPLATE, height=height, legend_y=1.06, margin_t=30, hovermode="x unified")
    return drawn


def envelope(t: ArrayLike, y: ArrayLike, points: int = 1200) -> tuple[Floats, Floats]:
    """Thin a series to its two ends and, of each of many equal stretches, the smallest and the largest value.

    If a stretch has NaN, one NaN of it is kept, too.

    Args:
        t, y: (N,) times and values; NaN in y is a gap.
        points: largest number of points.

    Raises:
        ReportError: t and y differ in length, or `points` is below 4.
    """
    times, values = np.asarray(t, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if times.shape != values.shape or times.ndim != 1:
        raise ReportError(f"t has shape {times.shape}, y {values.shape}: give one value per time")
    if points < 4:
        raise ReportError(f"points = {points}: give 4 or more")
    if len(times) <= points:
        return times, values
    kept = {0, len(times) - 1}
    for stretch in np.array_split(np.arange(len(times)), points // 2 - 1):
        known = stretch[~np.isnan(values[stretch])]
        if len(known):
            kept |= {int(known[np.argmin(values[known])]), int(known[np.argmax(values[known])])}
        if len(known) < len(stretch):
            kept.add(int(np.setdiff1d(stretch, known)[0]))
    chosen = np.array(sorted(kept))
    return times[chosen], values[chosen]


def _check(panels: object, runs: Mapping[str, Columns]) -> None:
    if isinstance(panels, str) or not isinstance(panels, Sequence) or not panels:
        raise ReportError(f"columns = {shown(panels)}: give a list of names, such as ['mu', 'tip_error_m']")
    everything = {name: array for columns in runs.values() for name, array in columns.items()}
    drawable = sorted(name for name, array in everything.items() if array.dtype.kind in "fiub")
    for name in panels:
        if name not in drawable:
            kind = "holds texts" if name in everything else "is in no run"
            near = difflib.get_close_matches(str(name), drawable, n=3) or drawable
            raise ReportError(f"column {shown(name)} {kind}: choose numeric columns, such as {', '.join(near)}")
