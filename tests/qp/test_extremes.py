"""The smallest and the largest cost on A x = b within the bounds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from moc_opt.qp import extremes as module
from moc_opt.qp.extremes import extremes, nearest
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.exact import Exact

SHAPES = st.sampled_from([(2, 1), (5, 2), (7, 2), (8, 3), (9, 4), (10, 5), (16, 11)])


def cut_box(seed, shape, size=1.0):
    """Return Z (n, r), bounds (n,) around a feasible point, and a slope (r,)."""
    rng = np.random.default_rng(seed)
    n, r = shape
    Z = np.linalg.qr(rng.normal(size=shape))[0]
    inside = size * Z @ rng.normal(size=r)
    low, high = inside - size * rng.uniform(0.0, 2.0, n), inside + size * rng.uniform(0.0, 2.0, n)
    return Z, low, high, rng.normal(size=r) * 10.0 ** rng.uniform(-6, 2)


def program(Z, low, high, slope):
    found = linprog(
        slope / np.abs(slope).max(), A_ub=np.vstack([Z, -Z]), b_ub=np.concatenate([high, -low]), bounds=(None, None)
    )
    assert found.status == 0
    return found.fun * np.abs(slope).max()


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), shape=SHAPES, size=st.sampled_from([1.0, 1e-4]))
def test_extremes_of_linear_costs_agree_with_highs(seed, shape, size):
    Z, low, high, slope = cut_box(seed, shape, 1.0)
    least, most = program(Z, low, high, slope), -program(Z, low, high, -slope)
    found = extremes(Z, size * low, size * high, slope, 0.0)
    spread = size * (most - least)
    assert found.least == pytest.approx(size * least, abs=1e-6 * spread)
    assert found.most == pytest.approx(size * most, abs=1e-6 * spread)
    assert slope @ found.w == pytest.approx(found.least, abs=1e-9 * spread)
    beyond = np.maximum(size * low - Z @ found.w, Z @ found.w - size * high).max()
    assert beyond < 1e-11 * size * shape[1]


@settings(max_examples=100)
@given(
    seed=st.integers(0, 10**6), shape=SHAPES, weight=st.floats(-9.0, 2.0), size=st.sampled_from([1e-6, 1e-4, 1.0, 1e3])
)
def test_a_regularized_optimum_is_certified_and_the_worst_point_is_a_corner(seed, shape, weight, size):
    Z, low, high, slope = cut_box(seed, shape, size)
    regularization = float(np.linalg.norm(slope) * 10.0**weight / size)
    found = extremes(Z, low, high, slope, regularization)
    cost = lambda w: slope @ w + 0.5 * regularization * (w * w).sum(0)  # noqa: E731
    spread = found.most - found.least
    assert cost(found.w) == pytest.approx(found.least, abs=1e-8 * spread)
    assert np.maximum(low - Z @ found.w, Z @ found.w - high).max() < 1e-10 * size
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(shape[1], 200))
    moved = Z @ directions
    with np.errstate(divide="ignore"):
        room = np.where(moved > 0.0, (high - Z @ found.w)[:, None], (low - Z @ found.w)[:, None]) / moved
    w = found.w[:, None] + directions * np.maximum(room.min(0), 0.0)
    assert cost(w).min() >= found.least - 1e-9 * spread
    if module.comb(*shape) << shape[1] <= module.MOST_CORNERS:
        assert cost(w).max() <= found.most + 1e-9 * spread
    np.testing.assert_allclose(Z.T @ found.pull, slope, atol=1e-9 * np.abs(slope).max())


@pytest.mark.parametrize("shape", [(7, 2), (8, 3), (9, 4)])
def test_with_many_corners_the_largest_cost_is_not_overstated(shape, monkeypatch):
    """An underestimate is safe: it only raises an answer's loss, (cost - smallest cost) / (largest - smallest cost)."""
    exact = []
    for seed in range(15):
        Z, low, high, slope = cut_box(seed, shape)
        regularization = float(np.linalg.norm(slope))
        whole = extremes(Z, low, high, slope, regularization)
        with monkeypatch.context() as patch:
            patch.setattr(module, "MOST_CORNERS", 0)
            bound = extremes(Z, low, high, slope, regularization)
        assert bound.least == pytest.approx(whole.least, rel=1e-9)
        assert whole.least < bound.most <= whole.most * (1.0 + 1e-9)
        exact.append(bound.most > whole.most * (1.0 - 1e-6))
    assert np.mean(exact) >= 0.5


@pytest.mark.parametrize("shape", [(12, 7), (16, 10), (24, 18)])
def test_uphill_walks_find_the_largest_linear_cost(shape):
    """Some velocity bounds are 1000 times narrower than others."""
    for seed in range(5):
        Z, low, high, slope = cut_box(seed, shape)
        narrow = 10.0 ** np.random.default_rng(seed).uniform(-3.0, 0.0, shape[0])
        inside = nearest(Z, low, high, np.zeros(shape[1]))[0]
        low, high = (Z @ inside + narrow * (bound - Z @ inside) for bound in (low, high))
        least, most = program(Z, low, high, slope), -program(Z, low, high, -slope)
        found = extremes(Z, low, high, slope, 1e-12 * float(np.linalg.norm(slope)))
        assert found.most == pytest.approx(most, abs=1e-6 * (most - least))


@pytest.mark.parametrize(("weight", "steps"), [(0.0, 2), (1e-4, 2), (1.0, 1)])
def test_few_proximal_steps_lead_to_the_optimum(weight, steps, monkeypatch):
    (Z, low, high, slope), calls = cut_box(3, (8, 3)), []
    slope /= np.linalg.norm(slope)
    monkeypatch.setattr(module, "nearest", lambda *given: calls.append(given) or nearest(*given))
    module.optimum(Z, low, high, slope, weight)
    assert len(calls) <= steps


def test_optimum_nearest_to_zero_is_found():
    found = extremes(np.eye(3), -np.ones(3), np.ones(3), np.array([1.0, 1e-4, 0.0]), 0.0)
    np.testing.assert_allclose(found.w, [-1.0, -1.0, 0.0], atol=1e-11)
    assert (found.least, found.most) == pytest.approx((-1.0001, 1.0001))


def test_empty_feasible_set_gives_none():
    Z = np.array([[1.0], [1.0]]) / np.sqrt(2.0)
    apart = np.array([0.0, 1.0]), np.array([0.5, 2.0])
    assert nearest(Z, *apart, np.zeros(1)) is None
    for regularization in (0.0, 1.0):
        assert extremes(Z, *apart, np.ones(1), regularization) is None
    touching = np.array([0.0, 0.5]), np.array([0.5, 2.0])
    assert nearest(Z, *touching, np.zeros(1))[0] == pytest.approx([0.5 * np.sqrt(2.0)])


def test_cost_range_below_rounding_counts_as_zero():
    Z = np.eye(2)
    found = extremes(Z, np.array([0.0, 0.0]), np.array([1e-13, 1.0]), np.array([1.0, 0.0]), 0.0)
    assert found.least == found.most == 0.0
    shifted = extremes(Z, np.array([-3.0, -3.0]), np.array([1e-13 - 3.0, -2.0]), np.array([1.0, 0.0]), 0.0)
    assert shifted.least == shifted.most == pytest.approx(-3.0)
    for short in (1e-8, 1e-11):  # short, but above rounding
        found = extremes(Z, np.array([0.0, 0.0]), np.array([short, 1.0]), np.array([-1.0, 0.0]), 0.0)
        assert found.least == pytest.approx(-short)


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), shape=SHAPES)
def test_the_nearest_point_satisfies_its_optimality_conditions(seed, shape):
    Z, low, high, _ = cut_box(seed, shape)
    start = 5.0 * np.random.default_rng(seed + 1).normal(size=shape[1])
    w, force = nearest(Z, low, high, start)
    x = Z @ w
    np.testing.assert_allclose(Z.T @ force, w - start, atol=1e-9)
    assert np.maximum(low - x, x - high).max() < 1e-12 * 20
    at_low, at_high = np.abs(x - low) < 1e-9, np.abs(x - high) < 1e-9
    assert (force[~at_low] <= 0.0).all()
    assert (force[~at_high] >= 0.0).all()
    for part in nearest(np.eye(2), np.array([0.0, -1.0]), np.ones(2), np.zeros(2)):  # the start is at a bound
        np.testing.assert_array_equal(part, np.zeros(2))


def test_two_joints_with_equal_rows_of_the_basis_define_no_corner():
    Z = np.linalg.qr(np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, -0.7]]))[0]
    Z[1] = Z[0]  # bitwise equal
    low, high, slope, regularization = -np.ones(4), np.ones(4), np.array([0.3, -0.2]), 0.5
    found = extremes(Z, low, high, slope, regularization)
    ring = np.linspace(0.0, 2.0 * np.pi, 20001)
    rays = np.stack([np.cos(ring), np.sin(ring)])
    edge = rays / np.abs(Z @ rays).max(0)  # the border of the set
    worst = (slope @ edge + 0.5 * regularization * (edge**2).sum(0)).max()
    assert found.most == pytest.approx(worst, rel=1e-3)


@pytest.mark.parametrize("small", [1e-2, 1e-4, 1e-5, 1e-7])
def test_nearest_point_of_a_distant_set_is_exact_up_to_rounding(small):
    for seed in range(10):
        z = np.append(small, np.random.default_rng(seed).normal(size=3))
        Z = (z / np.linalg.norm(z))[:, None]
        far = np.full(3, 10.0 / small)
        low, high = np.append(0.7, -far), np.append(1.0, far)
        w, force = nearest(Z, low, high, np.zeros(1))
        assert Z[0] @ w == pytest.approx(0.7, rel=1e-14)
        np.testing.assert_allclose(Z.T @ force, w, rtol=1e-9)


@pytest.mark.parametrize("seed", [285, 568, 649, 1706, 1724, 4198, 4585])
def test_optimum_is_verified_if_all_feasible_points_are_at_bounds(seed):
    """The duals of such an optimum can be very large."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(8, 13))
    A = rng.normal(size=(6, n))
    A[3:] = A[:3] + np.cross(rng.normal(size=(n, 3)), [0.0, 0.0, 0.3]).T
    A[:, 1:6:2] = A[:, 0:6:2]
    lower, upper = -rng.uniform(0.1, 1, n), rng.uniform(0.1, 1, n)
    side = A.T @ np.linalg.svd(A[:, rng.choice(n, 3, replace=False)].T)[2][-1]
    b = A @ np.where(side > 1e-9, lower, np.where(side < -1e-9, upper, 0.0))
    qp = NullSpaceQP(A[:3], A[3:], b[:3], b[3:], rng.normal(size=n), lower, upper, regularization=1e-3)
    answer = Exact().start(qp).solve(qp)
    found = qp.residuals(answer.x, answer.y)
    assert found.natural < 1e-10
    assert found.verified(), found
