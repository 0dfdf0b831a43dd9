"""The interfaces of a controller and of its safety filter."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Protocol

from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.sim.sensors import Measurement


class TorqueController(Protocol):
    """Computes a torque from a measurement.

    If the controller has an attribute ``tip`` (3,) [m] or ``state`` (`RobotState`), the safety filter checks the tip
    error.
    """

    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        """Prepare for a run; arguments as for ``tick``."""

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Compute the torque (n,) [Nm] of this period; arguments as for `Controller.tick`."""

    def set_applied_torque(self, tau: Array) -> None:
        """Receive the torque (n,) [Nm] that was applied instead of the result of ``tick``."""


class LoggedController(TorqueController, Protocol):
    """A controller that writes columns of the trace."""

    def columns(self, ticks: int) -> dict[str, NDArray[Any]]:
        """Create the columns that ``note`` fills, with ``ticks`` rows."""

    def note(self, row: int, columns: Mapping[str, NDArray[Any]]) -> None:
        """Write the last tick's values into a row of ``columns``."""


class Filtered(ABC):
    """A controller with its safety filter, in this process or in another."""

    stop_reason: Any  #: Why the arm has to be stopped; empty if no stop is needed.
    limited: Any  #: Number of joints whose torque was changed in the last tick.
    warnings: Any  #: Quantities that exceeded a warning level, as JSON values.

    @abstractmethod
    def start(self, seen: Measurement, tip_ref: Array, trocar: Array) -> None:
        """Prepare for a run."""

    @abstractmethod
    def tick(self, seen: Measurement, tip_ref: Array, trocar: Array) -> Array:
        """Return this period's torque (n,) [Nm], within limits."""

    @abstractmethod
    def brake_friction(self, seen: Measurement) -> Array | float:
        """Return the brakes' dry friction (n,) [Nm]."""
