"""The task of the tool: paths of its tip, the time law along them, the trocar that the shaft must pass through.

To add a path, write one function of its sizes that returns waypoints, and enter it in ``CURVES`` at the end of
``curves``; `moc-opt tasks` then lists it, and ``[task] path`` takes it. ``paths`` puts a curve or waypoints into space
and makes a path by name; ``timelaw`` moves the tip along it (``Reference``: X_d and its derivatives).
"""

from __future__ import annotations

from moc_opt.tasks.curves import CURVES, PlanarCurve
from moc_opt.tasks.paths import Path, Waypoints, make_path
from moc_opt.tasks.timelaw import Reference, duration, quintic
from moc_opt.tasks.trocar import Trocar, shaft_distance

__all__ = [
    "CURVES", "Path", "PlanarCurve", "Reference", "Trocar", "Waypoints", "duration", "make_path", "quintic",
    "shaft_distance",
]  # fmt: skip
