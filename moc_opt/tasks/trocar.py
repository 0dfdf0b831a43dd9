"""The trocar, the point through which the shaft must pass."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.arrays import Array
from moc_opt.errors import TaskError
from moc_opt.tasks.checks import TimeLike, direction3, number, positive, sampled, vector3


@dataclass(frozen=True, eq=False)
class Trocar:
    """A trocar that rests or moves with the breathing.

    P(t) = point + amplitude (1 - cos(2 pi t / period)) / 2 * direction. A TaskError is raised if a field is unusable.
    """

    point: ArrayLike  #: Position at t = 0, (3,) [m].
    breathing_amplitude_m: float = 0.0  #: Largest distance from `point`.
    breathing_period_s: float = 4.0  #: Time of one breath.
    direction: ArrayLike = (0.0, 0.0, 1.0)  #: Direction of the motion (3,), of any length above zero.

    def __post_init__(self) -> None:
        amplitude = number("breathing_amplitude_m", self.breathing_amplitude_m)
        if amplitude < 0.0:
            raise TaskError(f"breathing_amplitude_m = {amplitude!r} is negative: give zero or more")
        point, direction = vector3("point", self.point), direction3("direction", self.direction)
        period = positive("breathing_period_s", self.breathing_period_s)
        for name, value in (
            ("point", point), ("direction", direction), ("breathing_amplitude_m", amplitude),
            ("breathing_period_s", period),
        ):  # fmt: skip
            object.__setattr__(self, name, value)

    def at(self, t: TimeLike) -> tuple[Array, Array]:
        """Return position [m] and velocity [m/s] at t [s]: each (3,), or (k, 3) if t is (k,).

        Raise a TaskError if t is not finite.
        """
        p, dp = sampled("t", t, self._rows)
        return p, dp

    def rows(self, t: float) -> Array:
        """Return position and velocity (2, 3) at a time [s]. Raise a TaskError if it is not finite."""
        return np.asarray(self._rows(np.array([t]))[0])

    def _rows(self, t: Array) -> Array:
        if not np.isfinite(t).all():
            raise TaskError(f"t = {t[~np.isfinite(t)][0]!r} is not a time: give seconds")
        rate = 2.0 * math.pi / self.breathing_period_s
        turns = (rate * t).tolist()  # one by one, because numpy's vector sine may round differently
        away = self.breathing_amplitude_m * 0.5 * (1.0 - np.array([math.cos(turn) for turn in turns]))
        speed = self.breathing_amplitude_m * 0.5 * rate * np.array([math.sin(turn) for turn in turns])
        point, direction = np.asarray(self.point), np.asarray(self.direction)
        return np.stack([point + away[:, None] * direction, speed[:, None] * direction], axis=1)


def shaft_distance(tip: ArrayLike, wrist: ArrayLike, p: ArrayLike) -> Array:
    """Return the RCM error, the distance |(p - tip) x u| of p from the shaft [m]: (k,) for points (k, 3), () for (3,).

    u is the unit vector from wrist to tip.
    """
    tool = np.subtract(tip, wrist)
    u = tool / np.sqrt((tool * tool).sum(axis=-1, keepdims=True))
    # np.cross takes ten times as long.
    (a, b, c), (d, e, f) = np.moveaxis(np.subtract(p, tip), -1, 0), np.moveaxis(u, -1, 0)
    return np.asarray(np.sqrt((b * f - c * e) ** 2 + (c * d - a * f) ** 2 + (a * e - b * d) ** 2))
