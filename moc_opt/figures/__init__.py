"""Functions that make plotly figures from plain arrays."""

from moc_opt.figures.comparisons import accuracy_against_time, pareto
from moc_opt.figures.distributions import box_plots, latency_ecdf
from moc_opt.figures.series import PANELS, envelope, time_series
from moc_opt.figures.style import Style, Styles

__all__ = [
    "PANELS", "Style", "Styles", "accuracy_against_time", "box_plots", "envelope", "latency_ecdf", "pareto",
    "time_series",
]  # fmt: skip
