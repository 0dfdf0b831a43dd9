"""Paths of the tool tip, as functions of arc length.

To add a path, add a function to `CURVES` of curves.py, or an entry point of the group `moc_opt.tasks`.
"""

from __future__ import annotations

import inspect
import math
from bisect import bisect_right
from collections.abc import Callable, Iterable
from importlib.metadata import EntryPoint
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.arrays import Array
from moc_opt.errors import MocOptError, TaskError, UnknownNameError, describe
from moc_opt.inputs import plugins
from moc_opt.tasks.checks import TimeLike, direction3, sampled, vector3
from moc_opt.tasks.curves import CURVES, ArcLength, PlanarCurve

GROUP = "moc_opt.tasks"
WAYPOINTS = "waypoints"
MOST = 1000  #: Largest number of waypoints.
FARTHEST_M = 1000.0  #: Largest distance of a waypoint from the start along each axis.
_SLOWEST = 0.05  # least |dp/dw| of an allowed path, where p is the point at chord length w


class Path:
    """A planar curve in space, with the axes `heading` and `left` = normal x heading."""

    length: float  #: [m]
    knots: Array  #: Arc lengths (k,) from 0 to `length` that resolve every bend [m].

    def __init__(self, curve: PlanarCurve, start: ArrayLike, *, normal: ArrayLike, heading: ArrayLike) -> None:
        """Place the curve at start (3,) [m], in the plane perpendicular to normal (3,). Project heading (3,) into it.

        Raise a TaskError if a vector is unusable.
        """
        self._place(start, normal, heading)
        self.curve, self.length, self.knots = curve, float(curve.length), curve.knots

    def _place(self, start: ArrayLike, normal: ArrayLike, heading: ArrayLike) -> None:
        self.start, self.normal = vector3("start", start), direction3("normal", normal)
        along = direction3("heading", heading)
        inside = along - (along @ self.normal) * self.normal
        if math.sqrt(float(inside @ inside)) < 1e-6:
            raise TaskError(f"heading = {heading!r} is parallel to the normal {normal!r}: choose another heading")
        self.heading = direction3("heading", inside)
        self.left = direction3("left", np.cross(self.normal, self.heading))

    def curvature(self, s: float) -> float:
        """Return the curvature [1/m] at s [m], positive to the left."""
        return self.curve.at(s)[4]

    def at(self, s: TimeLike) -> tuple[Array, Array, Array]:
        """Return p [m], dp/ds and d2p/ds2 [1/m] at s [m], (3,) each or (k, 3) if s is (k,).

        Raise a TaskError if s is outside the path or unusable.
        """
        p, dp, ddp = sampled("s", s, self._checked)
        return p, dp, ddp

    def _checked(self, s: Array) -> Array:
        slack = 1e-9 * self.length
        for one in s[~((s >= -slack) & (s <= self.length + slack))].tolist():
            raise TaskError(f"s = {one!r} is outside the path: give an arc length in [0, {self.length!r}] m")
        return self.points(np.clip(s, 0.0, self.length))

    def points(self, s: Array) -> Array:
        """Return (k, 3, 3) for s (k,) [m], whose range is not checked. Axis 1: p, dp/ds, d2p/ds2. Axis 2: x, y, z."""
        x, y, tx, ty, k = np.array([self.curve.at(one) for one in s.tolist()]).reshape(-1, 5).T[:, :, None]
        a, b = self.heading, self.left
        return np.stack([self.start + a * x + b * y, a * tx + b * ty, a * (-k * ty) + b * (k * tx)], axis=1)


class Waypoints(Path):
    """A natural cubic spline over the chord length, from `start` through every waypoint."""

    def __init__(self, points: ArrayLike, start: ArrayLike, *, normal: ArrayLike, heading: ArrayLike) -> None:
        """Lay the path through points (k, 3) [m]: distances from the start along heading, left and normal.

        Raise a TaskError if points are unusable, two in a row are equal, or the path turns back on the spot.
        """
        self._place(start, normal, heading)
        given = _checked(points)
        inside = given if not given[0].any() else np.vstack([np.zeros(3), given])
        chords = np.sqrt((np.diff(inside, axis=0) ** 2).sum(axis=1))
        for k in np.flatnonzero(chords < 1e-9).tolist():
            raise TaskError(f"waypoint {inside[k + 1].tolist()} appears twice in a row: remove one")
        self._at = np.concatenate([[0.0], np.cumsum(chords)])
        self._pieces = _spline(self._at, self.start + inside @ np.stack([self.heading, self.left, self.normal]))
        self._check_turns(inside)
        self._arc = ArcLength(self._speed, self._at, 8)
        self.length, self.knots = self._arc.length, self._arc.knots
        self._begin: list[float] = self._at[:-1].tolist()
        self._rows_of: list[list[list[float]]] = self._pieces.tolist()

    def curvature(self, s: float) -> float:
        """Return the absolute curvature [1/m] at s [m], because in three dimensions there is no left and right."""
        return math.hypot(*self._point(s)[6:])

    def points(self, s: Array) -> Array:
        """See `Path.points`."""
        return np.array([self._point(one) for one in s.tolist()]).reshape(-1, 3, 3)

    def _point(self, s: float) -> tuple[float, ...]:
        w = self._arc.parameter(s)
        k = bisect_right(self._begin, w) - 1
        h, rows = w - self._begin[k], self._rows_of[k]
        d = [b + h * (2.0 * c + 3.0 * h * e) for _, b, c, e in rows]
        dd = [2.0 * c + 6.0 * h * e for _, _, c, e in rows]
        speed = math.hypot(*d)
        tangent = [entry / speed for entry in d]
        along = sum(a * b for a, b in zip(tangent, dd, strict=True))
        bend = [(a - along * b) / (speed * speed) for a, b in zip(dd, tangent, strict=True)]
        return (*(a + h * (b + h * (c + h * e)) for a, b, c, e in rows), *tangent, *bend)

    def _speed(self, w: Array) -> tuple[Array, Array]:
        piece = np.clip(np.searchsorted(self._at, w, side="right") - 1, 0, len(self._pieces) - 1)
        h = (w - self._at[piece])[:, None]
        _, b, c, e = (self._pieces[piece, :, i] for i in range(4))
        d, dd = b + h * (2.0 * c + 3.0 * h * e), 2.0 * c + 6.0 * h * e
        speed = np.sqrt((d * d).sum(axis=1))
        return speed, (d * dd).sum(axis=1) / speed

    def _check_turns(self, inside: Array) -> None:
        fine = np.interp(np.linspace(0, len(inside) - 1, 32 * len(inside)), np.arange(len(inside)), self._at)
        with np.errstate(invalid="ignore", divide="ignore"):
            speed = self._speed(fine)[0]
        slowest = int(np.argmin(speed))
        if not speed[slowest] > _SLOWEST:
            near = inside[int(np.argmin(np.abs(self._at - fine[slowest])))].tolist()
            raise TaskError(
                f"the path turns back on the spot near waypoint {near}: add points beside this waypoint, so that the "
                "path turns in a curve"
            )


def _checked(points: ArrayLike) -> Array:
    found = vector3("waypoints", points, rows=True)
    for point in found[np.abs(found).max(axis=1, initial=0.0) > FARTHEST_M].tolist():
        raise TaskError(f"waypoint {point}: give points at most {FARTHEST_M:g} m from the start; the unit is m")
    if not 1 <= len(found) <= MOST or not found.any():
        raise TaskError(f"{len(found)} waypoints: give 1 to {MOST}, at least one of them away from the start")
    return found


def _spline(t: Array, points: Array) -> Array:
    from scipy.interpolate import CubicSpline  # slow to import

    found = CubicSpline(t, points, bc_type="natural").c  # (4, pieces, 3), highest power first
    return np.ascontiguousarray(found[::-1].transpose(1, 2, 0))


def kinds() -> dict[str, str]:
    """Return the description of every path, by name."""
    found = {name: _about(curve) for name, curve in CURVES.items()}
    found[WAYPOINTS] = "A smooth path through the points of `waypoints_m`, in three dimensions."
    for name in _plugins():
        try:
            found.setdefault(name, _about(_maker(name)))
        except TaskError as error:
            found.setdefault(name, str(error))
    return found


def sizes(kind: str, given: Iterable[str] = ()) -> dict[str, Any]:
    """Return the default of every size (e.g. radius) of a path; `inspect.Parameter.empty` if it has no default.

    Raises:
        UnknownNameError: the path, or a size in ``given``, is unknown.
        TaskError: the path is a plug-in that does not load.
    """
    parameters = {} if kind == WAYPOINTS else inspect.signature(_maker(kind)).parameters
    known = {name: parameter.default for name, parameter in parameters.items()}
    for name in given:
        if name not in known:
            raise UnknownNameError(f"size of a {kind}:", name, known)
    return known


def make_path(
    kind: str, start: ArrayLike, *, normal: ArrayLike, heading: ArrayLike, waypoints: ArrayLike | None = None,
    **given: float,
) -> Path:  # fmt: skip
    """Build a path by its name in `kinds`, with the given `sizes`.

    Args:
        start, normal, heading: as in `Path`.
        waypoints: (k, 3) [m], see `Waypoints`; only for the kind "waypoints".

    Raises:
        UnknownNameError: the kind or a size is unknown.
        TaskError: a size is missing or not positive and finite, or a vector is unusable.
    """
    known = sizes(kind, given)
    missing = [name for name, default in known.items() if default is inspect.Parameter.empty and name not in given]
    if missing:
        raise TaskError(f"a {kind} needs its {', '.join(missing)}: give positive numbers, lengths in m")
    if kind == WAYPOINTS:
        return Waypoints([] if waypoints is None else waypoints, start, normal=normal, heading=heading)
    try:
        made = _maker(kind)(**given)
    except MocOptError:
        raise
    except Exception as error:
        if kind in CURVES:
            raise
        raise TaskError(f"path {kind!r}: {plugins.in_words(_plugins()[kind][0])} raised {describe(error)}") from error
    shape = Path if hasattr(made, "at") else Waypoints  # a plug-in may also return waypoints
    return shape(made, start, normal=normal, heading=heading)


def _plugins() -> dict[str, list[EntryPoint]]:
    return plugins.plugins(GROUP)


def _maker(kind: str) -> Callable[..., Any]:
    if kind in CURVES:
        return CURVES[kind]
    claimed = _plugins()
    if kind not in claimed:
        raise UnknownNameError("path", str(kind), [*CURVES, WAYPOINTS, *claimed])
    found: Callable[..., Any] = plugins.load("path", kind, claimed[kind], TaskError)
    if not callable(found):
        what = plugins.in_words(claimed[kind][0])
        raise TaskError(f"path {kind!r}: {what} is no class or function; see docs/extending.md")
    return found


def _about(maker: Callable[..., Any]) -> str:
    return (inspect.getdoc(maker) or "").strip().partition("\n")[0]
