"""The parameter of a planar curve by arc length, for curves that have no closed form of it."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import TaskError

Floats = NDArray[np.float64]
Speed = Callable[[Floats], tuple[Floats, Floats]]

_MOST_PANELS = 2**18
# Off the symmetric places of a panel, where an interpolation error could vanish by chance.
_PROBES = (0.23, 0.5, 0.71)
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(10)


class ArcLength:
    """The inverse w(s) of the arc length s(w) = integral of speed(w) from 0 to w.

    A quintic Hermite interpolation of w(s): the knots are exact (Gauss-Legendre quadrature), and so are both
    derivatives there, dw/ds = 1/speed and d2w/ds2 = -speed'/speed^3. The knots are doubled until s(w(s)) - s,
    probed inside every panel by quadrature, is below 1e-10 of the length and below 1e-10 m.
    """

    def __init__(self, speed: Speed, end: float, panels: int, breaks: Floats | None = None) -> None:
        """Tabulate.

        Args:
            speed: w (k,) -> (ds/dw (k,) [m], d2s/dw2 (k,) [m]), smooth, ds/dw above zero.
            end: largest w, above zero.
            panels: panels to start from; enough to see every bend of the curve.
            breaks: (b,) from 0 to ``end``, between which the speed is smooth; each stretch gets so many panels.

        Raises:
            TaskError: the accuracy is not reached with 2^18 panels in all.
        """
        stretches = 1 if breaks is None else len(breaks) - 1
        while panels * stretches <= _MOST_PANELS:
            if breaks is None:
                w = np.linspace(0.0, end, panels + 1)
            else:
                place = np.linspace(0.0, stretches, panels * stretches + 1)
                w = np.interp(place, np.arange(stretches + 1), breaks)
            lengths = _quadrature(speed, w[:-1], w[1:])
            s = np.concatenate(([0.0], np.cumsum(lengths)))
            coefficients = _hermite(w, lengths, *speed(w))
            if _worst(speed, w, lengths, coefficients) <= 1e-10 * min(1.0, float(s[-1])):
                s.setflags(write=False)
                self.knots: Floats = s
                self.length = float(s[-1])
                # Plain lists: at one number a tick, indexing an array costs more than the whole polynomial.
                self._starts: list[float] = s[:-1].tolist()
                self._lengths: list[float] = lengths.tolist()
                self._coefficients: list[list[float]] = coefficients.tolist()
                return
            panels *= 2
        raise TaskError(
            "the arc length of this curve cannot be tabulated to 1e-10: take fewer periods or turns, or less "
            "extreme proportions"
        )

    def parameter(self, s: float) -> float:
        """Return w at arc length s [m], s in [0, length]."""
        panel = bisect_right(self._starts, s) - 1
        t = (s - self._starts[panel]) / self._lengths[panel]
        a0, a1, a2, a3, a4, a5 = self._coefficients[panel]
        return a0 + t * (a1 + t * (a2 + t * (a3 + t * (a4 + t * a5))))


def _quadrature(speed: Speed, lower: Floats, upper: Floats) -> Floats:
    """Return the arc length between two parameters, panel by panel, (k,) [m]."""
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    places = middle[:, None] + half[:, None] * _GAUSS_NODES
    values = speed(places.ravel())[0].reshape(places.shape)
    return np.asarray(half * (values @ _GAUSS_WEIGHTS), dtype=np.float64)


def _hermite(w: Floats, lengths: Floats, speed: Floats, slope: Floats) -> Floats:
    """Return the coefficients (k, 6) of w over each panel, in powers of t = (s - s_i) / (s_(i+1) - s_i)."""
    first, second = 1.0 / speed, -slope / speed**3
    rise = np.diff(w)
    m0, m1 = first[:-1] * lengths, first[1:] * lengths
    c0, c1 = second[:-1] * lengths**2, second[1:] * lengths**2
    return np.stack(
        [
            w[:-1], m0, 0.5 * c0, 10.0 * rise - 6.0 * m0 - 4.0 * m1 - 1.5 * c0 + 0.5 * c1,
            -15.0 * rise + 8.0 * m0 + 7.0 * m1 + 1.5 * c0 - c1,
            6.0 * rise - 3.0 * m0 - 3.0 * m1 - 0.5 * c0 + 0.5 * c1,
        ],
        axis=1,
    )


def _worst(speed: Speed, w: Floats, lengths: Floats, coefficients: Floats) -> float:
    """Return the largest |s(w(s)) - s| over the probes of all panels [m]."""
    worst = 0.0
    for t in _PROBES:
        found = coefficients @ (t ** np.arange(6))
        error = np.abs(_quadrature(speed, w[:-1], found) - t * lengths).max()
        # A comparison with a value that is not a number would pass as "no worse".
        worst = max(worst, float(error)) if np.isfinite(error) else np.inf
    return worst
