"""The figures of the paper's experiment: Figure 7 and its variants, the gain against the start, one trial over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from benchmarks.paper_experiment.trials import BASELINES, Outcome
from moc_opt import figures
from moc_opt.figures.style import MUTED, SERIES, figure, label
from moc_opt.report.export import browser, save_figures
from moc_opt.trace.trace import Trace

PANELS = {
    "mu": ("mu", "manipulability [m³]", 1.0),
    "tip_error_model_m": ("tip", "tip error [mm]", 1e3),
    "rcm_error_m": ("rcm", "RCM error [mm]", 1e3),
    "trocar_force_N": ("force", "|force at the trocar| [N]", 1.0),
}
"""Column -> short name, label of the axis, factor to its unit."""


def titles(controllers: Sequence[str]) -> dict[str, str]:
    """Map each controller to its name in figures."""
    return {name: BASELINES.get(name, f"MOC, {name}") for name in controllers}


def box_figures(outcomes: Sequence[Outcome], group: str, tasks: Sequence[str]) -> dict[str, go.Figure]:
    """Draw one figure a quantity: boxes over the ticks of all trials, by task, a colour a controller."""
    mine = [o for o in outcomes if any(m.group == group for m in o.measurements)]
    controllers = list(dict.fromkeys(controller for o in mine for controller, _ in o.samples))
    names, drawn = titles(controllers), {}
    for column, (short, axis, factor) in PANELS.items():
        boxes: dict[str, dict[str, NDArray[Any]]] = {}
        for controller in controllers:
            for task in tasks:
                parts = [o.samples[controller, task][column] for o in mine if (controller, task) in o.samples]
                if parts:
                    boxes.setdefault(names[controller], {})[task] = factor * np.concatenate(parts)
        if boxes:
            drawn[f"figure7-{group}-{short}"] = figures.box_plots(boxes, axis)
    return drawn


def trial_figure(traces: Mapping[str, Trace]) -> go.Figure:
    """Draw one trial over time."""
    names = titles(list(traces))
    return figures.time_series({names[name]: trace for name, trace in traces.items()})


def swivel_figure(rows: Sequence[Mapping[str, Any]]) -> go.Figure:
    """Draw the gain in mu and mu at the start against the place on the feasible self-motion."""
    known = [row for row in rows if "gain_percent" in row]
    drawn, colors = figure(), list(SERIES)
    places = [row["fraction"] for row in known]
    drawn.add_scatter(
        x=places, y=[row["gain_percent"] for row in known], name=label("gain over DCAC [%]"), mode="lines+markers",
        line={"color": colors[0]}, hovertemplate="%{y:.1f} %<extra></extra>",
    )  # fmt: skip
    drawn.add_scatter(
        x=places, y=[row["mu_start"] for row in known], name=label("µ at the start [m³]"), yaxis="y2", mode="lines",
        line={"color": colors[1], "dash": "dash"}, hovertemplate="%{y:.3f} m³<extra></extra>",
    )  # fmt: skip
    top = [row for row in known if row["at_maximum"]]
    drawn.add_scatter(
        x=[row["fraction"] for row in top], y=[row["gain_percent"] for row in top], mode="markers",
        name=label("start at the largest µ"), marker={"color": colors[0], "size": 13, "symbol": "star"},
        hovertemplate="%{y:.1f} %<extra></extra>",
    )  # fmt: skip
    drawn.update_xaxes(title_text="start on the feasible self-motion (0: one end, 1: the other)")
    drawn.update_yaxes(title_text="gain in mean µ over DCAC [%]")
    drawn.update_layout(
        yaxis2={"overlaying": "y", "side": "right", "title": {"text": "µ at the start [m³]"}, "showgrid": False,
                "linecolor": MUTED, "ticks": "outside", "showline": True, "zeroline": False},
        margin_r=64,
    )  # fmt: skip
    return drawn


def save(drawn: Mapping[str, go.Figure], folder: Path) -> list[Path]:
    """Save each figure as FOLDER/NAME.svg and NAME.png.

    Raises:
        BrowserError: no browser can be driven here; the message holds the cure.
    """
    written = save_figures(drawn, folder, ("svg",))
    with browser() as chromium:
        page = chromium.new_page(device_scale_factor=2.0)
        for vector in list(written):
            page.set_content(f"<body style='margin:0;background:white'>{vector.read_text(encoding='utf-8')}</body>")
            pixels = vector.with_suffix(".png")
            page.locator("svg").first.screenshot(path=pixels)
            written.append(pixels)
    return written
