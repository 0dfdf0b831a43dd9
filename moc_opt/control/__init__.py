"""The hierarchical torque controller (tip, remote centre of motion, manipulability) and its checks.

Read first: ``controller`` (a tick, from state to torque) and ``law`` (its numbers, for `moc_opt.core`, which has the
equations). ``supervisor`` refuses wrong answers of a solver; ``safety_filter`` checks measurements and limits torques.
Solvers are passed in: of ``solvers`` only ``base``, ``exact`` and ``isolated`` are imported here. ``sim`` imports this
package only for type checking.
"""

from moc_opt.control.controller import Controller
from moc_opt.control.settings import ControlSettings

__all__ = ["ControlSettings", "Controller"]
