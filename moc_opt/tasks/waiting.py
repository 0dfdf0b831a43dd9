"""A reference that can wait: it slows down to a stop when it may not go on, and speeds up again when it may.

Nothing jumps: with the path time tau running at the rate sigma in [0, 1],

    X_d(t) = X(tau(t)),   dX_d = sigma X',   ddX_d = sigma^2 X'' + sigma' X'

so |dX_d| <= v_max and |ddX_d| <= a_max + v_max |sigma'|. The rate is the yes-or-no of each tick sent through two
moving averages: it never leaves [0, 1], is exactly 0 (or 1) once the answer has stood for their length, and its slope
is at most one over the longer of them.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.arrays import Array
from moc_opt.errors import TaskError
from moc_opt.tasks.checks import positive
from moc_opt.tasks.timelaw import Reference


class WaitingReference:
    """Plays a reference tick by tick, waiting while it is told to; it begins at rest, at the start of the path."""

    def __init__(self, reference: Reference, period_s: float, *, brake_m_per_s2: float | None = None) -> None:
        """Begin at the start; a TaskError where a number is not positive and finite.

        Args:
            period_s: time from tick to tick [s].
            brake_m_per_s2: what stopping and starting again may add to the acceleration [m/s^2]; None: as much
                as the reference itself may use.
        """
        self.reference = reference
        self.period_s = positive("period_s", period_s)
        brake = reference.a_max if brake_m_per_s2 is None else positive("brake_m_per_s2", brake_m_per_s2)
        # Rounded up: a longer average is a gentler one.
        long = max(1, math.ceil(reference.v_max / brake / self.period_s - 1e-9))
        self._lengths = long, max(1, long // 2)
        self.brake_s = long * self.period_s  #: length of the longer average: one over the rate's steepest slope [s]
        self.settle_s = sum(self._lengths) * self.period_s
        """Time from the last change of the answer until the path rests, or runs at its full rate [s]."""
        self.start()

    def start(self) -> None:
        """Go back to the start of the path, at rest."""
        self._averages = [deque([0.0] * length, maxlen=length) for length in self._lengths]
        self.path_time = 0.0  #: tau: how far the reference has been played [s]
        self.rate = 0.0  #: sigma: path seconds per second, 0 to 1

    def step(self, go_on: bool) -> Array:
        """Return X_d [m], dX_d [m/s], ddX_d [m/s^2], the rows of (3, 3), at the start of the tick; go on to the next.

        Args:
            go_on: whether the path may go on; told wrongly, or on and off at every tick, it is only slower.
        """
        dt, rate, later = self.period_s, self.rate, 1.0 if go_on else 0.0
        for values in self._averages:  # summed anew: a running sum drifts, and a rate of 1e-17 would never be a stop
            values.append(later)
            later = math.fsum(values) / len(values)
        x, v, a = self.reference.rows(self.path_time)
        rows = np.array([x, rate * v, rate * rate * a + (later - rate) / dt * v])
        # Exact for a rate that is a straight line, and an acceleration that is constant, over the tick.
        self.path_time += 0.5 * dt * (rate + later)
        self.rate = later
        return rows

    def play(self, go_on: ArrayLike) -> tuple[Array, Array]:
        """Play it from the start with the flags go_on (N,), one a tick; a TaskError where these are no flags.

        Returns:
            rows (N, 3, 3) as `step` gives them, and the path time (N,) [s] at each tick.
        """
        flags = np.asarray(go_on)
        if flags.ndim != 1 or flags.dtype != np.bool_:
            raise TaskError(f"go_on is {flags.dtype} of shape {flags.shape}: give flags (N,), one a tick")
        self.start()
        rows, times = np.empty((len(flags), 3, 3)), np.empty(len(flags))
        for k, flag in enumerate(flags.tolist()):
            times[k] = self.path_time
            rows[k] = self.step(flag)
        return rows, times


def flags_at(times: ArrayLike, seen_times: ArrayLike, seen: ArrayLike) -> NDArray[np.bool_]:
    """Carry the camera's answers over to the control ticks: each holds from its picture to the next one.

    Args:
        times: (N,) of the ticks [s].
        seen_times: (k,) of the pictures [s], rising; a TaskError where they do not.
        seen: (k,) flags.

    Returns:
        (N,) flags; False before the first picture.
    """
    pictures, answers = np.asarray(seen_times, dtype=np.float64), np.asarray(seen, dtype=np.bool_)
    if pictures.ndim != 1 or pictures.shape != answers.shape or (np.diff(pictures) <= 0.0).any():
        raise TaskError("seen_times: give one rising time [s] for each entry of seen")
    # A picture taken at a tick counts for it, whatever the rounding of the two clocks.
    last = np.searchsorted(pictures, np.asarray(times, dtype=np.float64) + 1e-9, side="right")
    return np.concatenate(([False], answers))[last]
