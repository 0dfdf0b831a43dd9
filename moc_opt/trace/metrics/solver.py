"""Times, claims, verdicts and residuals of the solver."""

from __future__ import annotations

import numpy as np

from moc_opt.errors import TraceError
from moc_opt.trace.metrics.registry import count, known, metric
from moc_opt.trace.trace import MissingDataError, Trace


@metric("us")
def solve_p50_us(trace: Trace) -> float:
    """Median time of a solve [us]."""
    return np.percentile(known(trace, "solve_us"), 50)


@metric("us")
def solve_p99_us(trace: Trace) -> float:
    """99th percentile of the time of a solve [us]."""
    return np.percentile(known(trace, "solve_us"), 99)


@metric("us")
def tick_p50_us(trace: Trace) -> float:
    """Median time of a whole tick [us]."""
    return np.percentile(known(trace, "tick_us"), 50)


@metric("us")
def tick_p99_us(trace: Trace) -> float:
    """99th percentile of the time of a whole tick [us]."""
    return np.percentile(known(trace, "tick_us"), 99)


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
    """Ticks at which the third level's answer was refused or missing, for whatever reason."""
    return count((trace.fault != "none") & (trace.fault != "stopped"))


@metric
def limited_ticks(trace: Trace) -> float:
    """Ticks at which the guard changed the torque that was asked for."""
    return count(trace.limited)


@metric("rad/s, m/s")
def primal_max(trace: Trace) -> float:
    """Largest max(|A x - b|_inf, box violation) over the subproblems [rad/s, m/s]."""
    return known(trace, "primal").max()


@metric("rad/s")
def natural_max(trace: Trace) -> float:
    """Largest natural residual over the subproblems [rad/s]."""
    return known(trace, "natural").max()


@metric
def loss_max(trace: Trace) -> float:
    """Largest share of the cost's range that an answer gave away: 0 at the optimum, 1 at the worst point."""
    return known(trace, "loss").max()
