"""The hierarchical torque controller (tip, remote centre of motion, manipulability) and its checks.

Read ``controller`` first. The law's equations are in core/law.c. ``supervisor`` refuses wrong answers of a solver, and
``safety_filter`` checks measurements and limits torques.
"""

from moc_opt.control.controller import Controller
from moc_opt.control.settings import ControlSettings

__all__ = ["ControlSettings", "Controller"]
