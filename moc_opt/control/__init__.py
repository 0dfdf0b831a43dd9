"""The hierarchical torque controller. Read ``controller`` first.

``supervisor`` refuses wrong answers of a solver, and ``safety_filter`` checks measurements and limits torques.
"""

from moc_opt.control.controller import Controller
from moc_opt.control.settings import ControlSettings

__all__ = ["ControlSettings", "Controller"]
