"""Limits that hold at every tick, whatever the levels ask for, and the order to stop.

Torque and torque rate are cut. Near a joint limit, or above a joint's speed limit, a spring and a
damper take over in that joint. A measurement that cannot be true (NaN, or a jump that no motion
explains) ends the run: the arm is braked with the last state that was believed.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import Field

from moc_opt.errors import ControlError, MocOptError
from moc_opt.robots import RobotData
from moc_opt.settings import Settings

Array = NDArray[np.float64]


class GuardSettings(Settings):
    """Safety limits."""

    KIND: ClassVar[str] = "[guard]"
    ERROR: ClassVar[type[MocOptError]] = ControlError

    torque_rate_Nm_per_s: float = Field(20000.0, gt=0.0, description="largest change of a joint's torque")
    position_margin_rad: float = Field(
        0.02, ge=0.0, description="the wall begins this far inside a joint limit"
    )
    wall_stiffness_Nm_per_rad: float = Field(2000.0, ge=0.0)
    wall_damping_Nm_s_per_rad: float = Field(
        40.0, ge=0.0, description="in the wall, and above the speed limit"
    )
    jump_rad: float = Field(
        0.05, gt=0.0, description="a measured step beyond what v_max explains: not believed"
    )
    patience_ticks: int = Field(
        3, ge=0, description="ticks with a bad measurement that are bridged before the stop"
    )
    stop_damping_Nm_s_per_rad: float = Field(15.0, gt=0.0, description="of the drives in a damped stop")
    stop_s: float = Field(0.5, gt=0.0, description="how long the stop is watched before the run ends")


@njit(cache=True, nogil=True)
def limit_torque(
    tau: Array, before: Array, q: Array, v: Array, limits: Array, margin: float, stiffness: float, damping: float,
    step: float,
) -> int:  # fmt: skip
    """Apply walls, speed limit, torque rate and torque limit to tau (n,), in place.

    Args:
        before: (n,) torque of the last tick [Nm].
        limits: (4, n) rows q_min, q_max, v_max, tau_max.
        step: largest change from ``before`` [Nm].

    Returns:
        The number of joints at which something was limited.
    """
    touched = 0
    for i in range(tau.shape[0]):
        asked = tau[i]
        low, high = limits[0, i] + margin, limits[1, i] - margin
        if q[i] < low:
            tau[i] = max(tau[i], tau[i] + stiffness * (low - q[i]) - damping * min(v[i], 0.0))
        elif q[i] > high:
            tau[i] = min(tau[i], tau[i] + stiffness * (high - q[i]) - damping * max(v[i], 0.0))
        if v[i] > limits[2, i]:
            tau[i] -= damping * (v[i] - limits[2, i])
        elif v[i] < -limits[2, i]:
            tau[i] -= damping * (v[i] + limits[2, i])
        tau[i] = min(max(tau[i], before[i] - step), before[i] + step)
        tau[i] = min(max(tau[i], -limits[3, i]), limits[3, i])
        if tau[i] != asked:
            touched += 1
    return touched


@njit(cache=True, nogil=True)
def believable(q: Array, v: Array, q_before: Array, reach: Array) -> bool:
    """Whether q (n,) follows q_before within reach (n,) [rad], and everything is finite."""
    for i in range(q.shape[0]):
        if not (np.isfinite(q[i]) and np.isfinite(v[i])) or not abs(q[i] - q_before[i]) <= reach[i]:
            return False
    return True


class Guard:
    """The limits of one arm, with the memory they need; ``period`` [s]."""

    def __init__(self, data: RobotData, settings: GuardSettings, period: float) -> None:
        self.settings, self._period = settings, period
        self._limits = np.ascontiguousarray([data.q_min, data.q_max, data.v_max, data.tau_max])
        self._per_tick = data.v_max * period
        self._step = settings.torque_rate_Nm_per_s * period
        self._q, self._v, self._bad = np.zeros(data.n), np.zeros(data.n), 0
        self.limited = 0

    def start(self, q: Array, v: Array) -> None:
        """Believe the first measurement.

        Raises:
            ControlError: it is not finite.
        """
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            raise ControlError(f"measured q = {q.tolist()}, v = {v.tolist()}: not finite; check the sensors")
        self._q, self._v, self._bad = np.array(q), np.array(v), 0

    def believe(self, q: Array, v: Array) -> tuple[Array, Array]:
        """The measurement, or the last believed one moved on where this one cannot be true."""
        reach = self.settings.jump_rad + (1 + self._bad) * self._per_tick
        if believable(q, v, self._q, reach):
            self._q, self._v, self._bad = q, v, 0
        else:
            self._bad += 1
            self._q = self._q + self._v * self._period
        return self._q, self._v

    @property
    def bad_ticks(self) -> int:
        """Measurements in a row that were not believed."""
        return self._bad

    @property
    def lost(self) -> bool:
        """Whether the sensors have been wrong for longer than the patience: time to stop."""
        return self._bad > self.settings.patience_ticks

    def limit(self, tau: Array, before: Array, q: Array, v: Array) -> Array:
        """A torque (n,) [Nm] within the limits; ``limited`` counts the joints at which they acted."""
        s = self.settings
        tau = tau.copy()
        self.limited = limit_torque(
            tau, before, q, v, self._limits, s.position_margin_rad, s.wall_stiffness_Nm_per_rad,
            s.wall_damping_Nm_s_per_rad, self._step,
        )  # fmt: skip
        return tau
