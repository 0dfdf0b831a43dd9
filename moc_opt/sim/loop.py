"""Run the closed loop over references, and record what really happened."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import PlantError
from moc_opt.sim.closed_loop import DEFAULT_STOP, ClosedLoop, Stop
from moc_opt.sim.faults import Faults
from moc_opt.sim.log import Columns, Log, TaskOffset
from moc_opt.sim.plant import Plant
from moc_opt.sim.protocols import LoggedController, SafetyFilter
from moc_opt.trace.trace import Trace


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


_STOPPED = {
    "status": "none", "fault": "stopped", "x_rad_per_s": np.nan, "applied_x_rad_per_s": np.nan,
    "dual": np.nan, "iterations": 0, "solve_us": np.nan,
}  # fmt: skip


def simulate(
    plant: Plant, controller: LoggedController, tip_refs: Array, trocars: Array, registered: Array, *,
    safety_filter: SafetyFilter | None = None, faults: Faults | None = None, stop: Stop = DEFAULT_STOP,
    offset: TaskOffset | None = None, watch: Callable[[int], None] | None = None,
    meta: Mapping[str, Any] | None = None, rescue: Callable[[Columns], None] | None = None,
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
        rescue: called with the columns of the rows so far where any other exception than RunAway ends the loop.

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
    log = Log(plant, controller, tip_refs, trocars, registered, offset)
    loop = ClosedLoop(plant, controller, safety_filter, stop, faults)
    loop.start(tip_refs[0], registered[0])
    begin_s = float(log.kept["t_s"][0])
    broken: PlantError | None = None
    found: dict[str, Any] = {"period_s": plant.settings.period_s, "ended": "completed"}
    try:
        with no_collector():
            for row in range(ticks):
                if watch is not None:
                    watch(loop.ticks)
                plant.write_truth(log.truth[row])
                try:
                    loop.step(tip_refs[row], registered[row], trocars[row])
                except PlantError as error:
                    broken = error
                controller.note(row, log.kept)
                log.wrench[row], log.tau[row], log.tick_us[row] = loop.seen.force, loop.tau, loop.tick_us
                if loop.limited:
                    log.limited[row] = loop.limited
                log.done = row + 1
                if loop.stop_reason:
                    for name in log.kept.keys() & _STOPPED.keys():
                        log.kept[name][row] = _STOPPED[name]
                    if "stopped_at_s" not in found:
                        t = float(log.kept["t_s"][row])
                        found |= {"ended": f"stopped: {loop.stop_reason} (t = {t:.3f} s)", "stopped_at_s": t}
                    if loop.finished:
                        break
                if broken is not None:
                    found["ended"] = f"ran away at t = {log.kept['t_s'][row]:.3f} s"
                    break
    except BaseException:
        if rescue is not None and log.done:
            rescue(log.columns())
        raise
    found |= {"ticks": loop.ticks, "ticks_planned": ticks}
    found |= {"faults": controller.faults} if hasattr(controller, "faults") else {}
    if restarts := getattr(controller, "restarts", None):
        found["restarts"] = restarts
    if loop.warnings:
        found["warnings"] = [{**w, "first_s": begin_s + w["first_s"]} for w in loop.warnings]
    trace = Trace(log.columns(), {**found, **(meta or {})})
    if broken is not None:
        raise RunAway(f"{found['ended']}: {broken}", trace) from broken
    return trace
