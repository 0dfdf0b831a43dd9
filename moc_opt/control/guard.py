"""Limits that hold at every tick, whatever the levels ask for, and the order to stop.

Torque and torque rate are cut. A joint may come near its limit only as fast as it can still be stopped;
a faster one, and one above its speed limit, is braked. A measurement that cannot be true (NaN, or a jump
that no motion explains), a torque that is no number, or a controller that breaks down ends the run: the
drives brake, and the torque carries the arm's weight in the last pose that was believed. A tip that has been
far off its reference for a while ends it too: an unstable loop does not go on in silence.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import Field

from moc_opt.errors import ControlError, MocOptError
from moc_opt.robots import RobotData
from moc_opt.settings import Settings

Array = NDArray[np.float64]

_NEEDS_HOLD, _NOT_FINITE = -1, -2


class GuardSettings(Settings):
    """Safety limits."""

    KIND: ClassVar[str] = "[guard]"
    ERROR: ClassVar[type[MocOptError]] = ControlError

    torque_rate_Nm_per_s: float = Field(20000.0, gt=0.0, description="largest change of a joint's torque")
    position_margin_rad: float = Field(
        0.045, ge=0.0, description="the wall begins this far inside a joint limit"
    )
    wall_stiffness_Nm_per_rad: float = Field(2000.0, ge=0.0)
    wall_damping_Nm_s_per_rad: float = Field(
        20.0, ge=0.0, description="in the wall, and above the speed that is allowed"
    )
    wall_brake_rad_per_s2: float = Field(
        2.0, gt=0.0, description="allowed speed at a distance d from a wall: sqrt(2 d wall_brake)"
    )
    jump_rad: float = Field(
        0.05, gt=0.0, description="a measured step beyond what v_max explains: not believed"
    )
    speed_factor: float = Field(5.0, gt=1.0, description="of v_max: a measured speed above it: not believed")
    patience_ticks: int = Field(
        3, ge=0, description="ticks with a bad measurement that are bridged before the stop"
    )
    tip_error_m: float = Field(
        0.01, gt=0.0, description="root mean square of the tip's error: above it, the loop is out of control"
    )
    tip_error_s: float = Field(0.1, gt=0.0, description="time constant of that mean")
    stop_damping_Nm_s_per_rad: float = Field(40.0, gt=0.0, description="of the drives in a damped stop")
    stop_s: float = Field(0.5, gt=0.0, description="how long the stop is watched before the run ends")


@njit(cache=True, nogil=True)
def limit_torque(
    tau: Array, before: Array, q: Array, v: Array, hold: Array, limits: Array, wall: Array, step: float
) -> int:
    """Apply walls, speed limit, torque rate and torque limit to tau (n,), in place.

    At a distance d from its wall a joint may move towards it at v_allowed = min(v_max, sqrt(2 brake d)).
    A faster one is braked: tau <= hold - damping (v - v_allowed), and inside the wall
    tau <= hold - stiffness depth - damping v, whatever was asked for.

    Args:
        before: (n,) torque of the last tick [Nm].
        hold: (n,) torque that carries the arm's weight [Nm]; empty: not known yet.
        limits: (4, n) rows q_min, q_max, v_max, tau_max.
        wall: margin [rad], stiffness [Nm/rad], damping [Nm s/rad], brake [rad/s^2].
        step: largest change from ``before`` [Nm].

    Returns:
        The number of joints at which something was limited; -1 where ``hold`` is empty and a joint must be
        braked, -2 where the torque is no number. tau is as it was in both of these cases.
    """
    n = tau.shape[0]
    margin, stiffness, damping, brake = wall[0], wall[1], wall[2], wall[3]
    push = np.zeros((2, n))  # what a wall or a brake leaves of the torque above ``hold``: at least, at most
    braked = False
    for i in range(n):
        if not np.isfinite(tau[i]):
            return -2
        push[0, i], push[1, i] = -np.inf, np.inf
        below, above = q[i] - limits[0, i] - margin, limits[1, i] - margin - q[i]
        fall = min(limits[2, i], np.sqrt(2.0 * brake * max(below, 0.0)))
        rise = min(limits[2, i], np.sqrt(2.0 * brake * max(above, 0.0)))
        if below < 0.0 or v[i] < -fall:
            push[0, i] = stiffness * max(-below, 0.0) - damping * min(v[i] + fall, 0.0)
            braked = True
        if above < 0.0 or v[i] > rise:
            push[1, i] = -stiffness * max(-above, 0.0) - damping * max(v[i] - rise, 0.0)
            braked = True
        if push[0, i] > push[1, i]:  # leaving a wall too fast already: neither spring nor brake
            push[0, i] = push[1, i] = 0.0
    if braked and hold.shape[0] != n:
        return -1
    touched = 0
    for i in range(n):
        asked = tau[i]
        if braked:
            tau[i] = max(min(tau[i], hold[i] + push[1, i]), hold[i] + push[0, i])
        tau[i] = min(max(tau[i], before[i] - step), before[i] + step)
        tau[i] = min(max(tau[i], -limits[3, i]), limits[3, i])
        if tau[i] != asked:
            touched += 1
    return touched


@njit(cache=True, nogil=True)
def believable(
    q: Array, v: Array, q_before: Array, jump: float, ticks: int, per_tick: Array, fastest: Array
) -> bool:
    """Whether q (n,) [rad] is no farther from q_before than jump + ticks per_tick, and |v| <= fastest; NaN never is."""
    for i in range(q.shape[0]):
        if not (abs(q[i] - q_before[i]) <= jump + ticks * per_tick[i] and abs(v[i]) <= fastest[i]):
            return False
    return True


@njit(cache=True, nogil=True)
def squared_error(tip: Array, tip_ref: Array) -> float:
    """|tip - X_d|^2 [m^2], X_d the first row of tip_ref (3, 3)."""
    square = 0.0
    for i in range(3):
        square += (tip[i] - tip_ref[0, i]) ** 2
    return square


class Guard:
    """The limits of one arm, with the memory they need.

    Args:
        data: the arm.
        settings: see GuardSettings.
        period: control period [s].
        gravity: q (n,) [rad] -> torque (n,) [Nm] that carries the arm's weight (``RobotModel.gravity``); None for
            drives that carry it by themselves.
    """

    def __init__(
        self,
        data: RobotData,
        settings: GuardSettings,
        period: float,
        gravity: Callable[[Array], Array] | None = None,
    ) -> None:
        self.settings, self._period = settings, period
        self._limits = np.ascontiguousarray([data.q_min, data.q_max, data.v_max, data.tau_max])
        self._wall = np.array([
            settings.position_margin_rad, settings.wall_stiffness_Nm_per_rad,
            settings.wall_damping_Nm_s_per_rad, settings.wall_brake_rad_per_s2,
        ])  # fmt: skip
        self._jump = settings.jump_rad
        self._per_tick = data.v_max * period
        self._fastest = settings.speed_factor * data.v_max
        self._step = settings.torque_rate_Nm_per_s * period
        self._unknown, self._rest = np.empty(0), np.zeros(data.n)
        self._gravity = gravity
        self._share = min(1.0, period / settings.tip_error_s)
        self._most = settings.tip_error_m**2
        self._believe_anew(np.zeros(data.n), np.zeros(data.n))

    def _believe_anew(self, q: Array, v: Array) -> None:
        self._q, self._v, self._bad = q, v, 0
        self._square, self.limited, self.reason = 0.0, 0, ""

    def start(self, q: Array, v: Array) -> None:
        """Believe the first measurement; what is compiled runs once, so that no compiler runs in the loop.

        Raises:
            ControlError: it is not finite.
        """
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            raise ControlError(f"measured q = {q.tolist()}, v = {v.tolist()}: not finite; check the sensors")
        self._believe_anew(np.array(q), np.array(v))
        self.believe(q, v)
        self.limit(self._rest, self._rest, q, v)
        self.follow(np.zeros(3), np.zeros((3, 3)))
        self.limited = 0

    def believe(self, q: Array, v: Array) -> tuple[Array, Array]:
        """The measurement, or the last believed one moved on where this one cannot be true."""
        if believable(q, v, self._q, self._jump, 1 + self._bad, self._per_tick, self._fastest):
            self._q, self._v, self._bad = q, v, 0
        else:
            self._bad += 1
            self._q = self._q + self._v * self._period
            if self._bad > self.settings.patience_ticks:
                self.give_up("measurements not believed")
        return self._q, self._v

    def follow(self, tip: Array, tip_ref: Array) -> None:
        """Take note of how far the tip (3,) is from its reference (3, 3) rows X_d, ... [m]."""
        self._square += self._share * (squared_error(tip, tip_ref) - self._square)
        if not self._square <= self._most:
            self.give_up(f"the tip has been {1e3 * self.settings.tip_error_m:g} mm off its reference")

    @property
    def bad_ticks(self) -> int:
        """Measurements in a row that were not believed."""
        return self._bad

    @property
    def lost(self) -> bool:
        """Whether it is time to stop; ``reason`` says why. There is no way back but ``start``."""
        return bool(self.reason)

    def give_up(self, reason: str) -> None:
        """Order the stop; the first reason stays."""
        self.reason = self.reason or reason

    def limit(self, tau: Array, before: Array, q: Array, v: Array) -> Array:
        """A torque (n,) [Nm] within the limits; ``limited`` counts the joints at which they acted.

        A torque that is no number is an order to stop; ``before`` is returned then.
        """
        tau = tau.copy()
        rest = (before, q, v, self._unknown, self._limits, self._wall, self._step)
        self.limited = limit_torque(tau, *rest)
        if self.limited == _NEEDS_HOLD:
            self.limited = limit_torque(tau, *rest[:3], self._weight(q), *rest[4:])
        if self.limited == _NOT_FINITE:
            self.limited = 0
            self.give_up("the controller's torque is not finite")
            return before
        return tau

    def rest(self, before: Array) -> Array:
        """The torque (n,) [Nm] of a damped stop: the weight of the arm in the last pose believed.

        Holding the last torque instead would go on pushing wherever the levels were pushing at that moment.
        """
        self.limited = 0
        weight = self._weight(self._q)
        if not np.isfinite(weight).all():
            return self._rest  # a model that knows no weight: the brakes alone
        wanted = np.clip(weight, -self._limits[3], self._limits[3])
        return before + np.clip(wanted - before, -self._step, self._step)

    def _weight(self, q: Array) -> Array:
        return self._rest if self._gravity is None else self._gravity(q)
