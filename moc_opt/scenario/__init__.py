"""A validated scenario and its run.

``config`` defines the keys of the TOML file, and ``setup`` builds and runs a scenario.
"""

from moc_opt.errors import MocOptError
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.setup import Setup, isolated, make_safety_filter, make_solver, make_stop, run
from moc_opt.sim.record import RunAway

__all__ = [
    "MocOptError", "RunAway", "Scenario", "Setup", "isolated", "make_safety_filter", "make_solver", "make_stop", "run",
]  # fmt: skip
