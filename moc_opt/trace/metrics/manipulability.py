"""Manipulability over a run."""

from __future__ import annotations

import numpy as np

from moc_opt.trace.metrics.registry import floats, known, metric
from moc_opt.trace.trace import MissingDataError, Trace


@metric("m^3")
def mu_mean(trace: Trace) -> float:
    """Mean manipulability over the ticks [m^3]."""
    return floats(trace, "mu").mean()


@metric("m^3")
def mu_final(trace: Trace) -> float:
    """Manipulability at the last tick [m^3]."""
    return floats(trace, "mu")[-1]


@metric("percent")
def mu_gain_percent(trace: Trace, baseline: Trace | None) -> float:
    """Mean manipulability above the baseline's [percent of it]; between runs compare mu_mean.

    The baseline of a run along a course has the observer gain of the course, that of a climb the gain of the climb: so
    two third levels are not compared by their gains over different baselines.
    """
    if baseline is None:
        raise MissingDataError("mu_gain_percent needs a baseline: give the trace of DCAC on the same trial")
    reference = mu_mean(baseline)
    if reference == 0.0:
        raise MissingDataError("the baseline is singular throughout: a gain over zero has no value")
    return 100.0 * (mu_mean(trace) / reference - 1.0)


@metric
def mu_fraction_of_bound(trace: Trace) -> float:
    """Mean manipulability over that of the largest of all feasible poses, at the ticks where it was looked for."""
    bound = float(known(trace, "mu_bound").mean())
    if bound == 0.0:
        raise MissingDataError("the largest mu is zero throughout: a share of it has no value")
    return float(floats(trace, "mu")[~np.isnan(trace.mu_bound)].mean()) / bound


@metric
def mu_fraction_of_best_from_start(trace: Trace) -> float:
    """Mean manipulability over that of the best course from the same start, where planned."""
    return mu_mean(trace) / known(trace, "mu_best_from_start").mean()


@metric
def mu_fraction_of_best(trace: Trace) -> float:
    """Mean manipulability over that of the best course from any swivel and branch, where planned."""
    return mu_mean(trace) / known(trace, "mu_best").mean()
