"""Recorded subproblems: those of a closed-loop run, tick by tick, the same for all solvers."""

from __future__ import annotations

import numpy as np

from moc_opt.qp.problem import NullSpaceQP
from moc_opt.scenario import Scenario, run


def record(scenario: Scenario) -> list[NullSpaceQP]:
    """Record the 500 Hz sequence of subproblems that a closed-loop run of ``scenario`` meets."""
    rows = run(scenario.change(judge=False, bound_samples=0)).subproblem
    return [NullSpaceQP.from_row(np.array(row)) for row in rows]


def expand(problems: list[NullSpaceQP]) -> None:
    """Compute what the adapters read (P, p, the five rows) before the clock starts."""
    for qp in problems:
        _ = qp.P, qp.p, qp.q
        qp.reduced()
