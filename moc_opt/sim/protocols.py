"""The closed loop's protocols of controllers and of a safety filter; sim imports neither."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from numpy.typing import NDArray

from moc_opt.arrays import Array


class TorqueController(Protocol):
    """Computes a torque from a measurement.

    Where it has ``tip`` (3,) [m], the tip of its last tick, its tip error is checked; where it has ``state``, the
    model's state of that tick, the safety filter does not compute it again.
    """

    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        """Reset, and prepare for a run that begins at this measurement."""

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Compute the torque (n,) [Nm] for the measured q (n,) [rad] and v (n,) [rad/s]."""

    def set_applied_torque(self, tau: Array) -> None:
        """Replace the last torque by the one (n,) [Nm] that was applied, where the safety filter changed it."""


class LoggedController(TorqueController, Protocol):
    """A controller that also writes columns of its own into the trace."""

    def note(self, row: int, columns: Mapping[str, NDArray[Any]]) -> None:
        """Write the last tick's values into a row of ``columns``."""

    def columns(self, ticks: int) -> dict[str, NDArray[Any]]:
        """Create the columns that ``note`` fills, ``ticks`` rows each."""


class SafetyFilter(Protocol):
    """Checks measurements and limits torques; ``moc_opt.control.safety_filter.SafetyFilter`` says how."""

    limited: int
    reason: str

    @property
    def stopped(self) -> bool:
        """Whether a stop was requested; ``reason`` says why."""

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """Figures above their warning level since the start, as JSON values."""

    def start(self, q: Array, v: Array, stamp: int = 0) -> None:
        """Begin at the first measurement."""

    def request_stop(self, reason: str) -> None:
        """Request the stop; the first reason stays."""

    def check_measurement(
        self, q: Array, v: Array, stamp: int | None = None, applied: Array | None = None,
        wrench: Array | None = None, trocar: Array | None = None,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Return the measurement, or an extrapolation in place of one that is late, repeated or impossible.

        With the registered trocar (2, 3), RCM error and trocar force are checked too.
        """

    def limit_torque(
        self, tau: Array, before: Array, q: Array, v: Array, tip_ref: Array | None = None, state: Any = None,
        tip: Array | None = None,
    ) -> Array:  # fmt: skip
        """Return the torque within its limits; ``limited`` is the number of joints that were changed.

        The tip is also compared with its reference (3, 3), and the motion at (q, v) with the torque ``before``.
        """

    def stop_torque(self, before: Array) -> Array:
        """Return the torque (n,) [Nm] of a damped stop, where ``before`` was applied last."""

    def brake_friction(self, wrench: Array) -> Array:
        """Return the dry friction (n,) [Nm] of the brakes in a stop, for the wrench (6,) at the mount."""
