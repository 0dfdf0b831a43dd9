"""Robots as plain data: one URDF and one TOML file each.

Read first: ``lwr4.toml``, then ``loader`` (``load_data``) and ``description`` (what a TOML may say). ``urdf``
and ``numbers`` read a URDF strictly, ``rebuild`` writes it anew for pinocchio and MuJoCo. To add an arm:
docs/extending.md. Imports ``errors`` and ``inputs``; model and sim build their engines from it.
"""

from moc_opt.robots.loader import RobotData, about, available_robots, load_data

__all__ = ["RobotData", "about", "available_robots", "load_data"]
