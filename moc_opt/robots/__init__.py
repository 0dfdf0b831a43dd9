"""Robots: arms as data, the controller's model of an arm, inverse kinematics, and a new arm from a vendor's URDF.

To add an arm, write a URDF and a TOML like ``lwr4.toml``, here or anywhere else; see docs/extending.md. ``loader`` and
``urdf`` check them; ``model`` has ``load_robot`` and ``RobotModel.state(q, v)``, ``gains`` the gains of an arm that
nobody has tuned. ``new`` and ``check`` do `moc-opt robot new` and `check`; both try a task, and import scenario.
"""

from moc_opt.robots.loader import RobotData, about, available_robots, load_data

__all__ = ["RobotData", "about", "available_robots", "load_data"]
