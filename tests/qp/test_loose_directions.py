"""Near a straight elbow, no answer that loses over 1 % of (largest - smallest feasible cost) is verified."""

from fractions import Fraction

import numpy as np
import pytest
from scipy.linalg import null_space

import moc_opt as mo
from benchmarks.certify import optimum
from moc_opt.qp.problem import NullSpaceQP, fields
from tests.wrong_answers import candidates, cost

ROBOTS = [mo.load_robot(name) for name in ("lwr4", "iiwa14", "panda", "gen3", "xarm7", "lwr4_rail")]
SIZES = 10.0 ** np.arange(-13, -3)


def extremes(Z, base, qp):
    """Return the optimum (n,), and the least and largest feasible cost."""
    points = candidates(qp, Z, base, damped=True)
    if not len(points):
        return None
    costs = cost(qp, points)
    return points[np.argmin(costs)], costs.min(), costs.max()


def random_case(rng, freedoms, size):
    """Return a subproblem, a feasible point, ker A, and A's nearly singular direction."""
    n = freedoms + 5
    U, V = (np.linalg.qr(rng.normal(size=(k, k)))[0] for k in (6, n))
    A = U[:, :5] * [1.0, 0.8, 0.6, 0.4, size] @ V[:, :5].T
    upper = rng.uniform(0.5, 2.0, n)
    x = rng.uniform(-0.4, 0.4, n)
    b, grad = A @ x, rng.normal(size=n)
    rho = rng.choice([0.0, 1e-5, 1e-4, 1e-3])
    qp = NullSpaceQP(A[:3], A[3:], b[:3], b[3:], grad, -upper, upper, regularization=rho)
    return qp, x, V[:, rank(A) :], V[:, 4]


def arm_case(rng, robot, size):
    """Return a subproblem of an arm with an almost straight elbow."""
    q = robot.random_regular_pose(rng)
    elbow = robot.n - 4
    q[elbow] = np.clip(size * rng.choice([-3.0, 3.0]), robot.q_min[elbow], robot.q_max[elbow])
    state = robot.state(q)
    A, x = np.vstack([state.J_tip, state.J_wrist]), rng.uniform(-0.3, 0.3, robot.n)
    b = A @ x
    qp = NullSpaceQP(A[:3], A[3:], b[:3], b[3:], state.grad_mu, -robot.v_max, robot.v_max,
                     regularization=rng.choice([0.0, 1e-5, 1e-4]))  # fmt: skip
    vh = np.linalg.svd(A)[2]
    return qp, x, vh[rank(A) :].T, vh[4]


def rank(A):
    return 5 if np.linalg.svd(A)[1][4] > 1e-12 * np.linalg.norm(A) else 4


def attack(rng, qp, base, Z, direction):
    """Move the optimum along `direction`, with |A x - b| at most 1e-6. Return pairs (x, loss of x)."""
    best = extremes(Z, base, qp)
    if best is None:
        return []
    x, least, most = best
    assert qp.residuals(x).verified()
    scale = qp.c2 * np.abs(qp.grad_mu).max() * (qp.upper - qp.lower).max()
    if most - least < 1e-6 * scale:
        return []  # the cost is constant
    length = min(1.0, 0.9e-6 / max(np.abs(qp.A @ direction).max(), 1e-30)) * rng.uniform(0.2, 1.0)
    found = []
    for sign in (-1.0, 1.0):
        slid = extremes(Z, base + sign * length * direction, qp)
        answers = [np.clip(x + sign * length * direction, qp.lower, qp.upper)]
        for answer in answers if slid is None else [*answers, slid[0]]:
            if np.abs(qp.A @ answer - qp.b).max() <= 1e-6:
                found.append((answer, (cost(qp, answer) - least) / (most - least)))
    return found


def attempts(rng, count):
    """Yield pairs (subproblem, wrong answer) with a loss above 1 %."""
    while count > 0:
        size = rng.choice(SIZES) * rng.uniform(0.5, 2.0)
        kind = rng.integers(9)
        made = random_case(rng, 1 + kind, size) if kind < 3 else arm_case(rng, ROBOTS[kind - 3], size)
        for x, loss in attack(rng, *made):
            count -= 1
            if loss > 0.01:
                yield made[0], x


@pytest.mark.parametrize("seed", range(3))
def test_wrong_answer_within_primal_tolerance_is_not_verified(seed):
    rng = np.random.default_rng(seed)
    tried = [(qp, x, qp.residuals(x)) for qp, x in attempts(rng, 80)]
    assert len(tried) > 10
    fooled = [(qp, x, found) for qp, x, found in tried if found.verified()]
    assert not fooled, fooled[0]
    assert all(found.loss > 0.0 or found.relative > 1e-3 for _, _, found in tried)


@pytest.mark.parametrize("regularization", [0.0, 0.01])
@pytest.mark.parametrize("freedoms", [1, 2])
def test_relative_residual_is_the_scaled_excess_cost_if_only_one_point_is_feasible(freedoms, regularization):
    qp, base, Z, direction = random_case(np.random.default_rng(0), freedoms, 1e-9)
    row, pinned = np.array(qp.row), [3, 6][:freedoms]
    fields(row).lower[pinned] = fields(row).upper[pinned] = base[pinned]
    fields(row).weights[3] = regularization
    one, way = NullSpaceQP.from_row(row), direction - Z @ np.linalg.solve(Z[pinned], direction[pinned])
    slid = max((base + step * way for step in (-0.3, 0.3)), key=lambda x: cost(one, x))
    scale = max(one.c2 * np.abs(Z @ (one.pull @ Z)).max(), one.regularization)
    assert one.residuals(slid).relative == pytest.approx((cost(one, slid) - cost(one, base)) / scale, rel=1e-6)


def far_ends(A, b, pull, lower, upper):
    """Return the feasible points (2, n) of largest and smallest pull^T x, in rational arithmetic."""
    gains = [Fraction(value) for value in pull]
    found = [optimum(A, b, [sign * gain for gain in gains], 0.0, lower, upper) for sign in (1, -1)]
    return None if None in found else np.array([[float(value) for value in point] for point in found])


@pytest.mark.parametrize("size", 10.0 ** np.arange(-11, -1, 2))
def test_only_the_better_end_of_the_feasible_segment_is_verified(size):
    """The gradient is nearly orthogonal to the self-motion."""
    rng, seen = np.random.default_rng(int(-np.log10(size))), 0
    for slope, width in [(1e-2, 1e-4), (1e-4, 1e-2), (1e-6, 1e-4), (1e-8, 1e-2), (1e-8, 3e-6)] * 3:
        unit = rng.choice([1.0, 1e3])  # lengths in m or in mm
        U, V = (np.linalg.qr(rng.normal(size=(k, k)))[0] for k in (5, 6))
        A, x = unit * U * [1.0, 0.8, 0.6, 0.4, size] @ V[:, :5].T, rng.uniform(-0.4, 0.4, 6)
        b, lower, upper = A @ x, x - rng.uniform(0.5, 1.0, 6), x + rng.uniform(0.5, 1.0, 6)
        ends = far_ends(A, b, V[:, 5], lower, upper)
        z = (ends[0] - ends[1]) / np.linalg.norm(ends[0] - ends[1])
        joint, across = int(np.argmax(np.abs(z))), rng.normal(size=6)
        across -= z * (z @ across)
        lower[joint], upper[joint] = x[joint] - width / 2, x[joint] + width / 2
        pull = across / np.linalg.norm(across) + slope * rng.choice([-1.0, 1.0]) * z
        ends = far_ends(A, b, pull, lower, upper)
        if ends is not None and np.abs(ends[0] - ends[1]).max() > 2e-6:
            six = np.vstack([A, np.zeros(6)])
            qp = NullSpaceQP(six[:3], six[3:], b[:3], [*b[3:], 0.0], pull, lower, upper, regularization=0.0)
            verified = [qp.residuals(np.clip(point, lower, upper)).verified() for point in ends]
            assert verified == [True, False], (slope, width)
            seen += 1
    assert seen > 9


def test_rounding_of_the_jacobians_does_not_limit_the_self_motion():
    """Due to rounding, the elbow seems to move. Its bounds of 0 rad/s must not block the self-motion."""
    state = ROBOTS[0].state(np.array([-2.405, -0.753, 0.226, -0.016, 1.96, -2.009, 2.289]), np.zeros(7))
    A, bounds = np.round(state.A, 13), np.ones(7)
    z = null_space(np.delete(state.A, [3, 6], axis=1), rcond=1e-7)[:, 0]
    bounds[3] = 0.0
    qp = NullSpaceQP(A[:3], A[3:], np.zeros(3), np.zeros(3), np.insert(z, [3, 5], 0.0), -bounds, bounds)
    found = qp.residuals(np.zeros(7))
    assert found.loss > 0.1
    assert not found.verified()
