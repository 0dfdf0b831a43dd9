"""The hierarchical torque controller: tip, remote centre of motion, manipulability."""

from moc_opt.control.controller import Controller
from moc_opt.control.settings import ControlSettings

__all__ = ["ControlSettings", "Controller"]
