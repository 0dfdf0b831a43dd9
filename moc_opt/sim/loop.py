"""The closed loop: measure, compute, act, and write down what really happened."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter_ns
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import PlantError
from moc_opt.sim.faults import Faults
from moc_opt.sim.plant import Plant
from moc_opt.sim.safe import Brain, Safe, Watchdog
from moc_opt.tasks.trocar import shaft_distance
from moc_opt.trace import Trace

Array = NDArray[np.float64]


class RunAway(PlantError):
    """The plant could not go on; ``trace`` holds the rows so far."""

    def __init__(self, message: str, trace: Trace) -> None:
        super().__init__(message)
        self.trace = trace


class Touched(NamedTuple):
    """True minus believed place of the two points that the arm registered with its own tip, (3,) each [m].

    The robot's own frame lies off the true one by calibration error, encoder bias and bending joints. What it touches
    it registers in its own frame, so that the offset at that point is of no consequence to it; only how the offset
    changes on the way from there is.
    """

    tip: Array
    """Where the path begins."""
    trocar: Array
    """Where the shaft enters, the error of the registration left out."""

    @classmethod
    def nothing(cls) -> Touched:
        """The robot's frame is the true one."""
        return cls(np.zeros(3), np.zeros(3))


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
    """In a damped stop nobody is asked: the third level's last words are not those of this tick."""
    for name, value in _STOPPED.items():
        if name in columns:
            columns[name][row] = value


_STOPPED = {
    "status": "none", "fault": "stopped", "x_rad_per_s": np.nan, "applied_x_rad_per_s": np.nan,
    "dual": np.nan, "iterations": 0, "solve_us": np.nan,
}  # fmt: skip


def simulate(
    plant: Plant,
    brain: Brain,
    tip_refs: Array,
    trocars: Array,
    registered: Array,
    *,
    guard: Watchdog | None = None,
    faults: Faults | None = None,
    stop: Stop = Stop(),
    touched: Touched | None = None,
    watch: Callable[[int], None] | None = None,
    meta: Mapping[str, Any] | None = None,
) -> Trace:
    """Run the loop from the plant's present state.

    Args:
        plant: already reset to the start.
        brain: the controller.
        tip_refs: (N, 3, 3) rows X_d, dX_d, ddX_d of every tick.
        trocars: (N, 2, 3) rows P_t, dP_t: where the trocar really is.
        registered: (N, 2, 3) where the controller believes it to be.
        guard: holds limits and judges measurements; None: neither.
        faults: what goes wrong around the arm; None: nothing.
        stop: how the arm is stopped when the guard has lost it.
        touched: how the robot's frame lies in the true one, where `tip_refs` and `registered` were taken with its
            own tip; None: as the true one.
        watch: called with the tick's number before each tick (progress, events).
        meta: goes into the trace.

    Returns:
        One row per tick: the state at its start, and the torque sent then. ``meta["ended"]`` is "completed", or
        "stopped: ..." with the rows so far, and ``meta["stopped_at_s"]`` says when. ``meta["ticks"]`` of
        ``meta["ticks_planned"]`` (N) are there; ``meta["warnings"]``, where there are any, is what the guard warned of.
        ``meta["faults"]`` is what a brain that counts them says of refused answers: label -> count, first_at_s, first
        (in words).

    Raises:
        RunAway: the plant cannot go on; the error holds the trace so far.
    """
    ticks, n = len(tip_refs), plant.data.n
    touched = Touched.nothing() if touched is None else touched
    kept: dict[str, NDArray[Any]] = {
        "t_s": plant.time + plant.settings.period_s * np.arange(ticks),
        "tip_ref_m": np.array(tip_refs[:, 0]), "trocar_m": np.array(trocars[:, 0]),
        "trocar_registered_m": registered[:, 0] + touched.trocar, "tau_Nm": np.empty((ticks, n)),
        "tick_us": np.empty(ticks), "limited": np.zeros(ticks, dtype=np.int8), **brain.columns(ticks),
    }  # fmt: skip
    truth, wrench = np.empty((ticks, 2 * n + 9)), np.empty((ticks, 6))
    torques, tick_us, limited = kept["tau_Nm"], kept["tick_us"], kept["limited"]
    safe = Safe(brain, guard, np.array(plant.applied_torque))
    seen = plant.measure()
    safe.start(seen, tip_refs[0], registered[0])
    ended, stop_at, broken = "completed", ticks - 1, None
    stopped: dict[str, float] = {}
    with no_collector():
        for k in range(ticks):
            if watch is not None:
                watch(k)
            seen = plant.measure()
            if faults is not None:
                faults.act(plant, k)
                seen = faults.sense(seen, k)
            begin = perf_counter_ns()
            tau = safe.tick(seen, tip_refs[k], registered[k])
            tick_us[k] = (perf_counter_ns() - begin) * 1e-3
            if safe.lost and ended == "completed":
                ended = f"stopped: {safe.lost} (t = {kept['t_s'][k]:.3f} s)"
                stop_at = min(stop_at, k + round(stop.seconds / plant.settings.period_s))
                stopped["stopped_at_s"] = float(kept["t_s"][k])
            brain.note(k, kept)
            if safe.lost:
                plant.brake(stop.damping, safe.hold(seen))
                _blank(kept, k)
            plant.write_truth(truth[k])
            wrench[k], torques[k], limited[k] = seen.force, tau, safe.limited
            try:
                plant.step(tau, trocars[k])
            except PlantError as error:
                ended, stop_at, broken = f"ran away at t = {kept['t_s'][k]:.3f} s", k, error
            if k == stop_at:
                break
    places = {"q_rad": n, "v_rad_per_s": n, "tip_m": 3, "wrist_m": 3, "trocar_force_N": 3}
    kept |= dict(zip(places, np.split(truth, np.cumsum([*places.values()])[:-1], axis=1), strict=True))
    kept["force_N"], kept["torque_Nm"] = wrench[:, :3], wrench[:, 3:]
    kept = {name: column[: stop_at + 1] for name, column in kept.items()}
    kept["tip_error_m"] = np.linalg.norm(kept["tip_ref_m"] - kept["tip_m"], axis=1)
    kept["tip_error_registered_m"] = np.linalg.norm(kept["tip_ref_m"] + touched.tip - kept["tip_m"], axis=1)
    kept["rcm_error_m"] = shaft_distance(kept["tip_m"], kept["wrist_m"], kept["trocar_m"])
    registered_m = kept["trocar_registered_m"]
    kept["rcm_error_registered_m"] = shaft_distance(kept["tip_m"], kept["wrist_m"], registered_m)
    found: dict[str, Any] = {"period_s": plant.settings.period_s, "ended": ended, **stopped}
    found |= {"ticks": stop_at + 1, "ticks_planned": ticks}
    found |= {"faults": brain.faults} if hasattr(brain, "faults") else {}
    if safe.warnings:
        begin_s = float(kept["t_s"][0])
        found["warnings"] = [{**w, "first_s": begin_s + w["first_s"]} for w in safe.warnings]
    trace = Trace(kept, {**found, **(meta or {})})
    if broken is not None:
        raise RunAway(f"{ended}: {broken}", trace) from broken
    return trace
