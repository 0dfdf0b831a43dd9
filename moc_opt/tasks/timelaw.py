"""The quintic time law along a path, and the shortest duration within limits of speed and acceleration."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from moc_opt.errors import TaskError
from moc_opt.tasks.checks import TimeLike, Vector, number, positive, sampled
from moc_opt.tasks.paths import Path

_PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)


def quintic(u: Any) -> tuple[Any, Any, Any]:
    """Return s(u) = 10 u^3 - 15 u^4 + 6 u^5, ds/du and d2s/du2 at u in [0, 1], a number or an array."""
    w = 1.0 - u
    return (u * u * u * (10.0 + u * (-15.0 + 6.0 * u)), 30.0 * u * u * w * w, 60.0 * u * w * (1.0 - 2.0 * u))


def duration(path: Path, v_max: float, a_max: float) -> float:
    """Compute the shortest duration T [s] of the quintic law with |velocity| <= v_max and |acceleration| <= a_max.

    With D the length, kappa the curvature and s = s(u), u = t/T:
        |velocity| = D s'/T                   at most 15 D / (8 T),
        |acceleration| = D g(u) / T^2         with g(u)^2 = s''^2 + (D kappa(D s) s'^2)^2,
    so T = max(15 D / (8 v_max), sqrt(D max g / a_max)): g does not depend on T. A straight path has
    max g = 10/sqrt(3).

    Args:
        v_max: largest speed [m/s].
        a_max: largest acceleration [m/s^2], tangential and centripetal together.

    Raises:
        TaskError: a limit is not positive and finite.
    """
    v_max, a_max = positive("v_max", v_max), positive("a_max", a_max)
    at_speed = 15.0 * path.length / (8.0 * v_max)
    bends = any(path.curvature(s) != 0.0 for s in path.knots.tolist())
    if not bends:
        return max(at_speed, math.sqrt(10.0 * path.length / (math.sqrt(3.0) * a_max)))
    return max(at_speed, math.sqrt(path.length * _largest_acceleration(path) / a_max))


def _largest_acceleration(path: Path) -> float:
    """Return the largest g(u) of `duration`, to about 1e-10 of itself."""
    length = path.length

    def g(u: float) -> float:
        s, ds, dds = quintic(u)
        return math.hypot(dds, length * path.curvature(min(s * length, length)) * ds * ds)

    # Even steps see the time law's own peaks; the curve's knots, taken back to u, see every bend of the path.
    even = np.linspace(0.0, 1.0, 513)
    progress = [quintic(u)[0] for u in even.tolist()]
    u = np.unique(np.concatenate((even, np.interp(path.knots / length, progress, even))))
    values = np.array([g(entry) for entry in u.tolist()])
    inner = values[1:-1]
    peaks = 1 + np.flatnonzero((inner >= values[:-2]) & (inner >= values[2:]) & (inner > 0.8 * values.max()))
    best = max(_PEAK_ACCELERATION, float(values.max()))
    for peak in peaks.tolist():
        best = max(best, _climb(g, u[peak - 1], u[peak + 1]))
    return best


def _climb(g: Callable[[float], float], lower: float, upper: float) -> float:
    """Return the largest g between two points that have one peak between them."""
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
    """The tip reference X_d, dX_d, ddX_d over time: a path at the quintic law, in the shortest allowed time.

    Args:
        path: where to go.
        v_max: largest speed [m/s].
        a_max: largest acceleration [m/s^2], tangential and centripetal together.
        t_start: when to leave the start [s].

    Raises:
        TaskError: a limit is not positive and finite, or t_start is not finite.
    """

    path: Path
    v_max: float
    a_max: float
    t_start: float = 0.0
    duration: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "v_max", positive("v_max", self.v_max))
        object.__setattr__(self, "a_max", positive("a_max", self.a_max))
        object.__setattr__(self, "t_start", number("t_start", self.t_start))
        object.__setattr__(self, "duration", duration(self.path, self.v_max, self.a_max))

    def at(self, t: TimeLike) -> tuple[Vector, Vector, Vector]:
        """Return point, velocity and acceleration of the reference.

        Before t_start it rests at the start of the path, after t_start + duration at its end.

        Args:
            t: time [s], a number or a vector (k,).

        Returns:
            x [m], dx [m/s], ddx [m/s^2]; each (3,), or (k, 3) for a vector, with the same bits either way.

        Raises:
            TaskError: t is no number or vector, or NaN.
        """
        x, dx, ddx = sampled("t", t, self.rows, self._columns)
        return x, dx, ddx

    def _columns(self, t: Vector) -> Vector:
        """Compute ``rows`` at times (k,) as (3, k, 3)."""
        u = (t - self.t_start) / self.duration
        u[u <= 0.0], u[u >= 1.0] = 0.0, 1.0
        if np.isnan(u).any():
            raise TaskError(f"t = {float(t[np.isnan(u)][0])!r} is not a time: give seconds")
        s = np.minimum(quintic(u)[0] * self.path.length, self.path.length)
        return np.moveaxis(np.array(self._motion(u, self.path.points(s))), 2, 1)

    def _motion(self, u: Any, place: tuple[Any, ...]) -> tuple[tuple[Any, Any, Any], ...]:
        """Return X_d, dX_d, ddX_d at u, where the path has the nine numbers ``place``; numbers, or arrays of them."""
        length = self.path.length
        _, ds, dds = quintic(u)
        v, a = ds * length / self.duration, dds * length / (self.duration * self.duration)
        x, y, z, tx, ty, tz, cx, cy, cz = place
        c = v * v
        return (x, y, z), (v * tx, v * ty, v * tz), (a * tx + c * cx, a * ty + c * cy, a * tz + c * cz)

    def rows(self, t: float) -> Vector:
        """Return X_d, dX_d, ddX_d as the rows of one (3, 3) array, for one time [s].

        Raises:
            TaskError: t is NaN.
        """
        u = (t - self.t_start) / self.duration
        if u <= 0.0:
            u = 0.0
        elif u >= 1.0:
            u = 1.0
        elif math.isnan(u):
            raise TaskError(f"t = {t!r} is not a time: give seconds")
        length = self.path.length
        return np.array(self._motion(u, self.path.point(min(quintic(u)[0] * length, length))))
