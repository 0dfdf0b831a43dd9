"""What every worker of the study needs: the server that workers are forked from imports and compiles it once.

``python -m benchmarks.common.preload exact`` compiles that solver alone, ``rnn`` the loop: two processes share
the work.
"""

import sys
from contextlib import suppress

import numpy as np

from moc_opt import NullSpaceQP, scenario
from moc_opt.errors import MocOptError
from moc_opt.solvers import create


def solve(name: str) -> None:
    """Compile one solver."""
    J, zero, one = np.eye(6, 7), np.zeros(3), np.ones(7)
    qp = NullSpaceQP(J[:3], J[3:], zero, zero, grad_mu=one, lower=-one, upper=one)
    create(name).start(qp).solve(qp)


def run(name: str) -> None:
    """Compile the closed loop, and what judges it."""
    scenario.run(
        scenario.Scenario(duration_s=0.004, bound_samples=2, solver={"name": name}, start={"swivel": "random"})
    )


with suppress(MocOptError):  # a worker that meets the same error will say so
    if __name__ == "__main__":
        {"exact": solve, "rnn": run}[sys.argv[1]](sys.argv[1])
    else:
        run("exact")
        run("rnn")
        create("osqp")
