"""Robots: one URDF and one TOML file each, the controller's model of an arm, and a new arm from a vendor's URDF.

Read first: ``lwr4.toml``, ``loader`` (``load_data``: what a TOML may say) and ``model`` (``load_robot``,
``RobotModel.state(q, v)``); ``state`` says what a state holds.

- ``urdf`` reads a URDF and writes it anew for pinocchio and MuJoCo.
- ``chain`` holds the kinematics as CasADi functions, places links for drawing and the wrist for a trocar;
  ``inverse_kinematics`` finds a pose for a given tip.
- ``new`` makes a robot file from a vendor's URDF (``vendor`` finds the chain and replaces numbers that no arm has,
  ``home`` places tool, wrist point and home pose), ``check`` judges an arm, ``command`` is their command line.

Loaded here is what reads the files alone: pinocchio loads with the module that needs it. The files import
inputs, the model core too; ``new``, ``check`` and ``home`` judge an arm by the task it will do and import scenario.
To add an arm: docs/extending.md.
"""

from moc_opt.robots.loader import RobotData, about, available_robots, load_data

__all__ = ["RobotData", "about", "available_robots", "load_data"]
