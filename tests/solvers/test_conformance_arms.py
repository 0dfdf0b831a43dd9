"""Every solver on recorded subproblems of every arm of the package, under the tolerances of the conformance suite."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from moc_opt.model.robot_model import load_robot
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.robots import available_robots
from moc_opt.scenario import Scenario, run
from moc_opt.solvers import Solver, Status, create
from tests.solvers.test_conformance import expect, share, solver

COUNT = 12
EVERY = 25
"""Ticks between two recorded subproblems."""


@cache
def recorded(arm: str) -> list[NullSpaceQP]:
    """The subproblems of the first 0.6 s of the default run, while the elbow sets off."""
    trace = run(Scenario(robot={"name": arm}, duration_s=COUNT * EVERY * 0.002, bound_samples=0, judge=False))
    return [NullSpaceQP.from_row(row) for row in trace.columns["subproblem"][::EVERY]]


@cache
def kinematics(arm: str) -> Any:
    return load_robot(arm).kinematics()


def solver_for(name: str, arm: str) -> Solver:
    if not expect(name).arm:
        return solver(name)
    return create(name, **expect(name).settings, kinematics=kinematics(arm))


def names() -> list[str]:
    from tests.solvers.test_conformance import NAMES

    return NAMES


@pytest.mark.parametrize("arm", available_robots())
@pytest.mark.parametrize("name", names())
def test_claimed_answers_to_recorded_subproblems_are_optimal(name: str, arm: str) -> None:
    limits, qps = expect(name), recorded(arm)
    chosen = solver_for(name, arm)
    session = chosen.start(qps[0])
    found = [session.solve(qp) for qp in qps]
    exact = create("exact").start(qps[0])
    assert share(found, Status.SOLVED) >= limits.solved
    for qp, solution in zip(qps, found, strict=True):
        best = exact.solve(qp)
        assert best.status is Status.SOLVED
        if solution.status is Status.SOLVED:
            residuals = qp.residuals(solution.x, solution.y)
            assert residuals.verified(limits.primal, limits.relative, limits.loss), residuals
            assert np.abs(solution.x - best.x).max() <= limits.x


def test_the_arms_pose_different_problems() -> None:
    """Eight joints and two real freedoms on the rail; no two arms have the same Jacobian."""
    sizes = {arm: recorded(arm)[0].n for arm in available_robots()}
    assert {arm for arm, n in sizes.items() if n == 8} == {"lwr4_rail"}
    firsts = [recorded(arm)[0].J_tip.ravel()[:21] for arm in available_robots()]
    assert all(np.abs(a - b).max() > 1e-3 for i, a in enumerate(firsts) for b in firsts[:i])
