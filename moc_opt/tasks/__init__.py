"""The task of the tool: paths of its tip, the time law along them, the trocar that it must pass through.

Read first: ``curves`` (shapes; add yours to ``CURVES``) and ``paths`` (a shape put into space), then
``kinds`` (paths by name, those of other packages too), ``waypoints`` (any points in space),
``timelaw`` (``Reference``: X_d and its derivatives) and ``trocar``. ``waiting`` makes a reference wait.
Imports ``errors``, ``inputs`` and numpy alone.
"""

from __future__ import annotations

from moc_opt.tasks.curves import CURVES, PlanarCurve
from moc_opt.tasks.kinds import make_path
from moc_opt.tasks.paths import Path, circle, line, sinusoid, spiral
from moc_opt.tasks.timelaw import Reference, duration, quintic
from moc_opt.tasks.trocar import Trocar, depth, shaft_distance
from moc_opt.tasks.waypoints import Waypoints

__all__ = [
    "CURVES",
    "Path",
    "PlanarCurve",
    "Reference",
    "Trocar",
    "Waypoints",
    "circle",
    "depth",
    "duration",
    "line",
    "make_path",
    "quintic",
    "shaft_distance",
    "sinusoid",
    "spiral",
]
