"""From commanded to acting torque: refused if it is not finite, cut at the limits, delayed by control periods."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.errors import PlantError
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit


@njit(cache=True, nogil=True)
def admit(tau: Array, limit: Array, queue: Array, slot: int, applied: Array) -> bool:
    """Cut a command (n,) at the limits (n,) [Nm] and apply the one that is due; False: it is not finite.

    ``queue`` (delay, n) holds the delayed commands, the one that is due in row ``slot``.
    """
    for i in range(tau.size):
        if not np.isfinite(tau[i]):
            return False
    for i in range(tau.size):
        torque = min(max(tau[i], -limit[i]), limit[i])
        if queue.shape[0] > 0:
            applied[i], queue[slot, i] = queue[slot, i], torque
        else:
            applied[i] = torque
    return True


class Drives:
    """Torque drives without dynamics: saturation, and a delay of whole control periods as a ring buffer.

    Attributes:
        limit, queue, slot, applied: as ``admit`` takes them; turns: how many slots there are.
    """

    def __init__(self, tau_max: Array, delay_ticks: int, applied: Array) -> None:
        """Build them.

        Args:
            tau_max: (n,) [Nm].
            delay_ticks: periods from command to torque, 0 or more.
            applied: (n,) written at each command: the plant's own torque vector [Nm].
        """
        self.limit, self.applied = tau_max.copy(), applied
        self.queue, self.slot = np.zeros((delay_ticks, tau_max.size)), 0
        self.turns, self._tau = max(1, delay_ticks), np.zeros(tau_max.size)

    def start(self, tau: Array) -> None:
        """Fill the delay with one torque (n,), as if it had been commanded for long."""
        np.clip(tau, -self.limit, self.limit, out=self.applied)
        self.queue[:] = self.applied
        self.slot = 0

    def command(self, tau: ArrayLike) -> Array:
        """Return a command as contiguous numbers (n,), to be admitted.

        Raises:
            PlantError: wrong shape.
        """
        if (tau.shape if isinstance(tau, np.ndarray) else np.shape(tau)) != self._tau.shape:
            raise PlantError(f"tau has shape {np.shape(tau)}: give {self._tau.shape}, one torque a joint [Nm]")
        self._tau[:] = tau
        return self._tau

    def admitted(self, commands: int = 1) -> None:
        """Note that ``admit`` took so many commands."""
        self.slot = (self.slot + commands) % self.turns

    def refusal(self) -> PlantError:
        """Make the error of a command that ``admit`` refused."""
        return PlantError(
            f"tau = {self._tau.tolist()} Nm is not finite: the arm has not moved; mend the controller, "
            "or stop it when its solver fails"
        )
