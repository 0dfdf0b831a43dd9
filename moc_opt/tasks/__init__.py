"""The task: paths of the tool's tip, the time law along a path, and the trocar that the shaft must pass through.

To add a path, write a function that turns sizes (such as a length) into waypoints, and add it to ``CURVES`` in
``curves``. `moc-opt tasks` then lists the path, and ``[task] path`` accepts its name. ``paths`` places a path in space.
``timelaw`` moves the tip along it (``Reference``: X_d and its derivatives).
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
