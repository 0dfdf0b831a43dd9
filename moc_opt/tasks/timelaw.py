"""The quintic time law, and a reference that can pause."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.arrays import Array
from moc_opt.errors import TaskError
from moc_opt.tasks.checks import TimeLike, number, positive, sampled
from moc_opt.tasks.paths import Path

Number = TypeVar("Number", float, Array)
_PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)  # largest |d2s/du2| of the quintic law


def quintic(u: Number) -> tuple[Number, Number, Number]:
    """Return s(u) = 10 u^3 - 15 u^4 + 6 u^5, ds/du and d2s/du2 at u in [0, 1]."""
    w = 1.0 - u
    return (u * u * u * (10.0 + u * (-15.0 + 6.0 * u)), 30.0 * u * u * w * w, 60.0 * u * w * (1.0 - 2.0 * u))


def duration(path: Path, v_max: float, a_max: float) -> float:
    """Compute the shortest duration T [s] of the quintic law within the limits.

    D is the path's length, kappa its curvature, u = t/T, s(u) the `quintic`, and s' = ds/du:
        |velocity| = D s'/T                   at most 15 D / (8 T),
        |acceleration| = D g(u) / T^2         with g(u)^2 = s''^2 + (D kappa(D s) s'^2)^2,
    so that T = max(15 D / (8 v_max), sqrt(D max_u g(u) / a_max)).

    Args:
        v_max: largest speed [m/s].
        a_max: largest acceleration [m/s^2], tangential and centripetal together.
    """
    v_max, a_max = positive("v_max", v_max), positive("a_max", a_max)
    return max(15.0 * path.length / (8.0 * v_max), math.sqrt(path.length * _largest_acceleration(path) / a_max))


def _largest_acceleration(path: Path) -> float:
    length = path.length

    def g(u: float) -> float:
        s, ds, dds = quintic(u)
        return math.hypot(dds, length * path.curvature(min(s * length, length)) * ds * ds)

    # g is evaluated at equal steps, which resolve the time law, and at the path's knots, which resolve the bends.
    even = np.linspace(0.0, 1.0, 513)
    progress = [quintic(u)[0] for u in even.tolist()]
    u = np.unique(np.concatenate((even, np.interp(path.knots / length, progress, even))))
    values = np.array([g(entry) for entry in u.tolist()])
    inner = values[1:-1]
    peaks = 1 + np.flatnonzero((inner >= values[:-2]) & (inner >= values[2:]) & (inner > 0.8 * values.max()))
    return max(_PEAK_ACCELERATION, float(values.max()), *(_climb(g, u[p - 1], u[p + 1]) for p in peaks.tolist()))


def _climb(g: Callable[[float], float], lower: float, upper: float) -> float:
    best = 0.0
    for _ in range(6):
        u = np.linspace(lower, upper, 17)
        values = [g(entry) for entry in u.tolist()]
        top = int(np.argmax(values))
        best = max(best, values[top])
        lower, upper = float(u[max(top - 1, 0)]), float(u[min(top + 1, 16)])
    return best


@dataclass(frozen=True, eq=False)
class Reference:
    """The tip reference X_d, dX_d, ddX_d: the quintic law along a path.

    A TaskError is raised if a limit is not positive and finite, or if t_start is not finite.
    """

    path: Path
    v_max: float  #: Largest speed [m/s].
    a_max: float  #: Largest acceleration [m/s^2].
    t_start: float = 0.0  #: Start of the motion [s].
    duration: float = field(init=False)  #: [s]

    def __post_init__(self) -> None:
        for name, value in (
            ("v_max", positive("v_max", self.v_max)), ("a_max", positive("a_max", self.a_max)),
            ("t_start", number("t_start", self.t_start)), ("duration", duration(self.path, self.v_max, self.a_max)),
        ):  # fmt: skip
            object.__setattr__(self, name, value)

    def at(self, t: TimeLike) -> tuple[Array, Array, Array]:
        """Return X_d [m], dX_d [m/s] and ddX_d [m/s^2] at t [s]: each (3,), or (k, 3) if t is (k,).

        The reference rests before and after its motion. Raise a TaskError if t is NaN or unusable.
        """
        x, dx, ddx = sampled("t", t, self._rows)
        return x, dx, ddx

    def rows(self, t: float) -> Array:
        """Return X_d, dX_d, ddX_d (3, 3) at one time [s]; a TaskError if it is NaN."""
        return np.asarray(self._rows(np.array([t]))[0])

    def _rows(self, t: Array) -> Array:
        u = (t - self.t_start) / self.duration
        if np.isnan(u).any():
            raise TaskError(f"t = {t[np.isnan(u)][0]!r} is not a time: give seconds")
        length = self.path.length
        progress, ds, dds = quintic(np.clip(u, 0.0, 1.0))
        v, a = ds * length / self.duration, dds * length / (self.duration * self.duration)
        x, tangent, bend = np.swapaxes(self.path.points(np.minimum(progress * length, length)), 0, 1)
        v, a = v[:, None], a[:, None]
        return np.stack([x, v * tangent, a * tangent + v * v * bend], axis=1)


class WaitingReference:
    """A reference that stops while a flag is False, and goes on when it is True. It begins at rest.

    tau is the time along the given reference X. Its rate sigma = dtau/dt is the flag (0 or 1), filtered by two moving
    averages, so that X_d, dX_d and ddX_d do not jump:

        X_d(t) = X(tau(t)),   dX_d = sigma dX/dtau,   ddX_d = sigma^2 d2X/dtau2 + dsigma/dt dX/dtau

    with |dX_d| <= v_max and |ddX_d| <= 2 a_max for the limits of the given reference.
    """

    def __init__(self, reference: Reference, period_s: float) -> None:
        """``period_s`` is the control period [s]. Raise a TaskError if it is not positive."""
        self.reference, self.period_s = reference, positive("period_s", period_s)
        # Rounded up, so that the rate changes no faster than a_max / v_max.
        long = max(1, math.ceil(reference.v_max / reference.a_max / self.period_s - 1e-9))
        self._lengths = long, max(1, long // 2)
        self.settle_s = sum(self._lengths) * self.period_s
        """Time from the last change of the flag until the rate is 0 or 1 [s]."""

    def play(self, go_on: ArrayLike) -> tuple[Array, Array]:
        """Return X_d, dX_d, ddX_d as rows (N, 3, 3), and tau (N,) [s], for one flag per tick, go_on (N,).

        Raise a TaskError if the flags are not boolean.
        """
        flags = np.asarray(go_on)
        if flags.ndim != 1 or flags.dtype != np.bool_:
            raise TaskError(f"go_on is {flags.dtype} of shape {flags.shape}: give flags (N,), one per tick")
        later = flags.astype(np.float64)  # the rate at the end of each tick
        for length in self._lengths:
            later = np.convolve(later, np.ones(length))[: len(flags)] / length
        rate = np.concatenate([[0.0], later])[: len(flags)]
        # The trapezoidal rule is exact, because the rate is linear within a tick.
        times = np.concatenate([[0.0], np.cumsum(0.5 * self.period_s * (rate + later))])[: len(flags)]
        x, v, a = self.reference.at(times)
        slope = (later - rate) / self.period_s
        return np.stack([x, rate[:, None] * v, (rate * rate)[:, None] * a + slope[:, None] * v], axis=1), times


def flags_at(times: ArrayLike, seen_times: ArrayLike, seen: ArrayLike) -> NDArray[np.bool_]:
    """Return for each tick the flag of the camera's latest picture, (N,); False before the first picture.

    Args:
        times: (N,) times of the ticks [s].
        seen_times: (k,) times of the pictures [s]; a TaskError if they do not rise.
        seen: (k,) flags of the pictures.
    """
    pictures, answers = np.asarray(seen_times, dtype=np.float64), np.asarray(seen, dtype=np.bool_)
    if pictures.ndim != 1 or pictures.shape != answers.shape or (np.diff(pictures) <= 0.0).any():
        raise TaskError("seen_times: give one time [s] for each entry of seen, in rising order")
    # Rounding may make a picture's time slightly later than its tick.
    last = np.searchsorted(pictures, np.asarray(times, dtype=np.float64) + 1e-9, side="right")
    return np.concatenate(([False], answers))[last]
