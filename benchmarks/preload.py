"""What every worker of the study needs: the server that workers are forked from imports and compiles it once."""

from contextlib import suppress

from moc_opt import scenario
from moc_opt.errors import MocOptError
from moc_opt.solvers import create

with suppress(MocOptError):  # a worker that meets the same error will say so
    for _name in ("exact", "rnn"):
        scenario.run(
            scenario.Scenario(duration_s=0.004, bound_samples=2, solver={"name": _name}, start={"swivel": "random"})
        )
    create("osqp")
