"""The hierarchical torque controller (tip, remote centre of motion, manipulability) and its checks.

Read first: ``controller`` (a tick, from state to torque), then ``law_numbers`` (from settings to the law's numbers;
its equations are in `moc_opt/core/law.c`). ``supervisor`` refuses wrong answers of a solver; ``safety_filter`` checks
measurements and limits torques. A solver is passed to the controller: of ``moc_opt.solvers``, this package imports only
``base``, ``exact`` and ``isolated``. ``moc_opt.sim`` imports this package only for type checking.
"""

from moc_opt.control.controller import Controller
from moc_opt.control.settings import ControlSettings

__all__ = ["ControlSettings", "Controller"]
