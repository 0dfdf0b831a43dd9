"""Figures: plain data or runs in, a plotly figure in the house style out, one function per kind of figure.

``style`` has the colours and the template, ``notation`` the text of numbers, units and missing values. Imports no
trace: a run is its columns. Imports ``errors``; any room above may import it.
"""

from moc_opt.figures.boxes import box_plots
from moc_opt.figures.comparisons import (
    OUTCOMES,
    accuracy_against_time,
    outcomes,
    pareto,
    solution_quality,
)
from moc_opt.figures.distributions import latency_ecdf, latency_violin, residual_strip
from moc_opt.figures.series import PANELS, envelope, time_series
from moc_opt.figures.style import Style, Styles

__all__ = [
    "OUTCOMES", "PANELS", "Style", "Styles", "accuracy_against_time", "box_plots", "envelope", "latency_ecdf",
    "latency_violin", "outcomes", "pareto", "residual_strip", "solution_quality", "time_series",
]  # fmt: skip
