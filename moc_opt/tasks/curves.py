"""Shapes of paths: planar curves by arc length.

A curve starts at its own origin and its first axis is the heading. A new shape is one class with `length`,
`knots` and `at`, and one entry in `CURVES`; its init fields are its sizes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from moc_opt.numerics.arrays import read_only
from moc_opt.tasks.arclength import ArcLength
from moc_opt.tasks.checks import Vector, positive

PlanePoint = tuple[float, float, float, float, float]


class PlanarCurve(Protocol):
    """A smooth curve in the plane, from its own origin, by arc length."""

    @property
    def length(self) -> float:
        """Length [m]."""

    @property
    def knots(self) -> Vector:
        """Arc lengths (k,) [m], from 0 to `length`, close enough together to see every bend."""

    def at(self, s: float) -> PlanePoint:
        """Return x, y [m], unit tangent tx, ty and curvature [1/m] (left is positive) at s in [0, length]."""


@dataclass(frozen=True, eq=False)
class Line:
    """A straight line of the given length [m] along the heading."""

    length: float
    knots: Vector = field(init=False, repr=False)

    def __post_init__(self) -> None:
        length = positive("length", self.length)
        _keep(self, length=length, knots=_evenly(length, 1))

    def at(self, s: float) -> PlanePoint:
        """See `PlanarCurve.at`."""
        return s, 0.0, 1.0, 0.0, 0.0


@dataclass(frozen=True, eq=False)
class Circle:
    """One full turn of the given radius [m], to the left, the heading being its first tangent."""

    radius: float
    length: float = field(init=False)
    knots: Vector = field(init=False, repr=False)

    def __post_init__(self) -> None:
        radius = positive("radius", self.radius)
        length = 2.0 * math.pi * radius
        _keep(self, radius=radius, length=length, knots=_evenly(length, 16))

    def at(self, s: float) -> PlanePoint:
        """See `PlanarCurve.at`."""
        r = self.radius
        c, d = math.cos(s / r), math.sin(s / r)
        return r * d, r * (1.0 - c), c, d, 1.0 / r


@dataclass(frozen=True, eq=False)
class Sinusoid:
    """y = amplitude sin(2 pi x / wavelength), x along the heading, for a number of periods (whole or not).

    Amplitude and wavelength in m. It starts on its axis, at its steepest.
    """

    amplitude: float
    wavelength: float
    periods: float
    length: float = field(init=False)
    knots: Vector = field(init=False, repr=False)
    _arc: ArcLength = field(init=False, repr=False)

    def __post_init__(self) -> None:
        _keep(self, **{name: positive(name, getattr(self, name)) for name in ("amplitude", "wavelength", "periods")})
        steepness = 2.0 * math.pi * self.amplitude / self.wavelength
        scale = self.wavelength / (2.0 * math.pi)

        def speed(phase: Vector) -> tuple[Vector, Vector]:
            slope = steepness * np.cos(phase)
            ds = np.sqrt(1.0 + slope**2)
            return scale * ds, -scale * slope * steepness * np.sin(phase) / ds

        arc = ArcLength(speed, 2.0 * math.pi * self.periods, 16 * math.ceil(self.periods))
        _keep(self, _arc=arc, length=arc.length, knots=arc.knots)

    def at(self, s: float) -> PlanePoint:
        """See `PlanarCurve.at`; from y(x), tangent (1, y')/sqrt(1 + y'^2), curvature y''/(1 + y'^2)^(3/2)."""
        phase, a = self._arc.parameter(s), self.amplitude
        k = 2.0 * math.pi / self.wavelength
        sine = math.sin(phase)
        slope = a * k * math.cos(phase)
        ds = math.sqrt(1.0 + slope * slope)
        return phase / k, a * sine, 1.0 / ds, slope / ds, -a * k * k * sine / (ds * ds * ds)


@dataclass(frozen=True, eq=False)
class Spiral:
    """Archimedean spiral from its centre to the left: r = radius angle / (2 pi turns), heading at angle 0.

    `turns` whole or not, `radius` [m] the final one. At the centre the curvature is 4 pi turns / radius.
    """

    turns: float
    radius: float
    length: float = field(init=False)
    knots: Vector = field(init=False, repr=False)
    _arc: ArcLength = field(init=False, repr=False)

    def __post_init__(self) -> None:
        _keep(self, **{name: positive(name, getattr(self, name)) for name in ("turns", "radius")})
        pitch = self._pitch

        def speed(angle: Vector) -> tuple[Vector, Vector]:
            ds = np.sqrt(1.0 + angle**2)
            return pitch * ds, pitch * angle / ds

        arc = ArcLength(speed, 2.0 * math.pi * self.turns, 16 * math.ceil(self.turns))
        _keep(self, _arc=arc, length=arc.length, knots=arc.knots)

    @property
    def _pitch(self) -> float:
        """Growth of the radius per radian [m]."""
        return self.radius / (2.0 * math.pi * self.turns)

    def at(self, s: float) -> PlanePoint:
        """See `PlanarCurve.at`; curvature (2 + angle^2) / (pitch (1 + angle^2)^(3/2))."""
        w, b = self._arc.parameter(s), self._pitch
        c, d = math.cos(w), math.sin(w)
        ds = math.sqrt(1.0 + w * w)
        return b * w * c, b * w * d, (c - w * d) / ds, (d + w * c) / ds, (2.0 + w * w) / (b * ds * ds * ds)


CURVES: dict[str, type[Any]] = {"line": Line, "circle": Circle, "sinusoid": Sinusoid, "spiral": Spiral}
"""Kind of path -> class of its planar curve; the class's init fields are the sizes."""


def _evenly(length: float, panels: int) -> Vector:
    """Return read-only evenly spaced arc lengths (panels + 1,) [m]."""
    return read_only(np.linspace(0.0, length, panels + 1))


def _keep(curve: PlanarCurve, **values: Any) -> None:
    """Set attributes of a frozen curve while it is made."""
    for name, value in values.items():
        object.__setattr__(curve, name, value)
