"""The safety filter. Its checks are in core/safety_filter.c, and docs/extending.md says how to add one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from moc_opt import core
from moc_opt.arrays import Array
from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.errors import ControlError
from moc_opt.robots.model import RobotModel, RobotState

PRESS_PER_S = 50.0  # inverse time constant of the low-pass filter on the trocar's force in a stop
MOST_TICKS = 2**31 - 1  # the largest int of C
_SETTLED = 6.0  # settling time of the momentum residuals (see `SafetyFilter`) [time constants of their observer]
_NO_WRENCH = np.full(6, np.nan)
_LATE, _TIP = core.REASONS.index("measurements are too late"), core.REASONS.index("the tip has been off its reference")
_WATCHED = (
    ("the RCM error", "rcm_warning_m", "rcm_error_m", "mm", 1e3),
    ("the trocar's force", "trocar_force_warning_N", "trocar_force_N", "N", 1.0),
)  # quantity, setting of the warning, setting of the limit, unit, factor from SI to this unit
_AS_SET = (  # settings with the same name in the core
    "speed_factor", "stop_holding", "motion", "motion_s", "motion_rad", "motion_lag_s", "repeat_m", "repeat_torque",
    "repeat_whole_m", "repeat_whole_torque", "repeat_whole_ticks", "repeat_joint_ticks", "repeat_reading_ticks",
    "residual_torque",
)  # fmt: skip


class SafetyFilter:
    """Check measurements, limit torques, and request a stop if a check fails.

    A joint's momentum residual is the torque that its motion implies, minus the applied torque.

    Args:
        robot: the model of the arm.
        settings: see SafetyFilterSettings.
        period: control period [s].
        carries: whether the commanded torque carries the arm's weight. If not, the drives add the gravity torque.
        incision: whether the tool is in an incision. If not, RCM error and trocar force are not checked.
        momentum: whether `limit_torque` computes the robot's state if its argument ``state`` is None. Without a state,
            momentum residuals are not checked.

    Attributes:
        limited: number of joints whose torque the last call of `limit_torque` changed.
        reason: why a stop was requested; empty if none was.
    """

    def __init__(
        self, robot: RobotModel, settings: SafetyFilterSettings, period: float, *, carries: bool = True,
        incision: bool = True, momentum: bool = True,
    ) -> None:  # fmt: skip
        self.settings, self._robot, self._period = settings, robot, period
        self._computes = momentum and settings.motion
        self._guard = core.Guard(robot.arm, **numbers_of(settings, robot, period, carries, incision))
        self._words = list(core.REASONS)
        self._words[_LATE] = f"measurements are more than {settings.patience_ticks} ticks late"
        self._words[_TIP] = f"the tip has been {1e3 * settings.tip_error_m:g} mm off its reference"
        for name, _, limit, unit, scale in _WATCHED:
            if (level := getattr(settings, limit)) is not None:
                reason = core.REASONS.index(f"{name} has been above its limit")
                self._words[reason] = f"{name} has been above {scale * level:g} {unit}"
        self._rest = np.zeros(robot.n)
        self.start(np.clip(robot.data.q_home, robot.q_min, robot.q_max), self._rest)

    def start(self, q: Array, v: Array, stamp: int = 0) -> None:
        """Begin at the first measurement (q, v), which was taken in control period number ``stamp``.

        Raises:
            ControlError: the measurement is not finite.
        """
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            raise ControlError(f"measured q = {q.tolist()}, v = {v.tolist()}: not finite; check the sensors")
        self._guard.start(np.ascontiguousarray(q), np.ascontiguousarray(v), stamp)
        self.limited, self.reason = 0, ""

    def check_measurement(
        self, q: Array, v: Array, stamp: int | None = None, applied: Array | None = None,
        wrench: Array | None = None, trocar: Array | None = None,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Return the measurement. If it is late or impossible, return the last accepted measurement, extrapolated.

        A stop is requested after more than ``patience_ticks`` such measurements in a row, or if another check fails.

        Args:
            q, v: (n,) measured [rad], [rad/s].
            stamp: number of the control period of the measurement; None: the age is not checked.
            applied: (n,) torque that was applied last [Nm]; None: frozen or replayed measurements are not detected, and
                q is not compared with the integral of v.
            wrench: (6,) force [N] and torque [Nm] of the tool on its mount, in tool axes; needed with a trocar.
            trocar: (2, 3) rows P_t, dP_t of the registered trocar; None: RCM error and trocar force are not checked.
        """
        number, seen = math.nan if stamp is None else stamp, _NO_WRENCH if wrench is None else wrench
        reason, q, v = self._guard.believe(q, v, number, applied, seen, trocar)
        if reason:
            self.request_stop(self._words[reason])
        return q, v

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """One dict per exceeded warning level: ``of`` (quantity), ``level``, ``largest``, ``unit`` and ``first_s``."""
        _, figures = self._guard.watched()
        found = []
        for (name, warning, _, unit, scale), largest, first in zip(_WATCHED, *figures[1:].tolist(), strict=True):
            level = getattr(self.settings, warning)
            if level is not None and first >= 0:
                found.append({
                    "of": name, "first_s": first * self._period, "largest": scale * largest, "unit": unit,
                    "level": scale * level,
                })  # fmt: skip
        return found

    def request_stop(self, reason: str) -> None:
        """Request a stop. The first reason is kept."""
        self.reason = self.reason or reason

    def limit_torque(
        self, tau: Array, before: Array, q: Array, v: Array, tip_ref: Array | None = None,
        state: RobotState | None = None, tip: Array | None = None,
    ) -> Array:  # fmt: skip
        """Return the torque (n,) [Nm] within its limits.

        A stop is requested if the tip error or a momentum residual exceeds its limit, or if the torque is not finite. A
        torque that is not finite is replaced by ``before``.

        Args:
            tau: (n,) torque of the controller [Nm].
            before: (n,) torque that was applied last [Nm].
            q, v: (n,) as returned by `check_measurement`.
            tip_ref: (3, 3) rows X_d, dX_d, ddX_d, as in `Controller.tick`; None: the tip is not checked.
            state: the robot's state at (q, v), if known.
            tip: (3,) tip that the controller computed [m]; None: the tip of ``state``, if that is given.
        """
        shown = state is not None or tip is not None
        if state is None and self._computes:
            state = self._robot.state(q, v)
        tau = np.array(tau, dtype=np.float64)
        reason, self.limited = self._guard.follow(
            q, v, None if state is None else state.record, tip, tip_ref if shown else None, before, tau
        )
        if not reason:
            return tau
        self.request_stop(self._words[reason])
        return tau if math.isfinite(tau.dot(tau)) else before

    def stop_torque(self, before: Array) -> Array:
        """Return the torque (n,) [Nm] in a stop: ``before``, moved towards the gravity torque of the last good pose."""
        self.limited = 0
        return self._guard.rest(np.ascontiguousarray(before, dtype=np.float64))

    def brake_friction(self, wrench: Array) -> Array:
        """Return the dry friction (n,) [Nm] of the brakes in a stop; zero while they are open (see ``stop_yield_N``).

        Args:
            wrench: (6,) as for `check_measurement`.
        """
        return self._guard.hold(np.ascontiguousarray(wrench, dtype=np.float64))


def numbers_of(
    settings: SafetyFilterSettings, robot: RobotModel, period: float, carries: bool = True, incision: bool = True
) -> dict[str, Any]:
    """Return the fields of the core's struct moc_guard, by name. The arguments are those of `SafetyFilter`."""
    data, s = robot.data, settings
    margins = np.where(robot.chain.prismatic, s.position_margin_m, s.position_margin_rad)
    coulomb = np.where(data.coulomb_friction > 0.0, s.stuck_friction * data.coulomb_friction, np.inf)  # 0: unknown
    return {
        **{name: _or_infinite(getattr(s, name)) for name in _AS_SET},
        "period": period, "patience": s.patience_ticks, "carries": carries,
        "low": data.q_min + margins, "high": data.q_max - margins,
        "v_max": np.array(data.v_max), "tau_max": np.array(data.tau_max),
        "wall_stiffness": s.wall_stiffness_Nm_per_rad, "wall_damping": s.wall_damping_Nm_s_per_rad,
        "wall_brake": s.wall_brake_rad_per_s2, "torque_step": s.torque_rate_Nm_per_s * period, "jump": s.jump_rad,
        "tip_error": s.tip_error_m, "tip_share": min(1.0, period / s.tip_error_s), "in_incision": incision,
        "warning": np.array([_or_infinite(getattr(s, warning)) for _, warning, *_ in _WATCHED]),
        "limit": np.array([_or_infinite(getattr(s, limit)) for _, _, limit, *_ in _WATCHED]),
        "incision_share": min(1.0, period / s.incision_s),
        "tool_mass": data.tool_mass, "tool_length": data.tool_length, "tip_force": _or_infinite(s.tip_force_N),
        "stop_yield": _or_infinite(s.stop_yield_N), "stop_yield_ticks": round(s.stop_yield_s / period),
        "press_share": min(1.0, PRESS_PER_S * period),
        "replayed_ticks": max(float(s.repeat_whole_ticks), _or_infinite(s.repeat_joint_ticks) / robot.n),
        "stuck_speed": s.stuck_rad_per_s, "held": np.minimum(s.stuck_torque * data.tau_max, coulomb),
        "residual_whole": s.residual_whole_torque, "residual_rate": s.residual_rate_per_s,
        "residual_share": min(1.0, period / s.residual_s),
        "settling_ticks": round(min(_SETTLED / (s.residual_rate_per_s * period), 1e9)),
    }  # fmt: skip


def _or_infinite(level: float | None) -> float:
    return math.inf if level is None else level
