"""A validated scenario and its run. Only this package joins solver, controller and plant.

Read first: ``config`` (``Scenario``: every key of the TOML; ``tables`` has some of its tables), then ``setup``
(``Setup`` builds the objects; ``Setup.trace`` and ``run`` make a trace). ``layout`` computes the task from a start
pose. ``preflight`` checks that the arm can do the task, and draws random starts. ``planned`` plans before a run, and
``derived`` adds columns after it. ``wired`` runs plant and controller in two processes.
"""

from moc_opt.errors import MocOptError
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.setup import Setup, isolated, make_safety_filter, make_solver, make_stop, run
from moc_opt.sim.record import RunAway

__all__ = [
    "MocOptError", "RunAway", "Scenario", "Setup", "isolated", "make_safety_filter", "make_solver", "make_stop", "run",
]  # fmt: skip
