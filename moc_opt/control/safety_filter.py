"""The safety filter: limits of torque and motion that act on every output of the levels, and the request to stop.

Limits: torque and torque rate are cut; a joint near its limit or above its speed limit is braked.

Reasons to stop: an impossible measurement (NaN, or a jump that no motion explains) for too long, a torque
that is not finite, a controller that fails, a tip far from its reference, a shaft far from the registered trocar, a
large force on the trocar, and motion that the torque does not explain. In a stop the drives brake, and the torque
carries the arm's weight in the last pose that passed the checks.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numba import float64
from numpy.typing import NDArray

from moc_opt.control import safety_kernels as kernels
from moc_opt.control import safety_tick as tick
from moc_opt.control.incision import Incision
from moc_opt.control.motion import WORDS, MotionMonitor
from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.errors import ControlError
from moc_opt.model.place_kernels import ToolPlace, tool_pose
from moc_opt.model.robot_state import RobotState
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.compiled import MATRIX, VECTOR, CompiledKernel
from moc_opt.robots import RobotData

_LIMIT = CompiledKernel(kernels.limit_torque, *[VECTOR] * 5, MATRIX, VECTOR, float64)

_NEEDS_HOLD, _NOT_FINITE = -1, -2
_NO_WRENCH, _NO_TROCAR, _NONE = np.full(6, np.nan), np.zeros((2, 3)), np.empty(0)
_NO_REFERENCE = np.zeros((3, 3))
PRESS_PER_S = 50.0  # rate of the mean of the trocar's force in a stop


class SafetyFilter:
    """Check measurements and limit torques of one arm.

    Args:
        data: the arm.
        settings: see SafetyFilterSettings.
        period: control period [s].
        gravity: q (n,) [rad] -> torque (n,) [Nm] that carries the arm's weight (``RobotModel.gravity``); None for
            drives that carry it by themselves.
        tool: where the arm carries it (``RobotModel.tool_place``); None for an arm that is in no incision: RCM
            error and trocar force are not checked then.
        state: q, v -> RobotState (``RobotModel.state``), for a controller that shows none; None: its motion is not
            compared with its torque.
        slides: (n,) which joints are prismatic: they have a margin of their own; None: none is.

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
        tool: ToolPlace | None = None,
        state: Callable[[Array, Array], RobotState] | None = None,
        slides: NDArray[np.bool_] | None = None,
    ) -> None:
        self.settings, self._period = settings, period
        margins = settings.position_margins(np.zeros(data.n, dtype=np.bool_) if slides is None else slides)
        self._walls = np.array([data.q_min + margins, data.q_max - margins])
        self._limits = np.array([*self._walls, data.v_max, data.tau_max])
        self._wall = np.array([
            settings.wall_stiffness_Nm_per_rad, settings.wall_damping_Nm_s_per_rad, settings.wall_brake_rad_per_s2,
        ])  # fmt: skip
        self._step = settings.torque_rate_Nm_per_s * period
        self._rest, self._believed = np.zeros(data.n), np.zeros((2, data.n))
        self._counts, self._square = np.zeros(3, dtype=np.int64), np.zeros(1)
        self._gravity, self._state, self._place = gravity, state, tool
        self._motion = MotionMonitor(settings, period, data.tau_max, data.coulomb_friction)
        self._most_open = round(settings.stop_yield_s / period)
        self._press_share = min(1.0, PRESS_PER_S * period)
        touch = np.inf if settings.tip_force_N is None else settings.tip_force_N
        self._incision = Incision(
            (data.tool_mass, data.tool_length, touch), min(1.0, period / settings.incision_s),
            settings.patience_ticks, (settings.rcm_warning_m, settings.rcm_error_m),
            (settings.trocar_force_warning_N, settings.trocar_force_N),
        )  # fmt: skip
        self._limit = _LIMIT.code
        self._bind(data, period)
        self._forget(np.zeros(data.n), np.zeros(data.n))

    def _bind(self, data: RobotData, period: float) -> None:
        settings, motion, inside = self.settings, self._motion, self._incision
        bounds = np.array([data.v_max * period, settings.speed_factor * data.v_max])
        joints, mount, tip = self._place or (np.zeros((0, 16)), np.zeros((0, 3)), np.zeros(3))
        self.memory = tick.SafetyMemory(
            settings.jump_rad, period, settings.patience_ticks, self._step, min(1.0, period / settings.tip_error_s),
            settings.tip_error_m**2, motion.settling, bounds, self._limits, self._wall, motion.levels, motion.held,
            motion.most_replayed, motion.clock, self._counts, self._believed, motion.memory, motion.still, motion.tip,
            self._square, motion.seen, motion.count, motion.joints_seen, motion.joints_count, joints, mount,
            np.array(tip), inside.tool, inside.lowest, inside.means, inside.point,
        )  # fmt: skip
        self._before = partial(tick.BEFORE.code, self.memory)
        self._after = partial(tick.AFTER.code, self.memory, _NONE)

    def _forget(self, q: Array, v: Array, stamp: int = 0) -> None:
        self._believed[0], self._believed[1] = q, v
        self._counts[:], self._square[:] = 0, 0.0
        self.limited, self.reason, self._yields = 0, "", False
        self._press, self._borne, self._open = 0.0, 0.0, 0
        self._motion.start(q, v, stamp)
        self._incision.forget()

    def start(self, q: Array, v: Array, stamp: int = 0) -> None:
        """Begin at the first measurement, number ``stamp``, and run every compiled check once, before the loop.

        Raises:
            ControlError: it is not finite.
        """
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            raise ControlError(f"measured q = {q.tolist()}, v = {v.tolist()}: not finite; check the sensors")
        # A joint that starts inside its wall is not pushed out: its wall begins at the start position.
        self._limits[0], self._limits[1] = np.minimum(self._walls[0], q), np.maximum(self._walls[1], q)
        self._forget(q, v, stamp)
        self.check_measurement(q, v, stamp, self._rest, _NO_WRENCH, _NO_TROCAR)
        self.limit_torque(self._rest, self._rest, q, v)
        self.brake_friction(_NO_WRENCH)
        self._forget(q, v, stamp)

    def check_measurement(
        self, q: Array, v: Array, stamp: int | None = None, applied: Array | None = None,
        wrench: Array | None = None, trocar: Array | None = None, found: int | None = None,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Return the measurement, or the last accepted one extrapolated if this one is late or impossible.

        Args:
            q, v: (n,) as measured [rad], [rad/s].
            stamp: number of the control period in which it was taken; None: the arm does not count them.
            applied: (n,) torque that was applied before it [Nm]; None: not known.
            wrench: (6,) force [N] and torque [Nm] of the tool on its mount, tool axes; None: not known.
            trocar: (2, 3) rows P_t, dP_t, as registered: RCM error and trocar force are checked at the pose that is
                believed; None: the arm is in no incision.
            found: by ``safety_tick.before`` of this measurement, where it was called already; None: it is called here.
        """
        parts, on = 0, self._motion.on
        if on and stamp is not None:
            parts += tick.AGE
        if on and applied is not None:
            parts += tick.READING
        if trocar is not None and self._place is not None:
            parts += tick.INCISION
        if found is None:
            found = self._before(
                parts, q, v, 0 if stamp is None else stamp, self._rest if applied is None else applied,
                _NO_WRENCH if wrench is None else wrench, _NO_TROCAR if trocar is None else trocar,
            )  # fmt: skip
        if found == tick.ACCEPTED:  # and nothing else was found
            if parts & tick.INCISION:
                self._incision.reason(0)
            return q, v
        if found & tick.TOO_OLD:
            self.request_stop(f"measurements are more than {self.settings.patience_ticks} ticks late")
        if not found & tick.ACCEPTED and self._counts[tick.BAD] > self.settings.patience_ticks:
            self.request_stop("measurements not believed")
        self.request_stop(WORDS.get(found % tick.INSIDE // tick.WHAT, ""))
        if parts & tick.INCISION:
            self.request_stop(self._incision.reason(found // tick.INSIDE))
        return (q, v) if found & tick.ACCEPTED else (self._believed[0].copy(), self._believed[1].copy())

    @property
    def parts(self) -> tuple[int, int]:
        """What is checked before and after the tick of a controller that shows its state, in an arm's incision."""
        motion, inside = self._motion.on, self._place is not None
        return (
            motion * (tick.AGE + tick.READING) + inside * tick.INCISION, tick.TIP + motion * tick.MOMENTUM
        )  # fmt: skip

    def took(self, ticks: int, limited: int) -> None:
        """Note ticks of compiled steps in which nothing was found, and the joints that were limited in the last one."""
        self._incision.passed(ticks if self._place is not None else 0)
        self.limited = limited

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """Figures above their warning level since the start: ``of``, ``first_s``, ``largest``, ``unit``, ``level``."""
        return self._incision.warnings(self._period)

    @property
    def bad_ticks(self) -> int:
        """Number of measurements in a row that were not accepted."""
        return int(self._counts[tick.BAD])

    @property
    def stopped(self) -> bool:
        """Whether a stop was requested; only ``start`` ends it."""
        return bool(self.reason)

    def request_stop(self, reason: str) -> None:
        """Request the stop; the first reason stays, and an empty one is none."""
        self.reason = self.reason or reason

    def limit_torque(
        self, tau: Array, before: Array, q: Array, v: Array, tip_ref: Array | None = None,
        state: RobotState | None = None, tip: Array | None = None, found: int | None = None,
    ) -> Array:  # fmt: skip
        """Return the torque (n,) [Nm] within the limits; ``limited`` counts the joints at which they acted.

        A torque that is not finite requests the stop, and ``before`` is returned. With it, the tip's distance from its
        reference is checked, and the motion at (q, v) compared with the torque that was applied before it.

        Args:
            tau, before: (n,) as asked for, and as applied last [Nm].
            q, v: (n,) believed [rad], [rad/s].
            tip_ref: (3, 3) rows X_d, dX_d, ddX_d [m]; None: the tip is not checked.
            state: of (q, v), if the controller provides it; None: it is computed.
            tip: (3,) as the controller computes it [m]; None: that of its state.
            found: by ``safety_tick.after``, if it has limited ``tau`` already; None: it is called here.
        """
        parts, record = 0, _NONE if state is None else state.record
        if tip_ref is not None and not (tip is None and state is None):
            parts += tick.TIP
        if self._motion.on and not (state is None and self._state is None):
            parts += tick.MOMENTUM
            if state is None and self._state is not None:
                record = self._state(q, v).record
        tau = np.array(tau, dtype=np.float64)
        if found is None:
            told = _NO_REFERENCE if tip_ref is None else tip_ref
            found = self._after(parts, q, v, before, record, _NONE if tip is None else tip, told, tau)
        self.limited = found // tick.INSIDE - 2
        if found % tick.INSIDE:
            if found & tick.OFF_REFERENCE:
                self.request_stop(f"the tip has been {1e3 * self.settings.tip_error_m:g} mm off its reference")
            self.request_stop(WORDS.get(found % tick.INSIDE // tick.WHAT, ""))
        if self.limited == _NEEDS_HOLD:
            self.limited = self._limit(tau, before, q, v, self._weight(q), self._limits, self._wall, self._step)
        if self.limited == _NOT_FINITE:
            self.limited = 0
            self.request_stop("the controller's torque is not finite")
            return before
        return tau

    def stop_torque(self, before: Array) -> Array:
        """Return the torque (n,) [Nm] of a damped stop: the weight of the arm in the last pose that was accepted.

        The last torque would continue the push of the levels at that moment.
        """
        self.limited = 0
        weight = self._weight(self._believed[0])
        if not np.isfinite(weight).all():
            return self._rest  # the weight is not known: only the brakes hold the arm
        wanted = np.clip(weight, -self._limits[3], self._limits[3])
        return before + np.clip(wanted - before, -self._step, self._step)

    def brake_friction(self, wrench: Array) -> Array:
        """Return the dry friction (n,) [Nm] of the brakes in a stop; zero while the trocar presses the shaft hard.

        Closed brakes hold the arm against the tissue's push, so the force stays; with open brakes the arm sinks under
        a load that is missing in its model. So they open at ``stop_yield_N``, close again at half of it or after
        ``stop_yield_s``, and open once more if the force has risen by as much again since. They stay closed if the
        drives cannot carry the weight.

        Args:
            wrench: (6,) force [N] and torque [Nm] of the tool on its mount, tool axes.
        """
        level, friction = self.settings.stop_yield_N, np.zeros(self._rest.size)
        weight = self._weight(self._believed[0])
        weight = weight if np.isfinite(weight).all() else self._rest
        if self._place is not None and level is not None and (np.abs(weight) <= self._limits[3]).all():
            # A mean: in the first moments the sensor also shows the tool's inertia force.
            pose = np.empty((4, 3))
            tool_pose(self._place.joints, self._believed[0], self._place.mount, np.array(self._place.tip), pose)
            force = self._incision.pressed(pose, wrench)
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
