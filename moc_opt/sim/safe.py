"""A controller and its guard, as every closed loop calls them: simulation, procedure and live page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import MocOptError
from moc_opt.sim.sensors import Measurement

Array = NDArray[np.float64]


class TorqueController(Protocol):
    """What a guarded loop asks of a controller: torque from measurements."""

    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        """Get ready at the first measurement."""
        ...

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Torque (n,) [Nm] for the measured q (n,) [rad] and v (n,) [rad/s]."""
        ...

    def set_applied_torque(self, tau: Array) -> None:
        """Take note of the torque (n,) [Nm] that really went out, where the guard changed it."""
        ...


class LoggedController(TorqueController, Protocol):
    """What a recorded loop asks of a controller beside its torque: what to write down about the third level."""

    def note(self, row: int, columns: Mapping[str, NDArray[Any]]) -> None:
        """Write this tick's own columns."""
        ...

    def columns(self, ticks: int) -> dict[str, NDArray[Any]]:
        """Empty arrays for the columns that ``note`` fills."""
        ...


class SafetyFilterProtocol(Protocol):
    """What the loop asks of a guard (``moc_opt.control.safety_filter.SafetyFilter``)."""

    @property
    def lost(self) -> bool:
        """Whether it is time to stop: ``reason`` says why."""
        ...

    def request_stop(self, reason: str) -> None:
        """Order the stop."""
        ...

    def follow(self, tip: Array, tip_ref: Array) -> None:
        """Take note of where the controller sees the tip (3,), and where it should be, (3, 3) rows X_d, dX_d, ddX_d."""
        ...

    def feel(self, q: Array, trocar: Array, wrench: Array) -> None:
        """Take note of the incision: believed q (n,), registered trocar (2, 3), and wrench at the tool's mount (6,)."""
        ...

    def rest(self, before: Array) -> Array:
        """The torque (n,) [Nm] of a damped stop, ``before`` being the last one sent."""
        ...

    def hold(self, wrench: Array) -> Array:
        """Dry friction (n,) [Nm] of the brakes in a stop, where the tool exerts ``wrench`` (6,) on its mount."""
        ...

    def start(self, q: Array, v: Array, stamp: int = 0) -> None:
        """Believe the first measurement."""
        ...

    def believe(
        self, q: Array, v: Array, stamp: int | None = None, applied: Array | None = None, wrench: Array | None = None
    ) -> tuple[Array, Array]:
        """The measurement, or what stands in for one that cannot be true, is old, or repeats itself."""
        ...

    def weigh(self, q: Array, v: Array, state: Any, applied: Array) -> None:
        """Take note of the motion that the torque before (q, v) should have made; None: of that state."""
        ...

    def limit(self, tau: Array, before: Array, q: Array, v: Array) -> Array:
        """The torque within its limits; ``limited`` says whether they acted."""
        ...

    limited: int
    reason: str

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """What was above a warning level since the start, as JSON values."""
        ...


class Safe:
    """A controller whose measurements and torques pass through its guard; without a guard, the controller alone.

    Args:
        controller: the controller.
        safety_filter: holds limits and judges measurements; None: neither.
        applied: (n,) the last torque that went out [Nm].
    """

    def __init__(
        self, controller: TorqueController, safety_filter: SafetyFilterProtocol | None, applied: Array
    ) -> None:
        self._controller, self._filter, self._applied = controller, safety_filter, applied
        self._sees_state = hasattr(controller, "state")  # and the model's state at the last measurement
        self._sees_tip = hasattr(controller, "tip")  # a controller may say where it sees the tip (3,) [m]

    def start(self, seen: Measurement, tip_ref: Array, trocar: Array) -> None:
        """Take the first measurement as it is, and start controller and guard at it."""
        self._controller.start(seen.q, seen.v, tip_ref, trocar)
        if self._filter is not None:
            self._filter.start(seen.q, seen.v, seen.stamp)

    @property
    def lost(self) -> str:
        """Why the arm has to be stopped; empty while it has not."""
        return "" if self._filter is None else self._filter.reason

    @property
    def limited(self) -> int:
        """Joints at which the guard changed the last torque."""
        return 0 if self._filter is None else self._filter.limited

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """See ``SafetyFilterProtocol``."""
        return [] if self._filter is None else self._filter.warnings

    def hold(self, seen: Measurement) -> Array | float:
        """Dry friction (n,) [Nm] that the brakes are to have in a stop."""
        return 0.0 if self._filter is None else self._filter.hold(seen.force)

    def tick(self, seen: Measurement, tip_ref: Array, trocar: Array) -> Array:
        """Return this period's torque (n,) [Nm], within its limits; that of a damped stop once the arm is lost."""
        guard = self._filter
        if guard is None:
            return self._controller.tick(seen.q, seen.v, tip_ref, trocar)
        if not guard.lost:
            q, v = guard.believe(seen.q, seen.v, seen.stamp, self._applied, seen.force)
            guard.feel(q, trocar, seen.force)
        if not guard.lost:
            try:
                asked = self._controller.tick(q, v, tip_ref, trocar)
                if self._sees_tip:
                    guard.follow(self._controller.tip, tip_ref)  # type: ignore[attr-defined]
                state = self._controller.state if self._sees_state else None  # type: ignore[attr-defined]
                guard.weigh(q, v, state, self._applied)
            except (MocOptError, ArithmeticError, np.linalg.LinAlgError) as error:
                guard.request_stop(f"the controller failed: {error}")
            else:
                tau = guard.limit(asked, self._applied, q, v)
                if guard.limited:
                    self._controller.set_applied_torque(tau)
        if guard.lost:
            tau = guard.rest(self._applied)
        self._applied = tau
        return tau
