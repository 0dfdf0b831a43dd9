"""The closed loop of plant, sensors, safety filter and controller."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any

import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import MocOptError, PlantError
from moc_opt.sim.faults import Faults
from moc_opt.sim.plant import DEFAULT_STOP, Plant, Stop
from moc_opt.sim.protocols import Filtered, LoggedController, TorqueController
from moc_opt.sim.record import Columns, Record, RunAway, TaskOffset
from moc_opt.sim.sensors import Measurement
from moc_opt.trace.trace import Trace

if TYPE_CHECKING:
    from moc_opt.control.safety_filter import SafetyFilter

AT_REST = 0.005  #: Below this speed, a joint counts as resting [rad/s, m/s].
LONGEST = 4  #: Longest duration of a stop, as a multiple of `Stop.seconds`.


class FilteredController(Filtered):
    """A controller with an optional safety filter. ``applied`` (n,) is the latest torque [Nm]."""

    def __init__(self, controller: TorqueController, safety_filter: SafetyFilter | None, applied: Array) -> None:
        self._controller, self._filter, self._applied = controller, safety_filter, applied

    def start(self, seen: Measurement, tip_ref: Array, trocar: Array) -> None:
        """Start controller and safety filter."""
        self._controller.start(seen.q, seen.v, tip_ref, trocar)
        if self._filter is not None:
            self._filter.start(seen.q, seen.v, seen.stamp)

    def tick(self, seen: Measurement, tip_ref: Array, trocar: Array) -> Array:
        """Return this period's torque (n,) [Nm]."""
        safety, controller, applied = self._filter, self._controller, self._applied
        if safety is None:
            return controller.tick(seen.q, seen.v, tip_ref, trocar)
        if not safety.reason:
            q, v = safety.check_measurement(seen.q, seen.v, seen.stamp, applied, seen.force, trocar)
        if not safety.reason:
            try:
                tau = controller.tick(q, v, tip_ref, trocar)
                state, tip = getattr(controller, "state", None), getattr(controller, "tip", None)
                tau = safety.limit_torque(tau, applied, q, v, tip_ref, state, tip)
                if safety.limited:
                    controller.set_applied_torque(tau)
            except (MocOptError, ArithmeticError, np.linalg.LinAlgError) as error:
                safety.request_stop(f"the controller failed: {error}")
        if safety.reason:
            tau = safety.stop_torque(applied)
        self._applied = tau
        return tau

    def set_applied_torque(self, tau: Array) -> None:
        """Take the torque (n,) [Nm] that was applied instead of the result of ``tick``."""
        self._applied = tau
        self._controller.set_applied_torque(tau)

    def brake_friction(self, seen: Measurement) -> Array | float:
        """Return the brakes' dry friction (n,) [Nm]."""
        return 0.0 if self._filter is None else self._filter.brake_friction(seen.force)

    stop_reason = property(lambda self: "" if self._filter is None else self._filter.reason)
    limited = property(lambda self: 0 if self._filter is None else self._filter.limited)
    warnings = property(lambda self: [] if self._filter is None else self._filter.warnings)


class ClosedLoop:
    """A plant, a controller and an optional safety filter, advanced one control period at a time.

    After a step, ``seen`` is the measurement that the controller received, ``tau`` (n,) the commanded torque [Nm],
    ``tick_us`` the computing time [us], and ``ticks`` the number of steps.
    """

    def __init__(
        self, plant: Plant, controller: TorqueController | Filtered, safety_filter: SafetyFilter | None,
        stop: Stop = DEFAULT_STOP, faults: Faults | None = None,
    ) -> None:  # fmt: skip
        self._plant, self._faults, self._damping = plant, faults, stop.damping
        self._watched, self._stopped_at = round(stop.seconds / plant.settings.period_s), -1
        self.seen, self.tau, self.tick_us, self.ticks = plant.measure(), plant.applied_torque, float("nan"), 0
        if not isinstance(controller, Filtered):
            controller = FilteredController(controller, safety_filter, self.tau)
        self.filtered: Filtered = controller

    def start(self, tip_ref: Array, registered: Array) -> None:
        """Start at the present measurement; arguments as for ``step``."""
        self.seen = self._plant.measure()
        self.filtered.start(self.seen, tip_ref, registered)

    def step(self, tip_ref: Array, registered: Array, trocar: Array | None = None) -> None:
        """Measure, compute the torque, and move the arm by one control period.

        Args:
            tip_ref: (3, 3) rows X_d [m], dX_d [m/s], ddX_d [m/s^2].
            registered: (2, 3) rows P_t [m], dP_t [m/s] of the registered trocar.
            trocar: (2, 3) rows P_t, dP_t of the true trocar; None: the tool is in no incision.

        Raises:
            PlantError: an argument is wrong, or the simulation of the plant diverged.
        """
        plant, seen = self._plant, self._plant.measure()
        if self._faults is not None:
            self._faults.act(plant, self.ticks)
            seen = self._faults.sense(seen, self.ticks)
        begin = perf_counter_ns()
        tau = self.filtered.tick(seen, tip_ref, registered)
        self.tick_us = (perf_counter_ns() - begin) * 1e-3
        self.seen, self.tau = seen, tau
        if self.filtered.stop_reason:
            if self._stopped_at < 0:
                self._stopped_at = self.ticks
            plant.brake(self._damping, self.filtered.brake_friction(seen))
        self.ticks += 1
        plant.step(tau, trocar)

    @property
    def finished(self) -> bool:
        """Whether a stop is over: the arm rests after `Stop.seconds`, or `LONGEST` times this duration has passed."""
        since = self.ticks - self._stopped_at if self._stopped_at >= 0 else 0
        return since > self._watched and bool(since > LONGEST * self._watched or np.abs(self._plant.v).max() < AT_REST)

    stop_reason = property(lambda self: self.filtered.stop_reason, doc="Why the arm is being stopped, or empty.")


@contextmanager
def no_collector() -> Iterator[None]:
    """Switch the garbage collector off."""
    enabled = gc.isenabled()
    gc.collect(1)
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def simulate(
    plant: Plant, controller: LoggedController, tip_refs: Array, trocars: Array, registered: Array, *,
    safety_filter: SafetyFilter | None = None, faults: Faults | None = None, stop: Stop = DEFAULT_STOP,
    offset: TaskOffset | None = None, watch: Callable[[int], None] | None = None,
    meta: Mapping[str, Any] | None = None, rescue: Callable[[Columns], None] | None = None,
) -> Trace:  # fmt: skip
    """Run the closed loop from the plant's present state, and record it.

    Args:
        tip_refs: (N, 3, 3) rows X_d, dX_d, ddX_d of every tick.
        trocars, registered: (N, 2, 3) rows P_t, dP_t of the true and of the registered trocar.
        safety_filter: checks the measurements and limits the torques; None: nothing is checked or limited.
        offset: see `TaskOffset`; None: zero.
        watch: called with the tick's number before each tick.
        meta: further entries of the trace's meta.
        rescue: called with the columns so far if an exception other than RunAway ends the loop.

    Returns:
        The trace. A row has a tick's torque, and the state at the tick's start.

    Raises:
        RunAway: the simulation of the plant diverged. The error has the trace.
    """
    record = Record(plant, controller, tip_refs, trocars, registered, offset or TaskOffset())
    loop = ClosedLoop(plant, controller, safety_filter, stop, faults)
    loop.start(tip_refs[0], registered[0])
    broken: PlantError | None = None
    try:
        with no_collector():
            for row, tip_ref in enumerate(tip_refs):
                if watch is not None:
                    watch(row)
                record.note_truth()
                try:
                    loop.step(tip_ref, registered[row], trocars[row])
                except PlantError as error:
                    broken = error
                record.note(loop.seen, loop.tau, loop.tick_us, loop.filtered)
                if broken is not None or loop.finished:
                    break
    except BaseException:
        if rescue is not None and record.done:
            rescue(record.columns())
        raise
    trace = record.trace(loop.filtered.warnings, meta or {}, ran_away=broken is not None)
    if broken is not None:
        raise RunAway(f"{trace.meta['ended']}: {broken}", trace) from broken
    return trace
