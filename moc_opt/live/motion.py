"""Reference and trocar of a live run: the reference goes along its path and back, the trocar to its set place."""

from __future__ import annotations

import math

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.tasks import Reference, Trocar

SLOWLY_M_PER_S = 0.02
"""How fast the trocar follows what it is told: a jump would be a blow."""


class ToAndFro:
    """A reference that goes along its path, rests, comes back the same way, rests, and so on for ever."""

    def __init__(self, reference: Reference, duration_s: float) -> None:
        """`duration_s`: one way, rests included [s]."""
        self._reference, self._duration = reference, duration_s

    def rows(self, t: float) -> Array:
        """Return X_d, dX_d, ddX_d as the rows of one (3, 3) array, at a time [s]."""
        lap, within = divmod(t, self._duration)
        if int(lap) % 2 == 0:
            return self._reference.rows(within)
        rows = self._reference.rows(self._duration - within)
        rows[1] *= -1.0  # backwards in time: the velocity turns round, the acceleration does not
        return rows


class MovingTrocar:
    """A trocar whose place, and breath, can be changed while it moves.

    P(t) = point + offset + amplitude (1 - cos(phase)) / 2 direction, as `Trocar`; offset and amplitude go to what
    they are told at `SLOWLY_M_PER_S`, and the phase goes on whatever the period becomes.
    """

    def __init__(self, trocar: Trocar) -> None:
        self._point, self._direction = np.array(trocar.point), np.array(trocar.direction)
        self.offset, self.amplitude = np.zeros(3), trocar.breathing_amplitude_m
        self.period_s = trocar.breathing_period_s
        self._offset, self._amplitude, self._phase = np.zeros(3), trocar.breathing_amplitude_m, 0.0

    def step(self, seconds: float) -> Array:
        """Return P_t and dP_t as rows (2, 3) for a period that begins now; then that period goes by."""
        rate = 2.0 * math.pi / self.period_s
        away = self.offset - self._offset
        far = float(np.linalg.norm(away))
        shift = away * min(1.0, SLOWLY_M_PER_S * seconds / far) if far > 0.0 else np.zeros(3)
        most = SLOWLY_M_PER_S * seconds
        swell = min(max(self.amplitude - self._amplitude, -most), most)
        breath = 0.5 * (1.0 - math.cos(self._phase))
        point = self._point + self._offset + self._amplitude * breath * self._direction
        speed = 0.5 * self._amplitude * rate * math.sin(self._phase) + swell / seconds * breath
        rows = np.array([point, shift / seconds + speed * self._direction])
        self._offset = self._offset + shift
        self._amplitude += swell
        self._phase = math.fmod(self._phase + rate * seconds, 2.0 * math.pi)
        return rows


class MovingTrocars:
    """The trocar as it is and as it was registered, moved together.

    Args:
        true, registered: where they are before anything is ordered.
        breathing_known: whether the registered one breathes with the true one.
    """

    def __init__(self, true: Trocar, registered: Trocar, breathing_known: bool) -> None:
        self._given, self._breathing_known = (true, registered), breathing_known
        self._true, self._registered = MovingTrocar(true), MovingTrocar(registered)

    def move(self, offset: Array | None = None, amplitude: float | None = None, period_s: float | None = None) -> None:
        """Order another offset (3,) [m], breathing amplitude [m] or period [s]; None: as it is."""
        for trocar in (self._true, self._registered):
            trocar.offset = trocar.offset if offset is None else offset
            if trocar is self._true or self._breathing_known:
                trocar.amplitude = trocar.amplitude if amplitude is None else amplitude
                trocar.period_s = trocar.period_s if period_s is None else period_s

    def restart(self) -> None:
        """Go back to where they were at first; orders stay."""
        told = self._true
        self._true, self._registered = (MovingTrocar(trocar) for trocar in self._given)
        self.move(told.offset, told.amplitude, told.period_s)

    def step(self, seconds: float) -> tuple[Array, Array]:
        """Return rows (2, 3) P_t, dP_t of both for a period that begins now; then that period goes by."""
        return self._true.step(seconds), self._registered.step(seconds)
