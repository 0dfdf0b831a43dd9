"""The hierarchical torque controller (tip, remote centre of motion, manipulability) and its checks.

Read first: ``controller``, which computes the torque once per control period (tick). Then read ``law_numbers``, which
turns settings into the numbers of the law in `core/law.c`. ``supervisor`` refuses wrong answers of a solver, and
``safety_filter`` checks measurements and limits torques. This package imports only ``base``, ``exact`` and ``isolated``
of ``moc_opt.solvers``. ``moc_opt.sim`` imports this package only for type checking.
"""

from moc_opt.control.controller import Controller
from moc_opt.control.settings import ControlSettings

__all__ = ["ControlSettings", "Controller"]
