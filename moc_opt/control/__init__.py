"""The hierarchical torque controller: tip, remote centre of motion, manipulability; and what checks it.

Read first: ``controller`` (one tick, from state to torque), then its levels ``tip_impedance``, ``rcm``,
``null_space``. ``supervisor`` and ``solution_check`` refuse wrong answers of a solver; ``safety_filter`` (the
guard), ``motion`` and ``incision`` check measurements and limits. Solvers are passed in: of ``solvers`` only
``base`` is imported here. Imported by embedded, procedure, scenario and live; never by sim, which knows the
guard as a protocol.
"""

from moc_opt.control.controller import Controller
from moc_opt.control.settings import ControlSettings

__all__ = ["ControlSettings", "Controller"]
