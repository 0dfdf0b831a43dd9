"""How a run ended."""

from __future__ import annotations

from moc_opt.trace.ending import Ending
from moc_opt.trace.metrics.registry import metric
from moc_opt.trace.trace import MissingDataError, Trace


@metric
def completed(trace: Trace) -> float:
    """1 where the run ended "completed", 0 where it was stopped, ran away or oscillated; a part of a run has none."""
    ended = trace.meta.get("ended")
    if not isinstance(ended, str):
        raise MissingDataError("meta has no 'ended': say how the run ended")
    if Ending.of(ended) is Ending.PART:
        raise MissingDataError("these are some ticks of a run: ask the whole run whether it was completed")
    return Ending.of(ended) is Ending.COMPLETED


@metric
def share_of_run(trace: Trace) -> float:
    """Share of the planned ticks that are in the trace: below 1 its other figures are those of a part."""
    ticks, planned = trace.meta.get("ticks"), trace.meta.get("ticks_planned")
    if not isinstance(ticks, int) or not isinstance(planned, int) or planned < 1:
        raise MissingDataError("meta has no 'ticks' and 'ticks_planned': give both as numbers of ticks")
    return ticks / planned
