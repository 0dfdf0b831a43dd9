"""The nonlinear programs: what they converge to, and that they see the manipulability, not its gradient."""

from __future__ import annotations

import numpy as np
import pytest

from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers import Status, create
from moc_opt.solvers.nlp import SQP, Ipopt
from tests.problems import random_arm, random_problem

ARM = random_arm(np.random.default_rng(3))
KINEMATICS = ARM.kinematics()
EVERY = pytest.mark.parametrize("kind", [SQP, Ipopt])


def solve(chosen, qp):
    return chosen.start(qp).solve(qp)


def number(function, q):
    """The value of a CasADi function as a flat array."""
    return function(q).full().ravel()


@EVERY
def test_error_against_the_linear_problem_shrinks_with_the_period(kind):
    """In the limit T -> 0 the program is the null-space subproblem: every residual falls in proportion."""
    rng = np.random.default_rng(1)
    worst = {}
    qps = [random_problem(rng, arm=ARM) for _ in range(10)]
    for period in (2e-3, 2e-4, 2e-5):
        chosen = kind(KINEMATICS, period=period)
        found = [(qp, solve(chosen, qp)) for qp in qps]
        assert all(solution.status is Status.SOLVED for _, solution in found)
        worst[period] = max(qp.residuals(s.x).primal for qp, s in found)
        if period == 2e-5:
            assert all(qp.residuals(s.x).verified(primal=1e-4) for qp, s in found)
            for qp, s in found:  # the duals are those of the six linear rows
                assert qp.residuals(s.x, s.y).natural < 2e-6
                assert qp.residuals(s.x, -s.y).natural > 1e-5
    assert worst[2e-4] == pytest.approx(0.1 * worst[2e-3], rel=0.2)
    assert worst[2e-5] == pytest.approx(0.1 * worst[2e-4], rel=0.2)


@EVERY
def test_the_step_lands_where_the_references_say(kind):
    """tip(q + x T) = tip(q) + v_T T, exactly and not to first order; the wrist across the tool likewise."""
    rng = np.random.default_rng(2)
    for _ in range(5):
        qp = random_problem(rng, arm=ARM)
        chosen = kind(KINEMATICS)
        x = solve(chosen, qp).x
        T = chosen.period
        places = KINEMATICS.tip, KINEMATICS.wrist
        tip, wrist = ((number(f, qp.q + T * x) - number(f, qp.q)) / T for f in places)
        np.testing.assert_allclose(tip, qp.v_tip, atol=1e-6)
        across = qp.reduced().lift[3:, 3:]
        np.testing.assert_allclose(across @ wrist, across @ qp.v_wrist, atol=1e-6)
        tool = number(KINEMATICS.tip, qp.q) - number(KINEMATICS.wrist, qp.q)
        np.testing.assert_allclose(across @ tool, 0.0, atol=1e-12)
        assert np.abs(qp.A @ x - qp.b).max() > 1e-6  # the linear rows are another matter


def test_sqp_without_damping_answers_by_bfgs_and_often_not_by_the_exact_hessian():
    """Which is indefinite there: BFGS is the default for that reason."""
    rng = np.random.default_rng(5)
    losses = {"limited-memory": [], "exact": []}
    for _ in range(40):
        qp = random_problem(rng, arm=ARM, regularization=0.0)
        for hessian, found in losses.items():
            solution = solve(SQP(KINEMATICS, hessian=hessian), qp)
            if solution.status is Status.SOLVED:
                found.append(float(qp.residuals(solution.x).loss))
    assert len(losses["limited-memory"]) >= 38
    assert max(losses["limited-memory"]) < 0.1
    assert len(losses["exact"]) <= 34


def test_what_the_gradient_has_beside_mu_is_answered_too(robot, regular_poses):
    """A gradient of something else, such as a course to follow, in the place of that of mu."""
    rng = np.random.default_rng(11)
    chosen = create("nlp-sqp", kinematics=robot.kinematics())
    for q in regular_poses(4):
        state, ends = robot.state(q), 0.5 * np.ones(robot.n)
        for gradient in (state.grad_mu, -state.grad_mu, rng.normal(size=robot.n) * np.abs(state.grad_mu).max()):
            zero = np.zeros(3)
            qp = NullSpaceQP(state.J_tip, state.J_wrist, zero, zero, gradient, -ends, ends, regularization=1e-3, q=q)
            best = create("exact").start(qp).solve(qp)
            np.testing.assert_allclose(solve(chosen, qp).x, best.x, atol=0.05)
