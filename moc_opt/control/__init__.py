"""The hierarchical torque controller (tip, remote centre of motion, manipulability) and its checks.

Read first: ``controller`` (a tick, from state to torque), ``tick`` (its equations) and ``law`` (their constants), then
the levels ``tip_impedance``, ``rcm``, ``null_space``. ``supervisor`` and ``solution_check`` refuse wrong answers of
a solver, ``isolated`` runs one in a process of its own (``worker``, ``exchange``); ``safety_filter``, ``motion`` and
``incision`` check measurements and limits, compiled in ``safety_tick``. Solvers are passed in: of ``solvers`` only
``base`` is imported here.
Imported by embedded, procedure, scenario, commissioning and live; never by sim, whose protocol of a safety filter
is the interface.
"""

from moc_opt.control.controller import Controller
from moc_opt.control.settings import ControlSettings

__all__ = ["ControlSettings", "Controller"]
