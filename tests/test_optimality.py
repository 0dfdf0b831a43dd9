"""The judge is judged: against a linear program, against perturbed optima, against the definition."""

import numpy as np
import pytest
from scipy.optimize import linprog

from moc_opt.errors import SubproblemError
from moc_opt.solvers.exact import Exact
from tests.problems import random_problem

CASES = [(7, True), (7, False), (8, False)]


def optimum(qp):
    solution = Exact().start(qp).solve(qp)
    return solution.x, solution.y


@pytest.mark.parametrize("damping", [0.0, 1e-5])
@pytest.mark.parametrize(("n", "structured"), CASES)
def test_optimum_passes_and_its_neighbours_fail(n, structured, damping):
    rng = np.random.default_rng(5)
    for _ in range(15):
        qp = random_problem(rng, n, structured=structured, damping=damping)
        x, y = optimum(qp)
        found = qp.residuals(x, y)
        assert found.verified()
        assert max(found.primal, found.natural, found.natural_best) < 1e-12
        broken = x + 1e-3 * rng.choice([-1.0, 1.0], size=n)
        assert not qp.residuals(broken, y).verified()
        inside = x + 0.2 * (np.linalg.lstsq(qp.A, qp.b, rcond=None)[0] - x)
        slid = qp.residuals(inside)
        assert slid.primal < 1e-2 or not slid.verified()


@pytest.mark.parametrize("damping", [0.0, 1e-5])
def test_bad_duals_are_told_from_a_bad_answer(damping):
    rng = np.random.default_rng(6)
    qp = random_problem(rng, damping=damping)
    x, y = optimum(qp)
    found = qp.residuals(x, y + 1.0)
    assert found.natural > 1e-2
    assert found.natural_best < 1e-12
    assert found.verified()


@pytest.mark.parametrize(("n", "structured"), CASES)
def test_best_natural_is_the_smallest_over_all_duals(n, structured):
    """Against the definition: bisection on t, with a linear program in y deciding each t."""
    rng = np.random.default_rng(7)

    def reachable(qp, x, t):
        g0 = qp.P @ x + qp.p
        high = np.where(x - qp.lower <= t, np.inf, t)
        low = np.where(qp.upper - x <= t, -np.inf, -t)
        A = np.vstack([qp.A.T, -qp.A.T])
        b = np.concatenate([high - g0, g0 - low])
        keep = np.isfinite(b)
        if not keep.any():
            return True
        scale = 1e4  # the numbers are small against the program's own tolerance
        return linprog(np.zeros(6), A_ub=A[keep], b_ub=b[keep] * scale, bounds=(None, None)).status == 0

    for _ in range(6):
        qp = random_problem(rng, n, structured=structured)
        x = np.clip(optimum(qp)[0] + rng.normal(scale=1e-5, size=n), qp.lower, qp.upper)
        low, high = 0.0, 1.0
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if reachable(qp, x, middle) else (middle, high)
        assert qp.residuals(x).natural_best == pytest.approx(high, rel=2e-3, abs=2e-9)


@pytest.mark.parametrize("damping", [0.0, 1e-5])
def test_loss_runs_from_zero_to_one_along_the_self_motion(damping):
    rng = np.random.default_rng(8)
    for _ in range(10):
        qp = random_problem(rng, damping=damping)
        x, _ = optimum(qp)
        _, _, vh = np.linalg.svd(qp.A)
        kernel = vh[5:]
        line = kernel.T @ (kernel @ qp.grad_mu)
        line /= np.linalg.norm(line)
        used = np.abs(line) > 1e-9
        steps = np.stack([(qp.lower - x)[used] / line[used], (qp.upper - x)[used] / line[used]])
        low, high = steps.min(0).max(), steps.max(0).min()
        worst = low if abs(low) > abs(high) else high
        assert qp.residuals(x).loss == pytest.approx(0.0, abs=1e-9)
        assert qp.residuals(x + worst * line).loss == pytest.approx(1.0, abs=1e-9)
        assert qp.residuals(x + 0.25 * worst * line).loss == pytest.approx(0.25, abs=1e-9)


def test_nan_is_infinitely_wrong():
    qp = random_problem(np.random.default_rng(9))
    found = qp.residuals(np.full(7, np.nan))
    assert found.primal == np.inf
    assert found.loss == 1.0
    assert not found.verified()


def test_relative_measures_against_the_gradient():
    """Half the gradient left over is half the gradient, whatever its size."""
    rng = np.random.default_rng(10)
    qp = random_problem(rng, damping=0.0)
    middle = optimum(random_with(qp, c2=0.001, damping=1.0))[0]
    big, small = (random_with(qp, c2=c, damping=0.0).residuals(middle).relative for c in (1.0, 1e-6))
    assert big == pytest.approx(small, rel=1e-9)


def random_with(qp, **changes):
    return type(qp)(qp.J_tip, qp.J_wrist, qp.v_tip, qp.v_wrist, qp.grad_mu, qp.lower, qp.upper, **changes)


def test_more_freedoms_than_can_be_judged_are_refused_at_once():
    qp = random_problem(np.random.default_rng(9), 48)
    with pytest.raises(SubproblemError, match=r"48 joints with 43 freedoms .* up to 25 joints"):
        qp.residuals(*optimum(qp))
