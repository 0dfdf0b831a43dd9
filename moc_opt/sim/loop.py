"""Run the closed loop over references, and record what really happened."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import PlantError
from moc_opt.sim.closed_loop import DEFAULT_STOP, ClosedLoop, CompiledSteps, Stop
from moc_opt.sim.faults import Faults
from moc_opt.sim.log import Block, Log, Sink, TaskOffset, Trajectories, Trajectory
from moc_opt.sim.plant import Plant
from moc_opt.sim.protocols import LoggedController, SafetyFilter
from moc_opt.trace.trace import Trace

BLOCK = 5000
"""Ticks that are kept in memory where a sink takes them."""


class RunAway(PlantError):
    """The plant could not go on; ``trace`` holds the rows so far."""

    def __init__(self, message: str, trace: Trace) -> None:
        super().__init__(message)
        self.trace = trace


@contextmanager
def no_collector() -> Iterator[None]:
    """Keep the garbage collector off inside a real-time loop.

    Only young objects are looked through first: a full collection takes 0.1 s once the libraries are loaded.
    """
    enabled = gc.isenabled()
    gc.collect(1)
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _blank(columns: Mapping[str, NDArray[Any]], row: int) -> None:
    """Clear the third level's columns of a row in a damped stop: no solver ran in that tick."""
    for name, value in _STOPPED.items():
        if name in columns:
            columns[name][row] = value


_STOPPED = {
    "status": "none", "fault": "stopped", "x_rad_per_s": np.nan, "applied_x_rad_per_s": np.nan,
    "dual": np.nan, "iterations": 0, "solve_us": np.nan,
}  # fmt: skip


def _rows(log: Log, loop: ClosedLoop, watch: Callable[[int], None] | None) -> Iterator[tuple[Block, int]]:
    """Go through the rows that are left to ``step``: compiled steps take all others."""
    for now in log.blocks():
        while now.done < now.ticks:
            if watch is not None:
                watch(loop.ticks)
            if not loop.advance(now, now.ticks - now.done if watch is None else 1):
                yield now, now.done


def simulate(
    plant: Plant, controller: LoggedController, tip_refs: Trajectory, trocars: Trajectory, registered: Trajectory, *,
    safety_filter: SafetyFilter | None = None, faults: Faults | None = None, stop: Stop = DEFAULT_STOP,
    offset: TaskOffset | None = None, watch: Callable[[int], None] | None = None,
    meta: Mapping[str, Any] | None = None, sink: Sink | None = None, block: int = BLOCK,
    compiled: CompiledSteps | None = None,
) -> Trace:  # fmt: skip
    """Run the closed loop from the plant's present state, and record it.

    Args:
        plant: already reset to the start.
        controller: computes the torque, and may add columns.
        tip_refs: (N, 3, 3) rows X_d, dX_d, ddX_d of every tick.
        trocars: (N, 2, 3) rows P_t, dP_t: where the trocar really is.
        registered: (N, 2, 3) the registered trocar.
        safety_filter: checks measurements and limits torques; None: neither.
        faults: disturb sensors and arm; None: nothing does.
        stop: how the arm is stopped once the safety filter has requested it.
        offset: how the robot's frame lies in the true one, where `tip_refs` and `registered` were taken with its
            own tip; None: as the true one.
        watch: called with the tick's number before each tick (progress, events).
        meta: goes into the trace.
        sink: takes the rows, ``block`` ticks at a time and what there is when the loop ends, in whatever way; the
            trace that is returned then has no columns. None: all rows stay in memory.
        block: see ``sink``.
        compiled: as for `ClosedLoop`, of this plant, controller and safety filter.

    Returns:
        One row per tick: the state at its start, and the torque applied then. ``meta["ended"]`` is "completed", or
        "stopped: ..." with the rows so far, and ``meta["stopped_at_s"]`` says when. ``meta["ticks"]`` of
        ``meta["ticks_planned"]`` (N) are there; ``meta["warnings"]``, where there are any, are the safety
        filter's. ``meta["faults"]``, of a controller that counts them, are its refused answers: label -> count,
        first_at_s, first (in words). ``meta["restarts"]``, where there are any, says when (at_s) the process of an
        isolated solver was replaced, and why (reason).

    Raises:
        RunAway: the plant cannot go on; the error holds the trace so far.
    """
    ticks, offset = len(tip_refs), TaskOffset.nothing() if offset is None else offset
    log = Log(plant, controller, Trajectories(tip_refs, trocars, registered), offset, sink, block)
    loop = ClosedLoop(plant, controller, safety_filter, stop, faults, compiled)
    loop.start(log.block.tip_refs[0], log.block.registered[0])
    begin_s = float(log.block.kept["t_s"][0])
    broken: PlantError | None = None
    found: dict[str, Any] = {"period_s": plant.settings.period_s, "ended": "completed"}
    try:
        with no_collector():
            for now, row in _rows(log, loop, watch):
                if not loop.begun:  # if so, the row has its truth, and the arm may have moved since
                    plant.write_truth(now.truth[row])
                try:
                    loop.step(now.tip_refs[row], now.registered[row], now.trocars[row])
                except PlantError as error:
                    broken = error
                controller.note(row, now.kept)
                now.wrench[row], now.tau[row], now.tick_us[row] = loop.seen.force, loop.tau, loop.tick_us
                if loop.limited:
                    now.limited[row] = loop.limited
                now.done = row + 1
                if loop.stop_reason:
                    _blank(now.kept, row)
                    if "stopped_at_s" not in found:
                        t = float(now.kept["t_s"][row])
                        found |= {"ended": f"stopped: {loop.stop_reason} (t = {t:.3f} s)", "stopped_at_s": t}
                    if loop.finished:
                        break
                if broken is not None:
                    found["ended"] = f"ran away at t = {now.kept['t_s'][row]:.3f} s"
                    break
    except BaseException:
        log.close()  # the measurements are kept, however the loop ends
        raise
    columns = log.close()
    found |= {"ticks": loop.ticks, "ticks_planned": ticks}
    found |= {"faults": controller.faults} if hasattr(controller, "faults") else {}
    if restarts := getattr(controller, "restarts", None):
        found["restarts"] = restarts
    if loop.warnings:
        found["warnings"] = [{**w, "first_s": begin_s + w["first_s"]} for w in loop.warnings]
    trace = Trace(columns, {**found, **(meta or {})})
    if broken is not None:
        raise RunAway(f"{found['ended']}: {broken}", trace) from broken
    return trace
