"""A controller behind its safety filter: from a measurement to the torque that may be applied."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np

from moc_opt.errors import MocOptError
from moc_opt.numerics.arrays import Array
from moc_opt.sim.protocols import SafetyFilter, TorqueController
from moc_opt.sim.sensors import Measurement


class Begun(NamedTuple):
    """What compiled steps have done already of the period that Python goes on with."""

    before: int | None = None
    """what ``check_measurement`` found"""
    asked: Array | None = None
    """(n,) the controller's torque, limits applied [Nm]"""
    after: int | None = None
    """what ``limit_torque`` found"""
    moved: int | None = None
    """what came of the plant's period"""


NOTHING = Begun()


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

    Args:
        controller: computes the torque.
        safety_filter: checks measurements and limits torques; None: neither.
        applied: (n,) torque that was applied last [Nm].
    """

    def __init__(self, controller: TorqueController, safety_filter: SafetyFilter | None, applied: Array) -> None:
        self._controller, self._filter, self._applied = controller, safety_filter, applied
        self._shows_state, self._shows_tip, self._begun = False, False, NOTHING

    def start(self, seen: Measurement, tip_ref: Array, trocar: Array) -> None:
        """Start controller and safety filter at the first measurement."""
        controller = self._controller
        controller.start(seen.q, seen.v, tip_ref, trocar)
        # Only now: before its start a property of the controller may raise AttributeError, which reads as its absence.
        self._shows_state, self._shows_tip = hasattr(controller, "state"), hasattr(controller, "tip")
        if self._filter is not None:
            self._filter.start(seen.q, seen.v, seen.stamp)

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
        """What exceeded a warning level since the start, as JSON values."""
        return [] if self._filter is None else self._filter.warnings

    def brake_friction(self, seen: Measurement) -> Array | float:
        """Return the dry friction (n,) [Nm] that the brakes are to have in a stop."""
        return 0.0 if self._filter is None else self._filter.brake_friction(seen.force)

    def tick(self, seen: Measurement, tip_ref: Array, trocar: Array) -> Array:
        """Return this period's torque (n,) [Nm], within its limits; that of a damped stop once one was requested."""
        safety, controller, applied, begun = self._filter, self._controller, self._applied, self._begun
        self._begun = NOTHING
        if safety is None:
            return controller.tick(seen.q, seen.v, tip_ref, trocar)
        if not safety.reason:
            q, v = safety.check_measurement(seen.q, seen.v, seen.stamp, applied, seen.force, trocar, begun.before)
        if not safety.reason:
            try:
                asked = controller.tick(q, v, tip_ref, trocar) if begun.asked is None else begun.asked
                tau = safety.limit_torque(asked, applied, q, v, *self._seen(tip_ref), begun.after)
            except (MocOptError, ArithmeticError, np.linalg.LinAlgError) as error:
                safety.request_stop(f"the controller failed: {error}")
            else:
                if safety.limited:
                    controller.set_applied_torque(tau)
        if safety.reason:
            tau = safety.stop_torque(applied)
        self._applied = tau
        return tau

    def took(self, tau: Array, begun: Begun) -> None:
        """Go on after compiled steps: the torque (n,) [Nm] that they sent last, and what is done of the next tick."""
        self._applied, self._begun = tau, begun

    def _seen(self, tip_ref: Array) -> tuple[Array | None, Any, Array | None]:
        """Return the tip's reference, and the state or the tip of the tick, if the controller provides one."""
        controller: Any = self._controller
        if self._shows_state:
            return tip_ref if self._shows_tip else None, controller.state, None
        return (tip_ref, None, controller.tip) if self._shows_tip else (None, None, None)
