"""From commanded to acting torque: finite or refused, cut at the limits, some control periods late."""

from __future__ import annotations

import numpy as np
from numba import int64
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import PlantError
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import MATRIX, VECTOR, CompiledKernel

Array = NDArray[np.float64]


@njit(cache=True)
def _admit(tau: Array, limit: Array, queue: Array, slot: int, applied: Array) -> bool:
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


_ADMIT = CompiledKernel(_admit, VECTOR, VECTOR, MATRIX, int64, VECTOR)


class Drives:
    """Torque drives without dynamics: saturation, and a delay of whole control periods as a ring buffer."""

    def __init__(self, tau_max: Array, delay_ticks: int, applied: Array) -> None:
        """Build them.

        Args:
            tau_max: (n,) [Nm].
            delay_ticks: periods from command to torque, 0 or more.
            applied: (n,) written at each command: the plant's own torque vector [Nm].
        """
        self._admit = _ADMIT.code
        self._limit, self._applied = tau_max.copy(), applied
        self._delay, self._queue = delay_ticks, np.zeros((delay_ticks, tau_max.size))
        self._tau, self._slot = np.zeros(tau_max.size), 0

    def start(self, tau: Array) -> None:
        """Fill the delay with one torque (n,), as if it had been commanded for long."""
        np.clip(tau, -self._limit, self._limit, out=self._applied)
        self._queue[:] = self._applied
        self._slot = 0

    def command(self, tau: ArrayLike) -> None:
        """Take the command of this period and put the one that is due on the joints.

        Raises:
            PlantError: wrong shape or not finite; nothing has changed then.
        """
        if (tau.shape if isinstance(tau, np.ndarray) else np.shape(tau)) != self._tau.shape:
            raise PlantError(
                f"tau has shape {np.shape(tau)}: give {self._tau.shape}, one torque a joint [Nm]"
            )
        self._tau[:] = tau
        if not self._admit(self._tau, self._limit, self._queue, self._slot, self._applied):
            raise PlantError(
                f"tau = {self._tau.tolist()} Nm is not finite: the arm has not moved; mend the controller, "
                "or stop it when its solver fails"
            )
        if self._delay:
            self._slot = (self._slot + 1) % self._delay
