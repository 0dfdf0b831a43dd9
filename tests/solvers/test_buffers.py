"""A subproblem's numbers arrive in a library's buffers as the plain numpy of the subproblem has them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.qp.equalities import assembled
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.library import Loader
from tests.problems import random_problem


def buffers(m, n):
    """Views into stacked, padded and transposed arrays, as the libraries have them."""
    sides = np.full((2, m + n + 1), np.nan)
    columns = np.full((n, m + 2), np.nan)
    return {
        "P": np.full((n, n), np.nan).T, "packed": np.full(n * (n + 1) // 2, np.nan), "p": np.full(n, np.nan),
        "A": columns[:, :m].T, "low": sides[0, :m], "high": sides[1, :m], "lower": sides[0, m : m + n],
        "upper": sides[1, m : m + n],
    }, sides, columns  # fmt: skip


def untied(n=7):
    """A subproblem whose six rows are independent."""
    J = np.random.default_rng(3).normal(size=(2, 3, n))
    return NullSpaceQP(J[0], J[1], np.ones(3), np.zeros(3), np.ones(n), -np.ones(n), np.ones(n))


def check(qp, rows, found, scale, signs):
    five = qp.reduced()
    A, b = (five.A, five.b) if rows == 5 else (qp.A, qp.b)
    np.testing.assert_allclose(found["P"], scale * qp.P, rtol=1e-12, atol=1e-12 * scale)
    np.testing.assert_allclose(found["p"], signs[0] * scale * qp.p, rtol=1e-12, atol=1e-12 * scale)
    np.testing.assert_allclose(found["A"], A, atol=1e-14)
    np.testing.assert_allclose(found["low"], b, atol=1e-14)
    np.testing.assert_array_equal(found["high"], found["low"])
    np.testing.assert_array_equal(found["lower"], signs[1] * qp.lower)
    np.testing.assert_array_equal(found["upper"], signs[2] * qp.upper)
    triangle = [found["P"][i, j] for j in range(qp.n) for i in range(j + 1)]
    np.testing.assert_array_equal(found["packed"], triangle)


@settings(max_examples=30)
@given(
    seed=st.integers(0, 10_000),
    n=st.sampled_from([6, 7, 9]),
    rows=st.sampled_from([5, 6]),
    scale=st.sampled_from([1.0, 1e3]),
    signs=st.tuples(*[st.sampled_from([1.0, -1.0])] * 3),
)
def test_every_number_is_where_it_belongs(seed, n, rows, scale, signs):
    qp = random_problem(np.random.default_rng(seed), n)
    found, sides, columns = buffers(rows, n)
    load = Loader(rows, scale, signs=signs, **found)
    assert load(qp)
    check(qp, rows, found, scale, signs)
    assert np.isnan(sides[:, -1]).all()
    assert np.isnan(columns[:, rows:]).all()


def test_rows_that_are_not_tied_stay_six():
    qp = untied()
    found, _, _ = buffers(6, 7)
    assert Loader(5, 10.0, **found)(qp)
    check(qp, 5, found, 10.0, (1.0, 1.0, 1.0))


def test_another_shape_is_refused():
    rng = np.random.default_rng(1)
    five, _, _ = buffers(5, 7)
    load = Loader(5, 1.0, **five)
    assert load(random_problem(rng, 7))
    assert not load(random_problem(rng, 8))
    assert not load(untied())
    six, _, _ = buffers(6, 7)
    load = Loader(5, 1.0, **six)
    assert load(untied())
    assert not load(random_problem(rng, 7))
    assert not Loader(6, 1.0, **six)(random_problem(rng, 8))


@pytest.mark.parametrize("rows", [5, 6])
def test_multipliers_are_lifted(rows):
    qp = random_problem(np.random.default_rng(5))
    found, _, _ = buffers(rows, 7)
    load, y = Loader(rows, 1.0, **found), np.arange(1.0, rows + 1.0)
    assert load(qp)
    wanted = 0.5 * y @ assembled(qp, rows).lift
    np.testing.assert_allclose(load.lifted(y, 0.5), wanted, atol=1e-14)
    np.testing.assert_allclose(qp.A.T @ load.lifted(y, 2.0), 2.0 * assembled(qp, rows).A.T @ y, atol=1e-12)
