"""A reference that can wait: it slows down to a stop when it may not go on, and speeds up again when it may.

Nothing jumps: with the path time tau running at the rate sigma in [0, 1],

    X_d(t) = X(tau(t)) + d,   dX_d = sigma X' + w,   ddX_d = sigma^2 X'' + sigma' X' + a

so |dX_d| <= v_max + |w| and |ddX_d| <= a_max + v_max |sigma'| + |a|. The rate is the yes-or-no of each tick sent
through two moving averages: it never leaves [0, 1], is exactly 0 (or 1) once the answer has stood for their
length, and its slope is at most one over the longer of them. d is an optional shift of the whole path, for a task
whose board has moved, that follows its target with bounded speed w and acceleration a.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import TaskError
from moc_opt.numerics.arrays import Array
from moc_opt.tasks.checks import Vector, positive, vector3
from moc_opt.tasks.sequence import TipReference


class WaitingReference:
    """Plays a reference tick by tick, waiting while it is told to; it begins at rest, at the start of the path."""

    def __init__(
        self,
        reference: TipReference,
        period_s: float,
        *,
        brake_m_per_s2: float | None = None,
        shift_v_max: float = 0.005,
        shift_a_max: float = 0.02,
        shift_rate_per_s: float = 3.0,
    ) -> None:
        """Stand at the start.

        Args:
            period_s: time from tick to tick [s].
            brake_m_per_s2: what stopping and starting again may add to the acceleration [m/s^2]; None: as much
                as the reference itself may use.
            shift_v_max: largest speed of the shift [m/s].
            shift_a_max: largest acceleration of the shift [m/s^2].
            shift_rate_per_s: how fast a small shift is taken up (critically damped) [rad/s].

        Raises:
            TaskError: a number is not positive and finite, or the shift's rate is too fast for the period.
        """
        self.reference = reference
        self.period_s = positive("period_s", period_s)
        brake = reference.a_max if brake_m_per_s2 is None else positive("brake_m_per_s2", brake_m_per_s2)
        # Rounded up: a longer average is a gentler one.
        long = max(1, math.ceil(reference.v_max / brake / self.period_s - 1e-9))
        self.brake_s = long * self.period_s
        """Length of the longer average [s]: one over the steepest slope of the rate."""
        self._first, self._second = _MovingAverage(long), _MovingAverage(max(1, long // 2))
        self._shift_v, self._shift_a = (positive("shift_v_max", shift_v_max), positive("shift_a_max", shift_a_max))
        self._shift_rate = positive("shift_rate_per_s", shift_rate_per_s)
        if 2.0 * self._shift_rate * self.period_s > 1.0:
            raise TaskError(
                f"shift_rate_per_s = {shift_rate_per_s!r} is too fast for a period of {period_s!r} s: "
                f"give {0.5 / self.period_s:g} or less"
            )
        self.start()

    @property
    def settle_s(self) -> float:
        """Time from the last change of the answer until the path rests, or runs at its full rate [s]."""
        return (self._first.length + self._second.length) * self.period_s

    @property
    def v_bound(self) -> float:
        """No speed is above this [m/s] while no shift is given; a shift adds at most `shift_v_max`."""
        return self.reference.v_max

    @property
    def a_bound(self) -> float:
        """No acceleration is above this [m/s^2] while no shift is given; a shift adds at most `shift_a_max`."""
        return self.reference.a_max + self.reference.v_max / self.brake_s

    def start(self) -> None:
        """Go back to the start of the path, at rest, without a shift."""
        self._first.fill(0.0)
        self._second.fill(0.0)
        self.path_time = 0.0
        """tau: how far the reference has been played [s]."""
        self.rate = 0.0
        """sigma: path seconds per second, 0 to 1."""
        self._d, self._w, self._target, self._shifted = np.zeros(3), np.zeros(3), np.zeros(3), False

    @property
    def done(self) -> bool:
        """Whether the end of the path has been reached."""
        return self.path_time >= self.reference.t_start + self.reference.duration

    @property
    def progress(self) -> float:
        """Share of the reference's duration that has been played, 0 to 1."""
        return min(max((self.path_time - self.reference.t_start) / self.reference.duration, 0.0), 1.0)

    @property
    def shift(self) -> Vector:
        """d (3,) [m]."""
        return self._d.copy()

    def step(self, go_on: bool, shift: ArrayLike | None = None) -> Array:
        """Return the reference of this tick, and go on to the next one.

        Args:
            go_on: whether the path may go on; told wrongly, or on and off at every tick, it is only slower.
            shift: (3,) where the whole path should be moved to [m]; None: as last told.

        Returns:
            (3, 3) rows X_d [m], dX_d [m/s], ddX_d [m/s^2] at the start of the tick.

        Raises:
            TaskError: the shift is no vector of three finite numbers.
        """
        if shift is not None:
            self._target = np.array(vector3("shift", shift))
            self._shifted = self._shifted or bool(self._target.any())
        dt, rate = self.period_s, self.rate
        later = self._second.push(self._first.push(1.0 if go_on else 0.0))
        slope = (later - rate) / dt
        x, v, a = self.reference.rows(self.path_time)
        rows = np.array([x, rate * v, rate * rate * a + slope * v])
        if self._shifted:
            rows += self._shift_on()
        # Exact for a rate that is a straight line, and an acceleration that is constant, over the tick.
        self.path_time += 0.5 * dt * (rate + later)
        self.rate = later
        return rows

    def play(self, go_on: ArrayLike, shifts: ArrayLike | None = None) -> tuple[Array, Array]:
        """Play it from the start for a whole run.

        Args:
            go_on: (N,) flags, one a tick.
            shifts: (N, 3) [m], or None.

        Returns:
            rows (N, 3, 3) as `step` gives them, and the path time (N,) [s] at each tick.

        Raises:
            TaskError: shapes do not fit, or a shift is not finite.
        """
        flags = np.asarray(go_on)
        if flags.ndim != 1 or flags.dtype != np.bool_:
            raise TaskError(f"go_on is {flags.dtype} of shape {flags.shape}: give flags (N,), one a tick")
        moved = None if shifts is None else np.asarray(shifts, dtype=np.float64)
        if moved is not None and moved.shape != (len(flags), 3):
            raise TaskError(f"shifts has shape {moved.shape}: give ({len(flags)}, 3), one a tick")
        self.start()
        rows, times = np.empty((len(flags), 3, 3)), np.empty(len(flags))
        for k, flag in enumerate(flags.tolist()):
            times[k] = self.path_time
            rows[k] = self.step(flag, None if moved is None else moved[k])
        return rows, times

    def _shift_on(self) -> Array:
        """d, w and a of this tick as rows (3, 3), and on to the next one.

        a = rate^2 (target - d) - 2 rate w, its parts cut to their bounds. The speed is drawn towards a wish that
        is never faster than allowed, and a step goes only part of the way there, so it stays in the same ball.
        """
        wish = _cut(0.5 * self._shift_rate * (self._target - self._d), self._shift_v)
        push = _cut(2.0 * self._shift_rate * (wish - self._w), self._shift_a)
        rows = np.array([self._d, self._w, push])
        dt = self.period_s
        self._d = self._d + dt * self._w + 0.5 * dt * dt * push
        self._w = self._w + dt * push
        return rows


class _MovingAverage:
    """Mean of the last `length` numbers."""

    def __init__(self, length: int) -> None:
        self.length = length
        self.fill(0.0)

    def fill(self, value: float) -> None:
        self._values = [value] * self.length
        self._slot = 0

    def push(self, value: float) -> float:
        self._values[self._slot] = value
        self._slot = (self._slot + 1) % self.length
        # Summed anew: a running sum drifts, and a rate of 1e-17 would never be a stop.
        return math.fsum(self._values) / self.length


def _cut(vector: Array, most: float) -> Array:
    """The vector, shortened to `most` where it is longer."""
    length = math.sqrt(float(vector @ vector))
    return vector if length <= most else vector * (most / length)


def flags_at(times: ArrayLike, seen_times: ArrayLike, seen: ArrayLike) -> NDArray[np.bool_]:
    """Carry the camera's answers over to the control ticks: each holds from its picture to the next one.

    Args:
        times: (N,) of the ticks [s].
        seen_times: (k,) of the pictures [s], rising.
        seen: (k,) flags.

    Returns:
        (N,) flags; False before the first picture.

    Raises:
        TaskError: the pictures' times do not rise, or their numbers differ.
    """
    pictures, answers = np.asarray(seen_times, dtype=np.float64), np.asarray(seen, dtype=np.bool_)
    if pictures.ndim != 1 or pictures.shape != answers.shape or (np.diff(pictures) <= 0.0).any():
        raise TaskError("seen_times: give one rising time [s] for each entry of seen")
    # A picture taken at a tick counts for it, whatever the rounding of the two clocks.
    last = np.searchsorted(pictures, np.asarray(times, dtype=np.float64) + 1e-9, side="right")
    return np.concatenate(([False], answers))[last]
