"""Figures of the study that the report room has no kind for: profiles and sweeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from moc_opt.arrays import Array
from moc_opt.figures.style import TEMPLATE, Styles, figure, label, log_axis


def performance_profile(tau: Array, shares: Mapping[str, Array]) -> go.Figure:
    """Draw the share of problems over the ratio to the fastest (log axis); what ends below 1 left problems unsolved.

    Args:
        tau: ratios (m,), from 1.
        shares: name -> (m,), see `compare.profile`.
    """
    drawn, styles = figure(legend_y=1.08), Styles(shares)
    for name, share in shares.items():
        drawn.add_scatter(
            x=tau, y=np.round(share, 4), mode="lines", name=label(name),
            line={"color": styles[name].color, "dash": styles[name].dash, "width": 1.5, "shape": "hv"},
            hovertemplate="within %{x:.3g} of the fastest: %{y:.1%}<extra>%{fullData.name}</extra>",
        )  # fmt: skip
    log_axis(drawn, "x", "time over that of the fastest", tau, margin=0.0)
    drawn.update_yaxes(title="share of problems solved", range=[0.0, 1.02], tickformat=".0%")
    return drawn


def sweep_panels(
    sweeps: Mapping[str, Sequence[Mapping[str, Any]]], metrics: Mapping[str, str], x_label: str,
    zero: float | None = None,
) -> go.Figure:  # fmt: skip
    """Draw what is swept over a log axis, one panel per metric below each other.

    Args:
        sweeps: name -> points with ``value`` and the metrics.
        metrics: metric -> label of its panel.
        x_label: of the common axis.
        zero: where a value of 0 is drawn on the log axis; None leaves it out.
    """
    styles, names = Styles(sweeps), list(sweeps)
    drawn = make_subplots(rows=len(metrics), cols=1, shared_xaxes=True, vertical_spacing=0.25 / len(metrics))
    for row, (metric, words) in enumerate(metrics.items(), start=1):
        for name in names:
            points = [(p["value"] or zero, p.get(metric)) for p in sweeps[name]]
            known = [(x, y) for x, y in points if x and y is not None]
            drawn.add_scatter(
                x=[x for x, _ in known], y=[y for _, y in known], mode="lines+markers", name=label(name),
                legendgroup=name, showlegend=row == 1, row=row, col=1,
                line={"color": styles[name].color, "dash": styles[name].dash, "width": 1.4},
                marker={"symbol": styles[name].symbol, "size": 7},
                hovertemplate="%{x:.3g}: %{y:.4g}<extra>%{fullData.name}</extra>",
            )  # fmt: skip
        drawn.update_xaxes(type="log", row=row, col=1)
        drawn.add_annotation(
            text=words, xref="paper", x=0.0, xanchor="left", yref=f"y{row if row > 1 else ''} domain", y=1.0,
            yanchor="bottom", showarrow=False, font={"size": 12}, xshift=-2,
        )  # fmt: skip
    drawn.update_xaxes(title=x_label, row=len(metrics), col=1)
    drawn.update_layout(template=TEMPLATE, height=60 + 150 * len(metrics), legend={"y": 1.08, "yanchor": "bottom"})
    return drawn
