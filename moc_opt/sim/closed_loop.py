"""One tick of the closed loop: sensors, safety filter, controller, safety filter, arm.

Simulation, live page, operating procedure and benchmarks all step an arm by `ClosedLoop`. What stands between its
sensors and its drives is `Filtered`: a controller behind its safety filter, or the other end of a wire (``realtime``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from time import perf_counter_ns
from typing import Any

import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import MocOptError
from moc_opt.sim.faults import Faults
from moc_opt.sim.plant import Plant
from moc_opt.sim.protocols import SafetyFilter, TorqueController
from moc_opt.sim.sensors import Measurement


class Filtered(ABC):
    """From a measurement to a torque that may be applied: what stands between sensors and drives of a closed loop."""

    @property
    @abstractmethod
    def stop_reason(self) -> str:
        """Why the arm has to be stopped; empty while it has not."""

    @property
    @abstractmethod
    def limited(self) -> int:
        """Number of joints at which the last torque was changed on its way."""

    @property
    @abstractmethod
    def warnings(self) -> list[dict[str, Any]]:
        """What exceeded a warning level since the start, as JSON values."""

    @abstractmethod
    def start(self, seen: Measurement, tip_ref: Array, trocar: Array) -> None:
        """Prepare for a run that begins at this measurement."""

    @abstractmethod
    def tick(self, seen: Measurement, tip_ref: Array, trocar: Array) -> Array:
        """Return this period's torque (n,) [Nm], within its limits; that of a damped stop once one was requested."""

    @abstractmethod
    def brake_friction(self, seen: Measurement) -> Array | float:
        """Return the dry friction (n,) [Nm] that the brakes are to have in a stop."""


class FilteredController(Filtered):
    """A controller whose measurements and torques pass through a safety filter; without one, the controller alone.

    ``applied`` (n,) is the torque that was applied last [Nm].
    """

    def __init__(self, controller: TorqueController, safety_filter: SafetyFilter | None, applied: Array) -> None:
        self._controller, self._filter, self._applied = controller, safety_filter, applied
        self._shows_state, self._shows_tip = False, False

    def start(self, seen: Measurement, tip_ref: Array, trocar: Array) -> None:
        """Start controller and safety filter at the first measurement."""
        controller = self._controller
        controller.start(seen.q, seen.v, tip_ref, trocar)
        # Only now: before its start a property of the controller may raise AttributeError, which reads as its absence.
        self._shows_state, self._shows_tip = hasattr(controller, "state"), hasattr(controller, "tip")
        if self._filter is not None:
            self._filter.start(seen.q, seen.v, seen.stamp)

    def tick(self, seen: Measurement, tip_ref: Array, trocar: Array) -> Array:
        """Return this period's torque (n,) [Nm], within its limits; that of a damped stop once one was requested."""
        safety, controller, applied = self._filter, self._controller, self._applied
        if safety is None:
            return controller.tick(seen.q, seen.v, tip_ref, trocar)
        if not safety.reason:
            q, v = safety.check_measurement(seen.q, seen.v, seen.stamp, applied, seen.force, trocar)
        if not safety.reason:
            try:
                tau = controller.tick(q, v, tip_ref, trocar)
                tau = safety.limit_torque(tau, applied, q, v, *self._shown(tip_ref))
            except (MocOptError, ArithmeticError, np.linalg.LinAlgError) as error:
                safety.request_stop(f"the controller failed: {error}")
            else:
                if safety.limited:
                    controller.set_applied_torque(tau)
        if safety.reason:
            tau = safety.stop_torque(applied)
        self._applied = tau
        return tau

    def _shown(self, tip_ref: Array) -> tuple[Array | None, Any, Array | None]:
        controller: Any = self._controller
        if self._shows_state:
            return tip_ref if self._shows_tip else None, controller.state, None
        return (tip_ref, None, controller.tip) if self._shows_tip else (None, None, None)

    def set_applied_torque(self, tau: Array) -> None:
        """Correct the torque (n,) [Nm] that was applied last, where it was not the one that ``tick`` returned."""
        self._applied = tau
        self._controller.set_applied_torque(tau)

    @property
    def stop_reason(self) -> str:
        """Why the arm has to be stopped; empty while it has not."""
        return "" if self._filter is None else self._filter.reason

    @property
    def limited(self) -> int:
        """Number of joints at which the safety filter changed the last torque."""
        return 0 if self._filter is None else self._filter.limited

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """Figures above their warning level since the start, as JSON values."""
        return [] if self._filter is None else self._filter.warnings

    def brake_friction(self, seen: Measurement) -> Array | float:
        """Return the dry friction (n,) [Nm] that the brakes are to have in a stop."""
        return 0.0 if self._filter is None else self._filter.brake_friction(seen.force)


@dataclass(frozen=True)
class Stop:
    """How the arm is stopped: damping of the drives [Nm s/rad], and how long the stop is simulated at least [s].

    It goes on until the arm is at rest, at most ``LONGEST`` times as long: with open brakes the tissue may push the
    arm for a while.
    """

    damping: float = 15.0
    seconds: float = 0.5


DEFAULT_STOP = Stop()
AT_REST = 0.005  #: Largest speed of a joint at rest [rad/s], [m/s] where it slides.
LONGEST = 4


class ClosedLoop:
    """Plant, controller and safety filter (None: none), advanced one control period at a time.

    A controller that is ``Filtered`` already has its safety filter with it. ``stop`` says how the arm is stopped once
    the safety filter has requested it; ``faults`` disturb sensors and arm.

    Attributes:
        seen: the last measurement, as it arrived.
        tau: (n,) the last torque that was applied [Nm].
        tick_us: time that safety filter and controller took for it [us].
        ticks: number of steps so far.
    """

    def __init__(
        self, plant: Plant, controller: TorqueController | Filtered, safety_filter: SafetyFilter | None,
        stop: Stop = DEFAULT_STOP, faults: Faults | None = None,
    ) -> None:  # fmt: skip
        self._plant, self._faults, self._damping = plant, faults, stop.damping
        self._watched = round(stop.seconds / plant.settings.period_s)
        self.tau, self.tick_us = np.array(plant.applied_torque), float("nan")
        self._filtered: Filtered = (
            controller if isinstance(controller, Filtered) else FilteredController(controller, safety_filter, self.tau)
        )
        self.seen, self.ticks, self._stopped_at = plant.measure(), 0, -1

    def start(self, tip_ref: Array, trocar: Array) -> None:
        """Start controller and safety filter at the plant's present measurement; arguments as for ``step``."""
        self.seen = self._plant.measure()
        self._filtered.start(self.seen, tip_ref, trocar)

    def step(self, tip_ref: Array, registered: Array, trocar: Array | None = None) -> None:
        """Measure, check, compute, limit, and move the arm by one control period.

        Args:
            tip_ref: (3, 3) rows X_d [m], dX_d [m/s], ddX_d [m/s^2].
            registered: (2, 3) rows P_t [m], dP_t [m/s] of the trocar, as registered.
            trocar: (2, 3) the true one; None: the arm is in no incision.

        Raises:
            PlantError: the plant cannot go on; measurement and torque of this step are there all the same.
        """
        seen = self._plant.measure()
        if self._faults is not None:
            self._faults.act(self._plant, self.ticks)
            seen = self._faults.sense(seen, self.ticks)
        begin = perf_counter_ns()
        tau = self._filtered.tick(seen, tip_ref, registered)
        self.tick_us = (perf_counter_ns() - begin) * 1e-3
        self.seen, self.tau = seen, tau
        if self._filtered.stop_reason:
            self._stopped_at = self.ticks if self._stopped_at < 0 else self._stopped_at
            self._plant.brake(self._damping, self._filtered.brake_friction(seen))
        self.ticks += 1
        self._plant.step(tau, trocar)

    @property
    def stop_reason(self) -> str:
        """Why the arm is being stopped; empty while it is not."""
        return self._filtered.stop_reason

    @property
    def finished(self) -> bool:
        """Whether the arm has been stopped, and simulated for as long as ``Stop`` says."""
        if not 0 <= self._stopped_at < self.ticks - self._watched:
            return False
        over = self.ticks - self._stopped_at > LONGEST * self._watched
        return over or bool(np.abs(self._plant.v).max() < AT_REST)

    @property
    def limited(self) -> int:
        """Number of joints at which the safety filter changed the last torque."""
        return self._filtered.limited

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """Figures above their warning level since the start, as JSON values."""
        return self._filtered.warnings
