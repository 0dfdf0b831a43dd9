"""A smooth path through points in space: the natural cubic spline, by arc length."""

from __future__ import annotations

import math
from bisect import bisect_right

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.errors import TaskError
from moc_opt.tasks.arclength import ArcLength
from moc_opt.tasks.checks import Vector
from moc_opt.tasks.paths import Path

MOST = 1000
"""Waypoints of one path."""
FARTHEST_M = 1000.0
"""Of a waypoint from the start, along each axis: as for the sizes of other paths."""
_SLOWEST = 0.05
"""Of the spline's speed over its chords: below it, the path all but turns back on the spot."""


class Waypoints(Path):
    """A path from `start` through every waypoint, its direction and curvature continuous.

    Between two points it is a cubic in the length of the chords; at both ends its curvature is 0.
    """

    def __init__(self, points: ArrayLike, start: ArrayLike, *, normal: ArrayLike, heading: ArrayLike) -> None:
        """Lay the path.

        Args:
            points: (k, 3) [m] from the start: along the heading, to the left, along the normal. The start itself may
                stand first.
            start: where the path begins, (3,) [m].
            normal, heading: as in `Path`.

        Raises:
            TaskError: no such points, two alike beside each other, or a path that turns back on the spot.
        """
        self._place(start, normal, heading)
        given = _checked(points)
        inside = given if not given[0].any() else np.vstack([np.zeros(3), given])
        chords = np.sqrt((np.diff(inside, axis=0) ** 2).sum(axis=1))
        for k in np.flatnonzero(chords < 1e-9).tolist():
            raise TaskError(f"waypoint {inside[k + 1].tolist()} stands twice in a row: leave one out")
        axes = np.stack([self.heading, self.left, self.normal])
        self.knots_m = np.concatenate([[0.0], np.cumsum(chords)])
        self._pieces = _spline(self.knots_m, self.start + inside @ axes)
        self._check_turns(inside)
        self._arc = ArcLength(self._speed, float(self.knots_m[-1]), 8, self.knots_m)
        self.length = self._arc.length
        # Plain lists: at one number a tick, indexing an array costs more than the polynomial.
        self._begin: list[float] = self.knots_m[:-1].tolist()
        self._rows_of: list[list[list[float]]] = self._pieces.tolist()

    @property
    def knots(self) -> Vector:
        """See `Path.knots`."""
        return self._arc.knots

    def curvature(self, s: float) -> float:
        """See `Path.curvature`."""
        return math.hypot(*self.point(s)[6:])

    def point(self, s: float) -> tuple[float, ...]:
        """See `Path.point`."""
        w = self._arc.parameter(s)
        k = bisect_right(self._begin, w) - 1
        h = w - self._begin[k]
        p, d, dd = [], [], []
        for a, b, c, e in self._rows_of[k]:
            p.append(a + h * (b + h * (c + h * e)))
            d.append(b + h * (2.0 * c + 3.0 * h * e))
            dd.append(2.0 * c + 6.0 * h * e)
        speed = math.hypot(*d)
        tangent = [entry / speed for entry in d]
        along = sum(a * b for a, b in zip(tangent, dd, strict=True))
        bend = [(a - along * b) / (speed * speed) for a, b in zip(dd, tangent, strict=True)]
        return (*p, *tangent, *bend)

    def points(self, s: Vector) -> tuple[Vector, ...]:
        """See `Path.points`."""
        return tuple(np.array([self.point(entry) for entry in s.tolist()]).T)

    def _speed(self, w: Vector) -> tuple[Vector, Vector]:
        """Return |dp/dw| and its derivative at parameters (k,)."""
        piece = np.clip(np.searchsorted(self.knots_m, w, side="right") - 1, 0, len(self._pieces) - 1)
        h = (w - self.knots_m[piece])[:, None]
        _, b, c, e = (self._pieces[piece, :, i] for i in range(4))
        d, dd = b + h * (2.0 * c + 3.0 * h * e), 2.0 * c + 6.0 * h * e
        speed = np.sqrt((d * d).sum(axis=1))
        return speed, (d * dd).sum(axis=1) / speed

    def _check_turns(self, inside: Vector) -> None:
        fine = np.interp(np.linspace(0, len(inside) - 1, 32 * len(inside)), np.arange(len(inside)), self.knots_m)
        with np.errstate(invalid="ignore", divide="ignore"):
            speed = self._speed(fine)[0]
        slowest = int(np.argmin(speed))
        if not speed[slowest] > _SLOWEST:
            near = int(np.argmin(np.abs(self.knots_m - fine[slowest])))
            raise TaskError(
                f"the path turns back on the spot near waypoint {inside[near].tolist()}: add points beside it, so that "
                "it turns on a curve"
            )

    def __repr__(self) -> str:
        return f"Waypoints({len(self.knots_m)} points, {self.length:.4g} m, start={self.start.tolist()})"


def _checked(points: ArrayLike) -> Vector:
    try:
        found = np.array(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TaskError(f"waypoints = {points!r:.200}: give a list of points of three numbers [m]") from error
    if found.ndim != 2 or found.shape[1] != 3 or not np.isfinite(found).all():
        raise TaskError(f"waypoints of shape {found.shape}: give finite numbers (k, 3) [m], k points of three numbers")
    for point in found[np.abs(found).max(axis=1, initial=0.0) > FARTHEST_M].tolist():
        raise TaskError(f"waypoint {point}: {FARTHEST_M:g} m from the start is the most, and the unit is m")
    if not 1 <= len(found) <= MOST or not found.any():
        raise TaskError(f"{len(found)} waypoints: give 1 to {MOST}, one of them off the start")
    return found


def _spline(t: Vector, points: Vector) -> Vector:
    """Return the coefficients (k, 3, 4) of the natural cubic spline, in powers of t - t_i, from second derivatives M.

    h_(i-1) M_(i-1) + 2 (h_(i-1) + h_i) M_i + h_i M_(i+1) = 6 (d_i - d_(i-1)), d_i = (p_(i+1) - p_i)/h_i; M = 0 at
    both ends.
    """
    h = np.diff(t)
    slope = np.diff(points, axis=0) / h[:, None]
    bend = np.zeros_like(points)
    if len(h) > 1:
        matrix = np.diag(2.0 * (h[:-1] + h[1:])) + np.diag(h[1:-1], 1) + np.diag(h[1:-1], -1)
        bend[1:-1] = np.linalg.solve(matrix, 6.0 * np.diff(slope, axis=0))
    first = slope - h[:, None] * (2.0 * bend[:-1] + bend[1:]) / 6.0
    cubic = np.diff(bend, axis=0) / (6.0 * h[:, None])
    return np.stack([points[:-1], first, 0.5 * bend[:-1], cubic], axis=2)
