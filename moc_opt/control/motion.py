"""Old, repeated and frozen measurements: how old each one is, and whether it shows the arm that the torque went to."""

from __future__ import annotations

from functools import partial

import numpy as np
from numba import float64, int64
from numpy.typing import NDArray

from moc_opt.control import motion_kernels as kernels
from moc_opt.control import replay_kernels as replays
from moc_opt.control.safety_settings import MotionSettings
from moc_opt.model.robot_state import RobotState
from moc_opt.numerics.compiled import INDICES, MATRIX, VECTOR, CompiledKernel

Array = NDArray[np.float64]

_READINGS = CompiledKernel(
    kernels.compare_readings, int64, VECTOR, VECTOR, MATRIX, *[VECTOR] * 6, float64
)
_REPLAYED = CompiledKernel(replays.count_replayed, VECTOR, VECTOR, VECTOR, MATRIX, VECTOR)
SETTLED = 6.0  # time constants of the residual after which it is what it will be

_AGE = CompiledKernel(kernels.age, int64, int64, INDICES)
_MOMENTUM = CompiledKernel(
    kernels.compare_momentum, int64, VECTOR, VECTOR, MATRIX, VECTOR, float64, VECTOR, VECTOR, int64
)


class MotionMonitor:
    """Check age and motion of one arm's measurements.

    Args:
        settings: the levels.
        period: control period [s].
        patience: ticks.
        tau_max: (n,) [Nm].
        coulomb: (n,) Coulomb friction as the robot's file tells it [Nm], 0 where it does not; None: nowhere.
    """

    def __init__(
        self, settings: MotionSettings, period: float, patience: int, tau_max: Array, coulomb: Array | None = None
    ) -> None:
        self._held = settings.held(tau_max, np.zeros(len(tau_max)) if coulomb is None else coulomb)
        self._period, self._patience, self._tau_max = period, patience, np.array(tau_max)
        self._settling = round(SETTLED / (settings.residual_rate_per_s * period))
        self._levels, self._on = settings.levels, settings.motion
        self._age = _AGE.code
        self._replayed = _REPLAYED.code
        self._most_replayed = (settings.replayed_ticks(len(tau_max)), float(settings.repeat_whole_ticks))
        self._no_wrench = np.full(6, np.nan)
        self._n = self._tau_max.size
        self._rest = np.zeros(self._n)
        self.start(np.zeros(self._n), np.zeros(self._n), 0)

    def start(self, q: Array, v: Array, stamp: int) -> None:
        """Begin at a measurement; the next one may be the same."""
        self._clock = np.array([stamp - 1, stamp - 1, -2], dtype=np.int64)
        self._memory = np.zeros((kernels.ROWS, self._n))
        self._memory[kernels.SHOWN], self._memory[kernels.PEAK], self._memory[kernels.REPEATS] = q, np.abs(v), -1.0
        self._still = np.zeros(12)
        self._seen, self._count = np.zeros((2, replays.SLOTS)), np.zeros(3)
        fixed = (self._patience, self._tau_max, self._levels, self._memory)
        self._readings = partial(_READINGS.code, *fixed, self._still)
        self._momentum = partial(_MOMENTUM.code, *fixed, self._held, self._period)
        self._checked, self._ticks = 0, 0  # control periods since the last reading that was looked at
        self._tip = np.zeros(3)

    def age(self, stamp: int) -> int:
        """Return FRESH, REPEAT or OLD; see ``motion_kernels.age``."""
        if not self._on:
            return kernels.FRESH
        before = int(self._clock[1])
        found = int(self._age(stamp, self._patience, self._clock))
        self._ticks += int(self._clock[1]) - before
        return found

    def set_reference(self, tip_ref: Array) -> None:
        """Note the tip's reference, (3, 3) rows X_d, dX_d, ddX_d."""
        self._tip[:] = tip_ref[0]

    def check_reading(self, q: Array, v: Array, tau: Array, wrench: Array | None = None) -> str:
        """Check a new reading, taken after the torque (n,) [Nm] was applied; return what is wrong with it, or ""."""
        if not self._on:
            return ""
        wrench = self._no_wrench if wrench is None else wrench
        found = self._readings(q, v, tau, wrench, self._tip, self._period * max(1, self._ticks))
        self._ticks = 0
        came_before = self._replayed(q, v, wrench, self._seen, self._count)
        if came_before > self._most_replayed[kernels.has_noise(self._still)]:
            return "the measurements are a recording: they came before, to the last bit"
        if found == kernels.NOTHING:
            return ""
        if found == kernels.ONE_REPEATED:
            return "one encoder repeats its reading, as its noise does not let it"
        if found == kernels.REPEATED:
            return "all encoders repeat one reading, as no arm that moves or has noise does"
        return "the encoders' positions do not follow their velocities"

    def check_momentum(self, state: RobotState, tau: Array) -> str:
        """Compare the motion of an accepted measurement with the torque; return what is wrong with it, or "".

        Args:
            state: of the measurement.
            tau: (n,) torque that was applied before it [Nm].
        """
        if not self._on:
            return ""
        self._checked += 1
        if self._checked == 1:
            self._memory[kernels.INTEGRAL] = state.M @ state.v
            return ""
        found = self._momentum(state.record, tau, int(self._checked > self._settling))
        if found == kernels.NOTHING:
            return ""
        if found == kernels.STUCK:
            return "an encoder repeats one reading while torque acts on its joint"
        return "the torque went into a motion that the encoders do not show"
