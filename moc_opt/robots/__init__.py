"""Robots: arms as data, the controller's model of an arm, inverse kinematics, and a new arm from a vendor's URDF.

To add an arm, write two files, a URDF and a TOML like ``lwr4.toml``, here or anywhere else; `moc-opt robot new` writes
them from a vendor's URDF, and `moc-opt robot check` judges them. See docs/extending.md.

- ``loader`` says what the TOML may hold, ``urdf`` checks the URDF and writes it anew for pinocchio and MuJoCo.
- ``model`` has ``load_robot`` and ``RobotModel.state(q, v)``, ``state`` what a state holds, ``gains`` the gains of an
  arm that nobody has tuned, ``chain`` the kinematics as CasADi functions; ``inverse_kinematics`` finds poses.
- ``new`` makes a robot file: ``vendor`` finds the chain and replaces numbers that no arm has. ``check`` judges an arm;
  ``command`` is their command line. They know the task, and import scenario.
"""

from moc_opt.robots.loader import RobotData, about, available_robots, load_data

__all__ = ["RobotData", "about", "available_robots", "load_data"]
