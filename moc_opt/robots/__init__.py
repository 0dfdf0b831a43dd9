"""Robots: arms as data, the controller's model of an arm, inverse kinematics, and a new arm from a vendor's URDF.

To add an arm, write a URDF and a TOML like ``lwr4.toml``; see docs/extending.md. ``loader`` and ``urdf`` check these
files. ``model`` has ``load_robot`` and ``RobotModel.state(q, v)``. ``gains`` derives the gains of an untuned arm.
``new`` and ``check`` do the work of `moc-opt robot new` and `check`.
"""

from moc_opt.robots.loader import RobotData, about, available_robots, load_data

__all__ = ["RobotData", "about", "available_robots", "load_data"]
