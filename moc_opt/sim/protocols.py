"""The interfaces of the closed loop: a controller, and a controller behind its safety filter."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Protocol

from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.sim.sensors import Measurement


class TorqueController(Protocol):
    """Computes a torque from a measurement.

    The safety filter checks the tip error if the controller has ``tip`` (3,) [m] or ``state`` (a `RobotState`) of its
    last tick. Given a ``state``, the filter need not compute the model's terms again.
    """

    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        """Reset, and prepare for a run that begins at this measurement; arguments as for ``tick``."""

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Compute the torque (n,) [Nm] of this period.

        Args:
            q, v: (n,) as measured [rad], [rad/s].
            tip_ref: (3, 3) rows X_d [m], dX_d [m/s], ddX_d [m/s^2].
            trocar: (2, 3) rows P_t [m], dP_t [m/s], as registered.
        """

    def set_applied_torque(self, tau: Array) -> None:
        """Take the torque (n,) [Nm] that was applied, if the safety filter changed the one that ``tick`` returned."""


class LoggedController(TorqueController, Protocol):
    """A controller that also writes columns of its own into the trace."""

    def columns(self, ticks: int) -> dict[str, NDArray[Any]]:
        """Create the columns that ``note`` fills, ``ticks`` rows each."""

    def note(self, row: int, columns: Mapping[str, NDArray[Any]]) -> None:
        """Write the last tick's values into a row of ``columns``."""


class Filtered(ABC):
    """Turns a measurement into a torque that may be applied, here or at the other end of a wire (``realtime``)."""

    stop_reason: Any  #: Why the arm has to be stopped; empty while it need not be.
    limited: Any  #: Number of joints whose last torque differs from the torque that the controller computed.
    warnings: Any  #: Which figures exceeded a warning level since the start, as JSON values.

    @abstractmethod
    def start(self, seen: Measurement, tip_ref: Array, trocar: Array) -> None:
        """Prepare for a run that begins at this measurement."""

    @abstractmethod
    def tick(self, seen: Measurement, tip_ref: Array, trocar: Array) -> Array:
        """Return this period's torque (n,) [Nm], within limits; once a stop is requested, a damped stop's torque."""

    @abstractmethod
    def brake_friction(self, seen: Measurement) -> Array | float:
        """Return the dry friction (n,) [Nm] that the brakes are to have in a stop."""
