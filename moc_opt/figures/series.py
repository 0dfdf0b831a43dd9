"""Runs over time: manipulability, tip error, RCM error and force in stacked panels."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import plotly.graph_objects as go
from numpy.typing import ArrayLike, NDArray
from plotly.subplots import make_subplots

from moc_opt.errors import ReportError, shown
from moc_opt.figures.style import TEMPLATE, Styles, label, legend_height

Floats = NDArray[np.float64]
PANELS = {
    "mu": ("µ [m³]", 1.0),
    "tip_error_m": ("tip error in space [mm]", 1e3),
    "rcm_error_m": ("RCM error [mm]", 1e3),
    "trocar_force_N": ("|force| [N]", 1.0),
}
"""Column of a trace -> label of its panel, and the factor to the unit there."""
MODEL_TIP = "tip_error_model_m"
LABELS = {**PANELS, MODEL_TIP: ("tip error, own kinematics [mm]", 1e3)}
"""The same, of every column that has a label of its own: two errors of the tip must not look like one."""


class Run(Protocol):
    """The columns of a run that are drawn; a `Trace` has them."""

    @property
    def columns(self) -> Mapping[str, NDArray[Any]]:
        """Name -> (N,) or (N, k), one row a tick."""

    @property
    def meta(self) -> Mapping[str, Any]:
        """How the run came about."""

    def __getattr__(self, name: str) -> NDArray[Any]:
        """Return a column, or raise an error that says which there are."""


def time_series(
    runs: Mapping[str, Run], panels: Sequence[str] | None = None, *, styles: Styles | None = None
) -> go.Figure:
    """Draw several runs over time, one panel per column, one legend entry per run for all panels.

    Beside mu the largest mu of all feasible poses is dotted in, one legend entry for all runs; a curve's own name
    says how it was found.
    Long runs are thinned to the smallest and largest value of each stretch of time: peaks stay as high as they
    are.

    Args:
        runs: name -> trace; a run that lacks a column is absent from its panel; of vectors the length is drawn.
        panels: columns, from top to bottom; None: those of ``PANELS``, with the tip's error by the robot's own
            kinematics where every run has it. The absolute one is mostly the error of the arm's calibration.
        styles: of each run; None assigns colours anew.

    Raises:
        ReportError: ``panels`` is empty, no list of names, or names a column that no run has or that holds texts.
        MissingDataError: a run has no `t_s`.
    """
    styles = styles or Styles(runs)
    if panels is None:
        known = all(MODEL_TIP in trace.columns for trace in runs.values())
        panels = [MODEL_TIP if known and column == "tip_error_m" else column for column in PANELS]
    else:
        panels = _checked(panels, runs)
    drawn = make_subplots(rows=len(panels), cols=1, shared_xaxes=True, vertical_spacing=0.22 / len(panels))
    named: set[str] = set()
    for row, column in enumerate(panels, start=1):
        words, factor = LABELS.get(column, (label(column), 1.0))
        for name, trace in runs.items():
            if column not in trace.columns:
                continue
            values = trace.columns[column]
            sizes = np.linalg.norm(values, axis=1) if values.ndim == 2 else values.astype(np.float64)
            t, y = envelope(trace.t_s, factor * sizes)
            drawn.add_scatter(
                x=t.astype(np.float32), y=y.astype(np.float32), mode="lines", name=label(name), legendgroup=name,
                showlegend=name not in named, row=row, col=1, connectgaps=False,
                line={"color": styles[name].color, "dash": styles[name].dash, "width": 1.3},
                hovertemplate="%{y:.4g}<extra>%{fullData.name}</extra>",
            )  # fmt: skip
            named.add(name)
            if column == "mu" and "mu_bound" in trace.columns and not np.isnan(trace.mu_bound).all():
                scanned = ~np.isnan(trace.mu_bound)
                how = trace.meta.get("mu_bound_method", "scanned")
                drawn.add_scatter(
                    x=trace.t_s[scanned], y=trace.mu_bound[scanned], mode="lines", name="largest µ of all poses",
                    legendgroup="largest", showlegend="largest" not in named, row=row, col=1, opacity=0.8,
                    line={"color": styles[name].color, "dash": "dot", "width": 1.3},
                    hovertemplate=f"%{{y:.4g}}<extra>{label(name)}, largest: {label(how)}</extra>",
                )  # fmt: skip
                named.add("largest")
        drawn.update_yaxes(row=row, col=1, rangemode="normal" if column == "mu" else "tozero", nticks=5)
        # Horizontal, above its panel: it can be read on a narrow screen.
        drawn.add_annotation(
            text=words, xref="paper", x=0.0, xanchor="left", yref=f"y{row if row > 1 else ''} domain", y=1.0,
            yanchor="bottom", showarrow=False, font={"size": 12}, xshift=-2,
        )  # fmt: skip
    if not named:
        raise ReportError(f"no run has any of the columns {', '.join(panels)}: name columns that a trace has")
    drawn.update_xaxes(title_text="time [s]", row=len(panels), col=1)
    height = 70 + 155 * len(panels) + legend_height(runs)
    drawn.update_layout(template=TEMPLATE, height=height, legend_y=1.06, margin_t=30, hovermode="x unified")
    return drawn


def envelope(t: ArrayLike, y: ArrayLike, points: int = 1200) -> tuple[Floats, Floats]:
    """Thin a series to at most `points` without losing a peak.

    Args:
        t, y: (N,) times and values; NaN in y is a gap and stays one.
        points: at least 4; a series that is no longer comes back as it is.

    Returns:
        (K,) times and values of the same series: first and last, and of every stretch the smallest and the
        largest, in their order.

    Raises:
        ReportError: t and y are not of one length, or `points` is too small.
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
        inside = values[stretch]
        known = ~np.isnan(inside)
        if known.any():
            kept.add(int(stretch[known][np.argmin(inside[known])]))
            kept.add(int(stretch[known][np.argmax(inside[known])]))
        if not known.all():
            kept.add(int(stretch[~known][0]))
    chosen = np.array(sorted(kept))
    return times[chosen], values[chosen]


def _checked(panels: object, runs: Mapping[str, Run]) -> list[str]:
    """Return the columns that were asked for, each one of numbers in a run at least."""
    if isinstance(panels, str) or not isinstance(panels, Sequence) or not panels:
        raise ReportError(f"columns = {shown(panels)}: give a list of names, such as ['mu', 'tip_error_m']")
    drawable = sorted({
        name for run in runs.values() for name, array in run.columns.items() if array.dtype.kind in "fiub"
    })  # fmt: skip
    for name in panels:
        if name not in drawable:
            kind = "holds texts" if any(name in run.columns for run in runs.values()) else "is in no run"
            near = difflib.get_close_matches(str(name), drawable, n=3) or drawable
            raise ReportError(f"column {shown(name)} {kind}: name columns of numbers, such as {', '.join(near)}")
    return list(panels)
