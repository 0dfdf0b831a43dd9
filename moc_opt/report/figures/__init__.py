"""Figures: plain data or traces in, a plotly figure in the house style out."""

from moc_opt.report.figures.boxes import box_plots
from moc_opt.report.figures.comparisons import (
    OUTCOMES,
    accuracy_against_time,
    outcomes,
    pareto,
    solution_quality,
)
from moc_opt.report.figures.distributions import latency_ecdf, latency_violin, residual_strip
from moc_opt.report.figures.series import PANELS, envelope, time_series
from moc_opt.report.figures.style import Style, Styles

__all__ = [
    "OUTCOMES", "PANELS", "Style", "Styles", "accuracy_against_time", "box_plots", "envelope", "latency_ecdf",
    "latency_violin", "outcomes", "pareto", "residual_strip", "solution_quality", "time_series",
]  # fmt: skip
