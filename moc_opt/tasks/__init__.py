"""What the tool has to do: paths for its tip, the time law along them, the trocar it must pass through.

Read first: ``curves`` (shapes; add yours to ``CURVES``) and ``paths`` (a shape put into space), then
``timelaw`` (``Reference``: X_d and its derivatives) and ``trocar``. ``sequence`` joins references,
``waiting`` lets one wait. Imports ``errors`` and numpy alone.
"""

from __future__ import annotations

from moc_opt.tasks.curves import CURVES, PlanarCurve
from moc_opt.tasks.paths import Path, circle, line, make_path, sinusoid, spiral
from moc_opt.tasks.timelaw import Reference, duration, quintic
from moc_opt.tasks.trocar import Trocar, depth, shaft_distance

__all__ = [
    "CURVES",
    "Path",
    "PlanarCurve",
    "Reference",
    "Trocar",
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
