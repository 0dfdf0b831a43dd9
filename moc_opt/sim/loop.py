"""The closed loop: measure, compute, act, and write down what really happened."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter_ns
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import PlantError
from moc_opt.sim.faults import Faults
from moc_opt.sim.log import Log, Sink, TaskOffset, Trajectories, Trajectory
from moc_opt.sim.plant import Plant
from moc_opt.sim.safe import LoggedController, Safe, SafetyFilterProtocol
from moc_opt.trace.trace import Trace

BLOCK = 5000
"""Ticks that are kept in memory where a sink takes them."""


class RunAway(PlantError):
    """The plant could not go on; ``trace`` holds the rows so far."""

    def __init__(self, message: str, trace: Trace) -> None:
        super().__init__(message)
        self.trace = trace


@dataclass(frozen=True)
class Stop:
    """How a run is broken off: damping of the drives [Nm s/rad], and how long it is watched [s]."""

    damping: float = 15.0
    seconds: float = 0.5


@contextmanager
def no_collector() -> Iterator[None]:
    """No garbage-collection pause inside a real-time loop.

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
    """Clear the third level's columns of a damped stop: no solver runs, and the last answer is not this tick's."""
    for name, value in _STOPPED.items():
        if name in columns:
            columns[name][row] = value


_STOPPED = {
    "status": "none", "fault": "stopped", "x_rad_per_s": np.nan, "applied_x_rad_per_s": np.nan,
    "dual": np.nan, "iterations": 0, "solve_us": np.nan,
}  # fmt: skip


def simulate(
    plant: Plant,
    controller: LoggedController,
    tip_refs: Trajectory,
    trocars: Trajectory,
    registered: Trajectory,
    *,
    safety_filter: SafetyFilterProtocol | None = None,
    faults: Faults | None = None,
    stop: Stop = Stop(),
    offset: TaskOffset | None = None,
    watch: Callable[[int], None] | None = None,
    meta: Mapping[str, Any] | None = None,
    sink: Sink | None = None,
    block: int = BLOCK,
) -> Trace:
    """Run the loop from the plant's present state.

    Args:
        plant: already reset to the start.
        controller: the controller.
        tip_refs: (N, 3, 3) rows X_d, dX_d, ddX_d of every tick.
        trocars: (N, 2, 3) rows P_t, dP_t: where the trocar really is.
        registered: (N, 2, 3) where the controller believes it to be.
        safety_filter: holds limits and judges measurements; None: neither.
        faults: what goes wrong around the arm; None: nothing.
        stop: how the arm is stopped when the safety filter has lost it.
        offset: how the robot's frame lies in the true one, where `tip_refs` and `registered` were taken with its
            own tip; None: as the true one.
        watch: called with the tick's number before each tick (progress, events).
        meta: goes into the trace.
        sink: takes the rows, ``block`` ticks at a time and what there is when the loop ends, in whatever way; the
            trace that is returned then has no columns. None: all rows stay in memory.
        block: see ``sink``.

    Returns:
        One row per tick: the state at its start, and the torque sent then. ``meta["ended"]`` is "completed", or
        "stopped: ..." with the rows so far, and ``meta["stopped_at_s"]`` says when. ``meta["ticks"]`` of
        ``meta["ticks_planned"]`` (N) are there; ``meta["warnings"]``, where there are any, are the safety
        filter's. ``meta["faults"]``, of a controller that counts them, are its refused answers: label -> count,
        first_at_s, first (in words).

    Raises:
        RunAway: the plant cannot go on; the error holds the trace so far.
    """
    ticks, offset = len(tip_refs), TaskOffset.nothing() if offset is None else offset
    log = Log(plant, controller, Trajectories(tip_refs, trocars, registered), offset, sink, block)
    now = log.block
    safe = Safe(controller, safety_filter, np.array(plant.applied_torque))
    seen = plant.measure()
    safe.start(seen, now.tip_refs[0], now.registered[0])
    begin_s, ended, stop_at, broken = float(now.kept["t_s"][0]), "completed", ticks - 1, None
    stopped: dict[str, float] = {}
    try:
        with no_collector():
            for k in range(ticks):
                if watch is not None:
                    watch(k)
                now = log.at(k)
                row, kept = k - now.first, now.kept
                tip_ref, believed = now.tip_refs[row], now.registered[row]
                seen = plant.measure()
                if faults is not None:
                    faults.act(plant, k)
                    seen = faults.sense(seen, k)
                begin = perf_counter_ns()
                tau = safe.tick(seen, tip_ref, believed)
                kept["tick_us"][row] = (perf_counter_ns() - begin) * 1e-3
                if safe.lost and ended == "completed":
                    ended = f"stopped: {safe.lost} (t = {kept['t_s'][row]:.3f} s)"
                    stop_at = min(stop_at, k + round(stop.seconds / plant.settings.period_s))
                    stopped["stopped_at_s"] = float(kept["t_s"][row])
                controller.note(row, kept)
                if safe.lost:
                    plant.brake(stop.damping, safe.hold(seen))
                    _blank(kept, row)
                plant.write_truth(now.truth[row])
                now.wrench[row], kept["tau_Nm"][row], kept["limited"][row] = seen.force, tau, safe.limited
                now.done = row + 1
                try:
                    plant.step(tau, now.trocars[row])
                except PlantError as error:
                    ended, stop_at, broken = f"ran away at t = {kept['t_s'][row]:.3f} s", k, error
                if k == stop_at:
                    break
    except BaseException:
        log.close()  # what was measured is not lost, whatever ends the loop
        raise
    columns = log.close()
    found: dict[str, Any] = {"period_s": plant.settings.period_s, "ended": ended, **stopped}
    found |= {"ticks": stop_at + 1, "ticks_planned": ticks}
    found |= {"faults": controller.faults} if hasattr(controller, "faults") else {}
    if safe.warnings:
        found["warnings"] = [{**w, "first_s": begin_s + w["first_s"]} for w in safe.warnings]
    trace = Trace(columns, {**found, **(meta or {})})
    if broken is not None:
        raise RunAway(f"{ended}: {broken}", trace) from broken
    return trace
