"""Paths by name: those of the package, waypoints, and those that other packages add.

An entry point of the group `moc_opt.tasks` names what an entry of `CURVES` is: a function of sizes that returns
waypoints, or a class of a planar curve.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from numpy.typing import ArrayLike

from moc_opt.errors import MocOptError, TaskError, UnknownNameError, describe
from moc_opt.inputs import plugins
from moc_opt.tasks.curves import CURVES
from moc_opt.tasks.paths import Path, Waypoints

GROUP = "moc_opt.tasks"
WAYPOINTS = "waypoints"


def kinds() -> dict[str, str]:
    """Name -> one line on every path that a scenario may name; of one that is broken, the reason."""
    found = {name: _about(curve) for name, curve in CURVES.items()}
    found[WAYPOINTS] = "A smooth path through the points of `waypoints_m`, in three dimensions."
    for name in _plugins():
        try:
            found.setdefault(name, _about(_maker(name)))
        except TaskError as error:
            found.setdefault(name, str(error))
    return found


def sizes(kind: str, given: Iterable[str] = ()) -> dict[str, Any]:
    """Name -> default of every size of a path; `inspect.Parameter.empty` where it has to be given.

    Raises:
        UnknownNameError: no such path, or a given name is none of its sizes.
        TaskError: it is another package's, and does not load.
    """
    parameters = {} if kind == WAYPOINTS else inspect.signature(_maker(kind)).parameters
    known = {name: parameter.default for name, parameter in parameters.items()}
    for name in given:
        if name not in known:
            raise UnknownNameError(f"size of a {kind}", name, known)
    return known


def make_path(
    kind: str, start: ArrayLike, *, normal: ArrayLike, heading: ArrayLike, waypoints: ArrayLike | None = None,
    **given: float,
) -> Path:  # fmt: skip
    """Build a path by name: what a scenario file asks for.

    Args:
        kind: one of `kinds`.
        start: the tip at the beginning, (3,) [m].
        normal: of the path's plane, (3,).
        heading: (3,), the part along the normal is taken out: first tangent of line, circle and spiral,
            axis of the sinusoid.
        waypoints: (k, 3) [m], see `Waypoints`; of the kind "waypoints" alone.
        given: its sizes; line: length; circle: radius; sinusoid: amplitude, wavelength, periods; spiral: turns,
            radius. Lengths in m.

    Raises:
        UnknownNameError: no such kind, or the kind has no such size; the message lists the valid names.
        TaskError: a size is missing or not positive and finite, or a vector is not usable.
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
    shape = Path if hasattr(made, "at") else Waypoints
    return shape(made, start, normal=normal, heading=heading)


def _plugins() -> dict[str, list[EntryPoint]]:
    return plugins.plugins(GROUP, entry_points)


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
