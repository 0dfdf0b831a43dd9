"""The tables, the page and the headline of a sweep, all from its summary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import plotly.graph_objects as go

from benchmarks.common.answer import Answer, Picture, marked_answer
from moc_opt.figures.style import Styles, figure
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table

Summary = Mapping[str, Any]

SHOWN = {
    "mu_mean": Column("mu_mean", "mu", format=".4f", better="high"),
    "tip_error_mean_mm": Column("tip_error_mean_mm", "tip", unit="mm", digits=3, better="low"),
    "rcm_error_mean_mm": Column("rcm_error_mean_mm", "RCM", unit="mm", digits=3, better="low"),
    "trocar_force_mean_N": Column("trocar_force_mean_N", "force", unit="N", digits=2, better="low"),
    "torque_rate_rms_Nm_per_s": Column("torque_rate_rms_Nm_per_s", "chatter", unit="Nm/s", format=".0f", better="low"),
    "silently_wrong": Column("silently_wrong", "silently wrong", format=".1f", better="low", help="ticks of a run"),
}
PLOTTED = {"mu_mean": "Manipulability", "rcm_error_mean_mm": "RCM error [mm]"}
MORE, MOST_PICTURES = "Every table", 3
TIMES = ("solve_p50_us", "solve_p99_us", "tick_p50_us", "tick_p99_us")


def tables(summary: Summary) -> list[Table]:
    """Make the tables: by solver, by each field of the grid, times, and what went wrong."""
    counts = [
        Column("runs", "runs", format="d"),
        Column("failed", "failed", format="d", better="low", help="ended by an error; see rows.parquet"),
        Column("stopped", "stopped", format="d", better="low", help="by the safety filter; they enter no mean"),
        Column("oscillated", "oscillated", format="d", better="low", help="a joint shook; they enter the means"),
    ]
    found = []
    for part, groups in summary.items():
        if part == "solvers" or part.startswith("by "):
            there = {name for figures in groups.values() for name in figures}
            columns = [column for name, column in SHOWN.items() if name in there]
            first = "solver" if part == "solvers" else f"solver, {part.removeprefix('by ')}"
            title = "By solver" if part == "solvers" else f"By solver and {part.removeprefix('by ')}"
            rows = [{"group": group, **_means(figures)} for group, figures in groups.items()]
            found.append(
                Table(title, [Column("group", first), *counts, *columns], rows, "Means over the runs not stopped.")
            )
    if summary["latency"]:
        columns = [Column(name, name.removesuffix("_us").replace("_", " "), unit="us", digits=3) for name in TIMES]
        rows = [{"group": group, **_means(figures, "p50")} for group, figures in summary["latency"].items()]
        caption = f"Medians over the {summary['sweep']['runs']['timed_alone']} runs that had the machine to themselves."
        found.append(Table("Times", [Column("group", "solver"), counts[0], *columns], rows, caption))
    if summary["errors"]:
        rows = [{"error": error, **counted} for error, counted in summary["errors"].items()]
        found.append(Table("Errors", [Column("error", "error"), counts[0]], rows))
    return found


def headline(summary: Summary) -> str:
    """Return the result in words, computed."""
    runs = summary["sweep"]["runs"]
    ended = f"{runs['failed']} of them ended by an error, {runs['stopped']} stopped by the safety filter"
    parts = [f"{runs['all']} runs, {ended}"]
    best = {name: group["mu_mean"]["mean"] for name, group in summary["solvers"].items() if "mu_mean" in group}
    if len(best) > 1:
        first, last = max(best, key=lambda n: best[n]), min(best, key=lambda n: best[n])
        parts.append(f"mean manipulability from {best[last]:.4f} ({last}) to {best[first]:.4f} ({first})")
    if runs["timed_shared"]:
        parts.append(
            f"{runs['timed_shared']} runs were timed on shared workers, beside other runs: their times are in "
            "rows.parquet, marked timing_shared, and in no table"
        )
    return ". ".join(part[0].upper() + part[1:] for part in parts) + "."


def answer(summary: Summary, numeric: Mapping[str, list[float]]) -> Answer:
    """Make the first screen.

    Args:
        summary: of the sweep.
        numeric: the fields of the grid that are numbers, with their values.
    """
    first = tables(summary)[0]
    linked = [replace(column, section=MORE) for column in first.columns]
    return marked_answer(headline(summary), replace(first, columns=linked), pictures(summary, numeric)[:MOST_PICTURES])


def pictures(summary: Summary, numeric: Mapping[str, list[float]]) -> list[Picture]:
    """Draw the metrics over every field of the grid that is a number."""
    solvers, found = list(summary["solvers"]), []
    for field, values in numeric.items():
        for metric, label in PLOTTED.items():
            drawn = against(summary[f"by {field}"], solvers, field, values, metric, label)
            if drawn.data:
                says = f"{label} against {field}: mean over all other settings, 5th to 95th percentile."
                found.append(Picture(drawn, says, f"{metric}-{field}"))
    return found


def page(summary: Summary, numeric: Mapping[str, list[float]], first: Answer, environment: Summary) -> Page:
    """Make the page: the first screen, and folded below it every table and the other pictures."""
    page = Page("Sweep", f"{summary['sweep']['runs']['all']} runs")
    first.begin(page)
    page.section(MORE)
    for table in tables(summary):
        page.table(table)
    for picture in pictures(summary, numeric)[MOST_PICTURES:]:
        page.figure(picture.figure, picture.says, name=picture.name)
    page.environment(environment)
    return page


def against(groups: Summary, solvers: list[str], field: str, values: list[float], metric: str, label: str) -> go.Figure:
    """Draw a metric's mean over a field of the grid, one line a solver, bars from the 5th to the 95th percentile."""
    drawn, styles = figure(), Styles(solvers)
    for solver in solvers:
        found = [(v, groups.get(f"{solver}, {v}", {}).get(metric)) for v in sorted(values)]
        points = [(v, f) for v, f in found if f is not None]
        if points:
            mean = [f["mean"] for _, f in points]
            drawn.add_scatter(
                x=[v for v, _ in points], y=mean, name=solver, mode="lines+markers",
                line={"color": styles[solver].color, "dash": styles[solver].dash},
                marker={"symbol": styles[solver].symbol},
                error_y={
                    "array": [max(f["p95"] - m, 0.0) for (_, f), m in zip(points, mean, strict=True)],
                    "arrayminus": [max(m - f["p05"], 0.0) for (_, f), m in zip(points, mean, strict=True)],
                    "thickness": 1, "width": 3,
                },
            )  # fmt: skip
    wide = min(values) > 0.0 and max(values) >= 30.0 * min(values)
    drawn.update_xaxes(title_text=field, type="log" if wide else "linear")
    drawn.update_yaxes(title_text=label)
    return drawn


def _means(figures: Mapping[str, Any], which: str = "mean") -> dict[str, Any]:
    return {name: entry[which] if isinstance(entry, Mapping) else entry for name, entry in figures.items()}
