"""Plug-ins: entry points of other packages."""

from __future__ import annotations

import sys
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from moc_opt.errors import MocOptError, describe


def plugins(group: str) -> dict[str, list[EntryPoint]]:
    """Return the entry points of a group by name."""
    return _scan(group, tuple(sys.path))


@lru_cache(maxsize=24)  # a scan takes 10 ms
def _scan(group: str, path: tuple[str, ...]) -> dict[str, list[EntryPoint]]:
    found: dict[str, dict[str, EntryPoint]] = {}
    for point in entry_points(group=group):
        found.setdefault(point.name, {}).setdefault(point.value, point)
    return {name: list(points.values()) for name, points in found.items()}


def in_words(point: EntryPoint) -> str:
    """Name the entry point and its package."""
    package = getattr(point.dist, "name", None)
    return f"entry point {point.value!r}" + (f" of package {package!r}" if package else "")


def load(kind: str, name: str, points: list[EntryPoint], error: type[MocOptError]) -> Any:
    """Import a plug-in. Raise ``error`` if this fails, or if the name is not unique."""
    if len(points) > 1:
        raise error(f"{kind} {name!r}: {' and '.join(map(in_words, points))} claim this name: rename one")
    try:
        return points[0].load()
    except (Exception, SystemExit, KeyboardInterrupt) as reason:  # a plug-in may raise anything
        why = f"{in_words(points[0])} does not load: {describe(reason)}"
        raise error(f"{kind} {name!r}: {why}; mend or uninstall its package") from reason
