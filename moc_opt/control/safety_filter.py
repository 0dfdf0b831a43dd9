"""The safety filter: limits on torque and motion that hold whatever the levels ask for, and the request to stop.

Limits: torque and torque rate are cut; a joint near its limit or above its speed limit is braked.

Reasons to stop: a measurement that cannot be true (NaN, or a jump that no motion explains) for too long, a torque
that is not finite, a controller that fails, a tip far off its reference, a shaft far from the registered trocar, a
trocar that is pressed hard, and motion that the torque does not explain. In a stop the drives brake, and the torque
carries the arm's weight in the last pose that passed the checks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import float64, int64
from numpy.typing import NDArray

from moc_opt.control import safety_kernels as kernels
from moc_opt.control.incision import Incision
from moc_opt.control.motion import MotionMonitor
from moc_opt.control.motion_kernels import FRESH, OLD
from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.errors import ControlError
from moc_opt.model.robot_state import RobotState
from moc_opt.numerics.compiled import MATRIX, VECTOR, CompiledKernel
from moc_opt.robots import RobotData

Array = NDArray[np.float64]

_BELIEVABLE = CompiledKernel(kernels.believable, VECTOR, VECTOR, VECTOR, float64, int64, MATRIX)
_SQUARED_ERROR = CompiledKernel(kernels.squared_error, VECTOR, MATRIX)
_LIMIT = CompiledKernel(kernels.limit_torque, *[VECTOR] * 5, MATRIX, VECTOR, float64)

_NEEDS_HOLD, _NOT_FINITE = -1, -2
PRESS_PER_S = 50.0  # rate of the mean of the trocar's force in a stop


class SafetyFilter:
    """Check measurements and limit torques of one arm.

    Args:
        data: the arm.
        settings: see SafetyFilterSettings.
        period: control period [s].
        gravity: q (n,) [rad] -> torque (n,) [Nm] that carries the arm's weight (``RobotModel.gravity``); None for
            drives that carry it by themselves.
        tool_pose: q (n,) [rad] -> (4, 3) axes and tip of the tool (``RobotModel.tool_pose``); None for an arm
            that is in no incision: RCM error and trocar force are not checked then.
        state: q, v -> RobotState (``RobotModel.state``), for a controller that shows none; None: its motion is not
            compared with its torque.

    Attributes:
        limited: number of joints at which the last torque was changed.
        reason: why a stop was requested; empty while none was.
    """

    def __init__(
        self,
        data: RobotData,
        settings: SafetyFilterSettings,
        period: float,
        gravity: Callable[[Array], Array] | None = None,
        tool_pose: Callable[[Array], Array] | None = None,
        state: Callable[[Array, Array], RobotState] | None = None,
        slides: NDArray[np.bool_] | None = None,
    ) -> None:
        self.settings, self._period = settings, period
        self._believable, self._squared_error, self._limit = _BELIEVABLE.code, _SQUARED_ERROR.code, _LIMIT.code
        margins = settings.position_margins(np.zeros(data.n, dtype=np.bool_) if slides is None else slides)
        self._limits = np.ascontiguousarray([data.q_min, data.q_max, data.v_max, data.tau_max, margins])
        self._wall = np.array([
            settings.wall_stiffness_Nm_per_rad, settings.wall_damping_Nm_s_per_rad, settings.wall_brake_rad_per_s2,
        ])  # fmt: skip
        self._jump = settings.jump_rad
        self._bounds = np.array([data.v_max * period, settings.speed_factor * data.v_max])
        self._step = settings.torque_rate_Nm_per_s * period
        self._unknown, self._rest = np.empty(0), np.zeros(data.n)
        self._gravity, self._state = gravity, state
        self._motion = MotionMonitor(settings, period, settings.patience_ticks, data.tau_max, data.coulomb_friction)
        self._share = min(1.0, period / settings.tip_error_s)
        self._most = settings.tip_error_m**2
        self._most_open = round(settings.stop_yield_s / period)
        self._press_share = min(1.0, PRESS_PER_S * period)
        touch = np.inf if settings.tip_force_N is None else settings.tip_force_N
        self._incision = None if tool_pose is None else Incision(
            tool_pose, (data.tool_mass, data.tool_length, touch), min(1.0, period / settings.incision_s),
            settings.patience_ticks, (settings.rcm_warning_m, settings.rcm_error_m),
            (settings.trocar_force_warning_N, settings.trocar_force_N),
        )  # fmt: skip
        self._forget(np.zeros(data.n), np.zeros(data.n))

    def _forget(self, q: Array, v: Array) -> None:
        self._q, self._v, self._bad = q, v, 0
        self._square, self.limited, self.reason, self._yields = 0.0, 0, "", False
        self._press, self._borne, self._open = 0.0, 0.0, 0

    def start(self, q: Array, v: Array, stamp: int = 0) -> None:
        """Begin at the first measurement, number ``stamp``, and run every compiled check once, before the loop.

        Raises:
            ControlError: it is not finite.
        """
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            raise ControlError(f"measured q = {q.tolist()}, v = {v.tolist()}: not finite; check the sensors")
        self._forget(np.array(q), np.array(v))
        self._motion.start(q, v, stamp)
        self.check_measurement(q, v)
        if self._state is not None:
            self.check_motion(q, v, None, self._rest)
            self.check_motion(q, v, None, self._rest)
        self.limit_torque(self._rest, self._rest, q, v)
        self.check_tip(np.zeros(3), np.zeros((3, 3)))
        self.limited = 0
        self._forget(np.array(q), np.array(v))
        self._motion.start(q, v, stamp)
        if self._incision is not None:
            self._incision.check(q, np.zeros((2, 3)), np.zeros(6))
            self._incision.forget()

    def check_measurement(
        self, q: Array, v: Array, stamp: int | None = None, applied: Array | None = None, wrench: Array | None = None
    ) -> tuple[Array, Array]:
        """Return the measurement, or the last accepted one extrapolated where this one is late or cannot be true.

        Args:
            q, v: (n,) as measured [rad], [rad/s].
            stamp: number of the control period in which it was taken; None: the arm counts none.
            applied: (n,) torque that was applied before it [Nm]; None: not known.
            wrench: (6,) as the sensor at the tool's mount shows it; None: not known.
        """
        late = FRESH if stamp is None else self._motion.age(stamp)
        if late == OLD:
            self.request_stop(f"measurements are more than {self.settings.patience_ticks} ticks late")
        if late == FRESH and self._believable(q, v, self._q, self._jump, 1 + self._bad, self._bounds):
            self._q, self._v, self._bad = q, v, 0
            if applied is not None:
                self.request_stop(self._motion.check_reading(q, v, applied, wrench))
        else:
            self._bad += 1
            self._q = self._q + self._v * self._period
            if self._bad > self.settings.patience_ticks:
                self.request_stop("measurements not believed")
        return self._q, self._v

    def check_motion(self, q: Array, v: Array, state: RobotState | None, applied: Array) -> None:
        """Compare the motion at (q, v) with the torque (n,) [Nm] that was applied before it.

        ``state`` is that of (q, v) where the controller shows it; None: it is computed.
        """
        if state is None:
            if self._state is None:
                return
            state = self._state(q, v)
        self.request_stop(self._motion.check_momentum(state, applied))

    def check_tip(self, tip: Array, tip_ref: Array) -> None:
        """Check the distance of the tip (3,) from its reference (3, 3) rows X_d, dX_d, ddX_d [m]."""
        self._motion.set_reference(tip_ref)
        self._square += self._share * (self._squared_error(tip, tip_ref) - self._square)
        if not self._square <= self._most:
            self.request_stop(f"the tip has been {1e3 * self.settings.tip_error_m:g} mm off its reference")

    def check_incision(self, q: Array, trocar: Array, wrench: Array) -> None:
        """Check RCM error and trocar force; arguments as for ``Incision.check``."""
        if self._incision is not None:
            self.request_stop(self._incision.check(q, trocar, wrench))

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """What exceeded its warning level since the start: ``of``, ``first_s``, ``largest``, ``unit``, ``level``."""
        return [] if self._incision is None else self._incision.warnings(self._period)

    @property
    def bad_ticks(self) -> int:
        """Number of measurements in a row that were not accepted."""
        return self._bad

    @property
    def stopped(self) -> bool:
        """Whether a stop was requested; only ``start`` ends it."""
        return bool(self.reason)

    def request_stop(self, reason: str) -> None:
        """Request the stop; the first reason stays, and an empty one is none."""
        self.reason = self.reason or reason

    def limit_torque(self, tau: Array, before: Array, q: Array, v: Array) -> Array:
        """Return the torque (n,) [Nm] within the limits; ``limited`` counts the joints at which they acted.

        A torque that is not finite requests the stop, and ``before`` is returned.
        """
        tau = np.array(tau, dtype=np.float64)
        rest = (before, q, v, self._unknown, self._limits, self._wall, self._step)
        self.limited = self._limit(tau, *rest)
        if self.limited == _NEEDS_HOLD:
            self.limited = self._limit(tau, *rest[:3], self._weight(q), *rest[4:])
        if self.limited == _NOT_FINITE:
            self.limited = 0
            self.request_stop("the controller's torque is not finite")
            return before
        return tau

    def stop_torque(self, before: Array) -> Array:
        """Return the torque (n,) [Nm] of a damped stop: the weight of the arm in the last pose that was accepted.

        The last torque itself would go on pushing wherever the levels pushed at that moment.
        """
        self.limited = 0
        weight = self._weight(self._q)
        if not np.isfinite(weight).all():
            return self._rest  # the weight is not known: the brakes alone
        wanted = np.clip(weight, -self._limits[3], self._limits[3])
        return before + np.clip(wanted - before, -self._step, self._step)

    def brake_friction(self, wrench: Array) -> Array:
        """Return the dry friction (n,) [Nm] of the brakes in a stop; zero while the trocar presses the shaft hard.

        Closed brakes hold the arm against tissue that pushes it, and keep up the force; open ones let it sink under
        any load that its model does not know of. So they open at ``stop_yield_N``, close again at half of it or after
        ``stop_yield_s``, and open once more where the force has risen by as much again since. They stay closed where
        the drives cannot carry the weight.

        Args:
            wrench: (6,) force [N] and torque [Nm] of the tool on its mount, tool axes.
        """
        level, friction, weight = self.settings.stop_yield_N, np.zeros(self._rest.size), self._weight(self._q)
        weight = weight if np.isfinite(weight).all() else self._rest
        if self._incision is not None and level is not None and (np.abs(weight) <= self._limits[3]).all():
            # A mean: in the first moments the sensor also shows the tool's inertia force.
            force = self._incision.pressed(self._q, wrench)
            self._press = self._press + self._press_share * (force - self._press) if np.isfinite(force) else 0.0
            self._yields = self._press - self._borne > (0.5 * level if self._yields else level)
            self._open = self._open + 1 if self._yields else 0
            if self._open > self._most_open:
                self._yields, self._borne = False, self._press
            elif not self._yields:
                self._borne = min(self._borne, self._press)
        if not self._yields:
            kernels.holding_friction(weight, self._limits[3], self.settings.stop_holding, friction)
        return friction

    def _weight(self, q: Array) -> Array:
        return self._rest if self._gravity is None else self._gravity(q)
