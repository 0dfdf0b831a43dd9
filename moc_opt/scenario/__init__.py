"""A validated scenario, and its run: the only package that joins solver, controller and plant.

Read first: ``config`` (``Scenario``: every key of the TOML; ``tables`` has some of its tables), then ``setup``
(``Setup`` builds the objects; ``Setup.trace`` and ``run`` make a trace). ``layout`` lays the task out from a start,
``preflight`` says whether the arm can do it and draws random starts. ``derived`` has columns computed after a run,
``planned`` plans before a run. ``wired`` puts a wire between plant and controller.
"""

from moc_opt.errors import MocOptError
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.setup import Setup, isolated, make_safety_filter, make_solver, make_stop, run
from moc_opt.sim.record import RunAway

__all__ = [
    "MocOptError", "RunAway", "Scenario", "Setup", "isolated", "make_safety_filter", "make_solver", "make_stop", "run",
]  # fmt: skip
