"""A validated scenario, and its run: the only room that puts solver, controller and plant together.

Read first: ``config`` (``Scenario``: every key of the TOML), then ``objects`` (what is built from it) and ``setup``
(``Setup.trace`` and ``run`` make a trace). ``parts`` makes solver and safety filter, ``derived`` the columns
computed from a run's; ``layout`` lays the task out from a start, ``adapter`` joins controller and loop, ``agreement``
compares the two engines, ``rows`` prepares references by the block, ``wired`` puts a wire between plant and controller.
Imported by comparison, export, live, the command line and benchmarks.
"""

from moc_opt.errors import MocOptError
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.parts import make_safety_filter, make_solver, make_stop
from moc_opt.scenario.setup import Setup, run
from moc_opt.sim.record import RunAway

__all__ = [
    "MocOptError", "RunAway", "Scenario", "Setup", "make_safety_filter", "make_solver", "make_stop", "run",
]  # fmt: skip
