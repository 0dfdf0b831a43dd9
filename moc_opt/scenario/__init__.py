"""A validated scenario, and its run: the only composer."""

from moc_opt.scenario.setup import (
    MocOptError,
    RunAway,
    Safe,
    Scenario,
    Setup,
    make_guard,
    make_solver,
    make_stop,
    run,
)  # fmt: skip

__all__ = [
    "MocOptError", "RunAway", "Safe", "Scenario", "Setup", "make_guard", "make_solver", "make_stop", "run",
]  # fmt: skip
