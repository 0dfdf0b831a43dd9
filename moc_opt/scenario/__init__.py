"""A validated scenario and its run. Only this package connects solver, controller and plant.

Read first: ``config``, whose class ``Scenario`` has every key of the TOML file (``tables`` defines some tables). Then
read ``setup``: ``Setup`` builds the objects, and ``Setup.trace`` or ``run`` makes a trace. ``layout`` computes the task
from a start pose. ``preflight`` checks that the arm can do the task, and draws random starts. ``planned`` plans joint
motions before a run. ``derived`` adds columns to a trace. ``wired`` runs plant and controller in two processes.
"""

from moc_opt.errors import MocOptError
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.setup import Setup, isolated, make_safety_filter, make_solver, make_stop, run
from moc_opt.sim.record import RunAway

__all__ = [
    "MocOptError", "RunAway", "Scenario", "Setup", "isolated", "make_safety_filter", "make_solver", "make_stop", "run",
]  # fmt: skip
