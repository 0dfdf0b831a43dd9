"""The hierarchical torque controller, and its checks of answers and measurements. Read ``controller`` first."""

from moc_opt.control.controller import Controller
from moc_opt.control.settings import ControlSettings

__all__ = ["ControlSettings", "Controller"]
