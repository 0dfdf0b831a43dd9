"""Paths of the tool tip: a planar curve put into space, with point, tangent and curvature by arc length."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.errors import TaskError
from moc_opt.tasks.checks import TimeLike, Vector, direction3, sampled, vector3
from moc_opt.tasks.curves import Circle, Line, PlanarCurve, Sinusoid, Spiral


class Path:
    """A planar curve put into space: it begins at `start` and lies in the plane of two unit vectors."""

    def __init__(self, curve: PlanarCurve, start: ArrayLike, *, normal: ArrayLike, heading: ArrayLike) -> None:
        """Place the curve.

        Args:
            start: where it begins, (3,) [m].
            normal: of its plane, (3,), any length above zero. "To the left" is seen from its tip.
            heading: the curve's first axis, (3,); its part along the normal is taken out.

        Raises:
            TaskError: a vector is not usable, or heading and normal are parallel.
        """
        self._place(start, normal, heading)
        self.curve = curve
        self.length = float(curve.length)

    def _place(self, start: ArrayLike, normal: ArrayLike, heading: ArrayLike) -> None:
        """Find the start and the axes of the path."""
        self.start = vector3("start", start)
        self.normal = direction3("normal", normal)
        along = direction3("heading", heading)
        inside = along - (along @ self.normal) * self.normal
        if math.sqrt(float(inside @ inside)) < 1e-6:
            raise TaskError(f"heading = {heading!r} is parallel to the normal {normal!r}: choose another")
        self.heading = direction3("heading", inside)
        self.left = direction3("left", np.cross(self.normal, self.heading))
        self._axes: tuple[tuple[float, float, float], ...] = tuple(
            zip(self.start.tolist(), self.heading.tolist(), self.left.tolist(), strict=True)
        )

    @property
    def knots(self) -> Vector:
        """Arc lengths (k,) [m], from 0 to `length`, close enough together to see every bend."""
        return self.curve.knots

    def curvature(self, s: float) -> float:
        """Return the curvature [1/m] at s [m] in [0, length]; of a planar path with its sign, left being positive."""
        return self.curve.at(s)[4]

    def at(self, s: TimeLike) -> tuple[Vector, Vector, Vector]:
        """Return point, unit tangent and curvature vector at an arc length.

        Args:
            s: arc length [m] in [0, length], a number or a vector (k,).

        Returns:
            p [m], dp = dp/ds, ddp = d2p/ds2 [1/m]; each (3,), or (k, 3) for a vector.

        Raises:
            TaskError: s is outside the path, or no number or vector.
        """
        p, dp, ddp = sampled("s", s, self._rows)
        return p, dp, ddp

    def point(self, s: float) -> tuple[float, ...]:
        """Return the nine numbers p, dp, ddp at s [m] in [0, length], unchecked: for use at every tick."""
        return self._in_space(*self.curve.at(s))

    def points(self, s: Vector) -> tuple[Vector, ...]:
        """Return ``point`` at arc lengths (k,): nine arrays (k,), with the same bits."""
        # Sines are taken one by one: numpy's of an array differ in the last bit.
        return self._in_space(*np.array([self.curve.at(entry) for entry in s.tolist()]).T)

    def _in_space(self, x: Any, y: Any, tx: Any, ty: Any, k: Any) -> tuple[Any, ...]:
        (ox, ax, bx), (oy, ay, by), (oz, az, bz) = self._axes
        u, v = -k * ty, k * tx
        return (
            ox + ax * x + bx * y, oy + ay * x + by * y, oz + az * x + bz * y,
            ax * tx + bx * ty, ay * tx + by * ty, az * tx + bz * ty,
            ax * u + bx * v, ay * u + by * v, az * u + bz * v,
        )  # fmt: skip

    def _rows(self, s: float) -> Vector:
        slack = 1e-9 * self.length
        if not -slack <= s <= self.length + slack:
            raise TaskError(f"s = {s!r} is outside the path: give an arc length in [0, {self.length!r}] m")
        return np.array(self.point(min(max(s, 0.0), self.length))).reshape(3, 3)

    def __repr__(self) -> str:
        return f"Path({self.curve!r}, start={self.start.tolist()}, normal={self.normal.tolist()})"


def line(start: ArrayLike, end: ArrayLike) -> Path:
    """Make a straight path between two different points (3,) [m].

    Raises:
        TaskError: a point is not usable, or both are the same.
    """
    first, last = vector3("start", start), vector3("end", end)
    step = last - first
    length = math.sqrt(float(step @ step))
    if length == 0.0:
        raise TaskError(f"end = {end!r} is the start: give two different points")
    # A line has no plane of its own; any normal across it will do.
    across = np.cross(step, np.eye(3)[int(np.argmin(np.abs(step)))])
    return Path(Line(length), first, normal=across, heading=step)


def circle(start: ArrayLike, center_direction: ArrayLike, *, radius: float, normal: ArrayLike) -> Path:
    """Make one full turn, counter-clockwise seen from the tip of the normal; end and start meet smoothly.

    Args:
        start: a point of the circle, where it begins, (3,) [m].
        center_direction: from there to its centre, (3,), any length; its part along the normal is taken out.
        radius, normal: as in `Circle` and `Path`.

    Raises:
        TaskError: a size is not positive and finite, or the directions do not span a plane.
    """
    heading = np.cross(direction3("center_direction", center_direction), direction3("normal", normal))
    if math.sqrt(float(heading @ heading)) < 1e-6:
        raise TaskError(f"center_direction = {center_direction!r} is parallel to the normal {normal!r}: choose another")
    return Path(Circle(radius), start, normal=normal, heading=heading)


def sinusoid(
    start: ArrayLike, heading: ArrayLike, *, amplitude: float, wavelength: float, periods: float, normal: ArrayLike
) -> Path:
    """Make a sine wave about the axis through `start` along `heading`; it begins on the axis, going to the left.

    Arguments as in `Sinusoid` and `Path`; errors as in `circle`.
    """
    return Path(Sinusoid(amplitude, wavelength, periods), start, normal=normal, heading=heading)


def spiral(start: ArrayLike, heading: ArrayLike, *, turns: float, radius: float, normal: ArrayLike) -> Path:
    """Make an Archimedean spiral from its centre `start` outwards, counter-clockwise seen from the tip of the normal.

    Arguments as in `Spiral` and `Path`; errors as in `circle`.
    """
    return Path(Spiral(turns, radius), start, normal=normal, heading=heading)
