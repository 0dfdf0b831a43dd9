"""The task of the tool: paths of its tip, the time law along them, the trocar that it must pass through.

Read first: ``curves`` (shapes; add yours to ``CURVES``) and ``paths`` (a shape put into space, or any points), then
``kinds`` (paths by name, those of other packages too), ``timelaw`` (``Reference``: X_d and its derivatives) and
``trocar``. ``waiting`` makes a reference wait.
Imports ``errors``, ``inputs`` and numpy alone.
"""

from __future__ import annotations

from moc_opt.tasks.curves import CURVES, PlanarCurve
from moc_opt.tasks.kinds import make_path
from moc_opt.tasks.paths import Path, Waypoints
from moc_opt.tasks.timelaw import Reference, duration, quintic
from moc_opt.tasks.trocar import Trocar, depth, shaft_distance

__all__ = [
    "CURVES", "Path", "PlanarCurve", "Reference", "Trocar", "Waypoints", "depth", "duration", "make_path", "quintic",
    "shaft_distance",
]  # fmt: skip
