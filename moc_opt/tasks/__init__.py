"""The task: paths of the tool's tip, the time law, and the trocar."""

from __future__ import annotations

from moc_opt.tasks.curves import CURVES, PlanarCurve
from moc_opt.tasks.paths import Path, Waypoints, make_path
from moc_opt.tasks.timelaw import Reference, duration, quintic
from moc_opt.tasks.trocar import Trocar, shaft_distance

__all__ = [
    "CURVES", "Path", "PlanarCurve", "Reference", "Trocar", "Waypoints", "duration", "make_path", "quintic",
    "shaft_distance",
]  # fmt: skip
