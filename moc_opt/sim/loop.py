"""The closed loop: measure, compute, act, and write down what really happened."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from time import perf_counter_ns
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from moc_opt.sim.plant import Plant
from moc_opt.tasks.trocar import shaft_distance
from moc_opt.trace import Trace

Array = NDArray[np.float64]


class Brain(Protocol):
    """What the loop asks of a controller: a torque, and what to write down about the third level."""

    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        """Get ready at the first measurement."""
        ...

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Torque (n,) [Nm] for the measured q (n,) [rad] and v (n,) [rad/s]."""
        ...

    def note(self, row: int, columns: Mapping[str, NDArray[Any]]) -> None:
        """Write this tick's own columns."""
        ...

    def columns(self, ticks: int) -> dict[str, NDArray[Any]]:
        """Empty arrays for the columns that ``note`` fills."""
        ...


@contextmanager
def no_collector() -> Iterator[None]:
    """No garbage-collection pause inside a real-time loop; what was allocated before is left alone."""
    enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def simulate(
    plant: Plant,
    brain: Brain,
    tip_refs: Array,
    trocars: Array,
    registered: Array,
    *,
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
        watch: called with the tick's number before each tick (progress, events).
        meta: goes into the trace.

    Returns:
        One row per tick: the state at its start, and the torque asked for then.
    """
    ticks, n = len(tip_refs), plant.data.n
    kept: dict[str, NDArray[Any]] = {
        "t_s": plant.time + plant.settings.period_s * np.arange(ticks),
        "q_rad": np.empty((ticks, n)), "v_rad_per_s": np.empty((ticks, n)), "tau_Nm": np.empty((ticks, n)),
        "tip_m": np.empty((ticks, 3)), "tip_ref_m": np.array(tip_refs[:, 0]), "wrist_m": np.empty((ticks, 3)),
        "trocar_m": np.array(trocars[:, 0]), "trocar_registered_m": np.array(registered[:, 0]),
        "trocar_force_N": np.empty((ticks, 3)), "force_N": np.empty((ticks, 3)), "torque_Nm": np.empty((ticks, 3)),
        "tick_us": np.empty(ticks), **brain.columns(ticks),
    }  # fmt: skip
    seen = plant.measure()
    brain.start(seen.q, seen.v, tip_refs[0], registered[0])
    with no_collector():
        for k in range(ticks):
            if watch is not None:
                watch(k)
            seen = plant.measure()
            begin = perf_counter_ns()
            tau = brain.tick(seen.q, seen.v, tip_refs[k], registered[k])
            kept["tick_us"][k] = (perf_counter_ns() - begin) * 1e-3
            brain.note(k, kept)
            kept["q_rad"][k], kept["v_rad_per_s"][k] = plant.q, plant.v
            kept["tip_m"][k], kept["wrist_m"][k] = plant.tip, plant.wrist
            kept["trocar_force_N"][k] = plant.trocar_force
            kept["force_N"][k], kept["torque_Nm"][k] = seen.force[:3], seen.force[3:]
            kept["tau_Nm"][k] = tau
            plant.step(tau, trocars[k])
    kept["tip_error_m"] = np.linalg.norm(kept["tip_ref_m"] - kept["tip_m"], axis=1)
    kept["rcm_error_m"] = shaft_distance(kept["tip_m"], kept["wrist_m"], kept["trocar_m"])
    return Trace(kept, {"period_s": plant.settings.period_s, **(meta or {})})
