"""Times, claims, verdicts and residuals of the solver."""

from __future__ import annotations

from functools import partial

import numpy as np

from moc_opt.errors import TraceError
from moc_opt.trace.metrics.registry import count, figure, known, metric
from moc_opt.trace.trace import MissingDataError, Trace

solve_p50_us, solve_p99_us, tick_p50_us, tick_p99_us = (
    figure(f"{what}_p{q}_us", f"{what}_us", "us", f"{words} time of a {of} [us].", partial(np.percentile, q=q), known)
    for what, of in (("solve", "solve"), ("tick", "whole tick"))
    for q, words in ((50, "Median"), (99, "99th percentile of the"))
)


@metric
def deadline_misses(trace: Trace) -> float:
    """Ticks that took longer than meta["deadline_us"]."""
    deadline = trace.meta.get("deadline_us")
    if deadline is None:
        raise MissingDataError("meta has no 'deadline_us': give the time a tick may take [us]")
    if isinstance(deadline, bool) or not isinstance(deadline, (int, float)) or deadline <= 0.0:
        raise TraceError(f"meta['deadline_us'] = {deadline!r}: give a positive number of microseconds")
    return count(trace.tick_us > deadline)


@metric
def claimed_solved(trace: Trace) -> float:
    """Ticks at which the solver claimed to have solved the subproblem."""
    return count(trace.status == "solved")


@metric
def verified_solved(trace: Trace) -> float:
    """Ticks at which the answer was judged optimal, whatever the solver claimed."""
    return count(trace.verified)


@metric
def silently_wrong(trace: Trace) -> float:
    """Ticks at which the solver claimed success and the answer was judged wrong."""
    return count((trace.status == "solved") & ~trace.verified)


@metric
def faults(trace: Trace) -> float:
    """Ticks at which the third level's answer was refused or missing, for any reason."""
    return count((trace.fault != "none") & (trace.fault != "stopped"))


@metric
def limited_ticks(trace: Trace) -> float:
    """Ticks at which the safety filter changed the torque that was asked for."""
    return count(trace.limited)


primal_max = figure(
    "primal_max", "primal", "rad/s, m/s",
    "Largest max(|A x - b|_inf, box violation) over the subproblems [rad/s, m/s].", np.max, known,
)  # fmt: skip
natural_max = figure(
    "natural_max", "natural", "rad/s", "Largest natural residual over the subproblems [rad/s].", np.max, known
)
loss_max = figure(
    "loss_max", "loss", "1", "Largest share of the cost's range that an answer gave away: 0 at the optimum, 1 at the "
    "worst point.", np.max, known,
)  # fmt: skip
