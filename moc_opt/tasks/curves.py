"""Planar curves. Each starts at the origin of its axes; the first axis is the heading."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from moc_opt.arrays import Array, read_only
from moc_opt.errors import TaskError
from moc_opt.tasks.checks import positive

PlanePoint = tuple[float, float, float, float, float]
Speed = Callable[[Array], tuple[Array, Array]]

_MOST_PANELS = 2**18
_PROBES = (0.23, 0.5, 0.71)  # not symmetric, because an error might vanish at symmetric places
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(10)


class ArcLength:
    """The inverse w(s) of the arc length s(w) = integral of speed(w) from 0 to w.

    It is a quintic Hermite interpolation, refined until its error is below 1e-10 of the length and below 1e-10 m.

    Args:
        speed: function of w (k,) that returns ds/dw (k,) [m] above zero, and d2s/dw2 (k,) [m].
        breaks: (b,) rising values of w, from 0; the speed is smooth between them.
        panels: initial number of intervals between two breaks.

    Raises:
        TaskError: the accuracy is not reached with 2^18 intervals.
    """

    def __init__(self, speed: Speed, breaks: Array, panels: int) -> None:
        stretches = len(breaks) - 1
        while panels * stretches <= _MOST_PANELS:
            place = np.linspace(0.0, stretches, panels * stretches + 1)
            w = np.interp(place, np.arange(stretches + 1), breaks)
            lengths = _quadrature(speed, w[:-1], w[1:])
            s = np.concatenate(([0.0], np.cumsum(lengths)))
            coefficients = _hermite(w, lengths, *speed(w))
            if _worst(speed, w, lengths, coefficients) <= 1e-10 * min(1.0, float(s[-1])):
                self.knots, self.length = read_only(s), float(s[-1])
                # Lists are faster to index than arrays.
                self._starts: list[float] = s[:-1].tolist()
                self._lengths: list[float] = lengths.tolist()
                self._coefficients: list[list[float]] = coefficients.tolist()
                return
            panels *= 2
        raise TaskError(
            "the arc length of this curve cannot be tabulated to 1e-10: use fewer periods or turns, or less "
            "extreme proportions"
        )

    def parameter(self, s: float) -> float:
        """Return w at the arc length s [m] in [0, length]."""
        panel = bisect_right(self._starts, s) - 1
        t = (s - self._starts[panel]) / self._lengths[panel]
        a0, a1, a2, a3, a4, a5 = self._coefficients[panel]
        return a0 + t * (a1 + t * (a2 + t * (a3 + t * (a4 + t * a5))))


def _quadrature(speed: Speed, lower: Array, upper: Array) -> Array:
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    places = middle[:, None] + half[:, None] * _GAUSS_NODES
    return np.asarray(half * (speed(places.ravel())[0].reshape(places.shape) @ _GAUSS_WEIGHTS))


def _hermite(w: Array, lengths: Array, speed: Array, slope: Array) -> Array:
    first, second, rise = 1.0 / speed, -slope / speed**3, np.diff(w)
    m0, m1 = first[:-1] * lengths, first[1:] * lengths
    c0, c1 = second[:-1] * lengths**2, second[1:] * lengths**2
    return np.stack([
        w[:-1], m0, 0.5 * c0, 10.0 * rise - 6.0 * m0 - 4.0 * m1 - 1.5 * c0 + 0.5 * c1,
        -15.0 * rise + 8.0 * m0 + 7.0 * m1 + 1.5 * c0 - c1, 6.0 * rise - 3.0 * m0 - 3.0 * m1 - 0.5 * c0 + 0.5 * c1,
    ], axis=1)  # fmt: skip


def _worst(speed: Speed, w: Array, lengths: Array, coefficients: Array) -> float:
    ends = ((coefficients @ (t ** np.arange(6)), t) for t in _PROBES)
    worst = float(np.max([np.abs(_quadrature(speed, w[:-1], end) - t * lengths).max() for end, t in ends]))
    return worst if math.isfinite(worst) else math.inf


class PlanarCurve(NamedTuple):
    """A smooth curve, parametrised by arc length."""

    length: float  #: [m]
    knots: Array  #: Arc lengths (k,) from 0 to `length` that resolve every bend [m].
    at: Callable[[float], PlanePoint]
    """Function of s in [0, length]: x, y [m], unit tangent tx, ty, curvature [1/m] (positive to the left)."""


def line(length: float = 0.04) -> PlanarCurve:
    """A straight line of the given length [m] along the heading."""
    length = positive("length", length)
    return PlanarCurve(length, np.array([0.0, length]), lambda s: (s, 0.0, 1.0, 0.0, 0.0))


def circle(radius: float = 0.03) -> PlanarCurve:
    """A full circle to the left with the given radius [m]; the heading is the first tangent."""
    r = positive("radius", radius)

    def at(s: float) -> PlanePoint:
        c, d = math.cos(s / r), math.sin(s / r)
        return r * d, r * (1.0 - c), c, d, 1.0 / r

    length = 2.0 * math.pi * r
    return PlanarCurve(length, np.linspace(0.0, length, 17), at)


def sinusoid(amplitude: float = 0.01, wavelength: float = 0.02, periods: float = 2.0) -> PlanarCurve:
    """y = amplitude sin(2 pi x / wavelength) [m], x along the heading, for any number of periods."""
    a, periods = positive("amplitude", amplitude), positive("periods", periods)
    k = 2.0 * math.pi / positive("wavelength", wavelength)

    def speed(phase: Array) -> tuple[Array, Array]:
        slope = a * k * np.cos(phase)
        ds = np.sqrt(1.0 + slope**2)
        return ds / k, -slope * a * np.sin(phase) / ds

    def at(s: float) -> PlanePoint:
        phase = arc.parameter(s)
        sine, slope = math.sin(phase), a * k * math.cos(phase)
        ds = math.sqrt(1.0 + slope * slope)
        return phase / k, a * sine, 1.0 / ds, slope / ds, -a * k * k * sine / (ds * ds * ds)

    arc = ArcLength(speed, np.array([0.0, 2.0 * math.pi * periods]), 16 * math.ceil(periods))
    return PlanarCurve(arc.length, arc.knots, at)


def spiral(turns: float = 2.0, radius: float = 0.03) -> PlanarCurve:
    """Archimedean spiral r = radius angle / (2 pi turns) to the left. It leaves its centre along the heading.

    `turns` need not be whole; `radius` [m] is the final radius.
    """
    turns = positive("turns", turns)
    b = positive("radius", radius) / (2.0 * math.pi * turns)

    def speed(angle: Array) -> tuple[Array, Array]:
        ds = np.sqrt(1.0 + angle**2)
        return b * ds, b * angle / ds

    def at(s: float) -> PlanePoint:
        w = arc.parameter(s)
        c, d, ds = math.cos(w), math.sin(w), math.sqrt(1.0 + w * w)
        return b * w * c, b * w * d, (c - w * d) / ds, (d + w * c) / ds, (2.0 + w * w) / (b * ds * ds * ds)

    arc = ArcLength(speed, np.array([0.0, 2.0 * math.pi * turns]), 16 * math.ceil(turns))
    return PlanarCurve(arc.length, arc.knots, at)


CURVES: dict[str, Callable[..., Any]] = {"line": line, "circle": circle, "sinusoid": sinusoid, "spiral": spiral}
"""Functions that take the sizes of a path and return a `PlanarCurve` or waypoints (k, 3) [m]."""
