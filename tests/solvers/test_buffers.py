"""A subproblem's numbers arrive in a library's buffers as the plain numpy of the subproblem has them."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.qp.equalities import assembled
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.library import Loader
from tests.problems import random_problem


def buffers(m, n):
    """Views into stacked, padded and transposed arrays, as the libraries have them."""
    sides, columns = np.full((2, m + n + 1), np.nan), np.full((n, m + 2), np.nan)
    return {
        "P": np.full((n, n), np.nan).T, "packed": np.full(n * (n + 1) // 2, np.nan), "p": np.full(n, np.nan),
        "A": columns[:, :m].T, "low": sides[0, :m], "high": sides[1, :m], "lower": sides[0, m : m + n],
        "upper": sides[1, m : m + n],
    }, sides, columns  # fmt: skip


def untied(seed, n=7):
    """A subproblem whose six rows are independent."""
    J = np.random.default_rng(seed).normal(size=(2, 3, n))
    return NullSpaceQP(J[0], J[1], np.ones(3), np.zeros(3), np.ones(n), -np.ones(n), np.ones(n))


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10_000), n=st.sampled_from([6, 7, 9]), rows=st.sampled_from([5, 6]), tied=st.booleans(),
    scale=st.sampled_from([1.0, 1e3]), signs=st.tuples(*[st.sampled_from([1.0, -1.0])] * 3),
)  # fmt: skip
def test_every_number_is_where_it_belongs(seed, n, rows, tied, scale, signs):
    qp = random_problem(np.random.default_rng(seed), n) if tied else untied(seed, n)
    m = rows if tied else 6  # what is not tied stays six rows
    arrays, sides, columns = buffers(m, n)
    load = Loader(rows, scale, signs=signs, **arrays)
    assert load(qp)
    A, b = (qp.reduced().A, qp.reduced().b) if m == 5 else (qp.A, qp.b)
    np.testing.assert_allclose(arrays["P"], scale * qp.P, rtol=1e-12, atol=1e-12 * scale)
    np.testing.assert_allclose(arrays["p"], signs[0] * scale * qp.p, rtol=1e-12, atol=1e-12 * scale)
    np.testing.assert_allclose(arrays["A"], A, atol=1e-14)
    np.testing.assert_allclose(arrays["low"], b, atol=1e-14)
    np.testing.assert_array_equal(arrays["high"], arrays["low"])
    np.testing.assert_array_equal(arrays["lower"], signs[1] * qp.lower)
    np.testing.assert_array_equal(arrays["upper"], signs[2] * qp.upper)
    np.testing.assert_array_equal(arrays["packed"], [arrays["P"][i, j] for j in range(n) for i in range(j + 1)])
    assert np.isnan(sides[:, -1]).all()
    assert np.isnan(columns[:, m:]).all()
    y, lift = np.arange(1.0, m + 1.0), assembled(qp, rows).lift
    np.testing.assert_allclose(load.lifted(y, 0.5), 0.5 * y @ lift, atol=1e-14)
    np.testing.assert_allclose(qp.A.T @ load.lifted(y, 2.0), 2.0 * assembled(qp, rows).A.T @ y, atol=1e-12)


def test_another_shape_is_refused():
    rng = np.random.default_rng(1)
    for m, good, bad in ((5, random_problem(rng, 7), untied(3)), (6, untied(3), random_problem(rng, 7))):
        load = Loader(5, 1.0, **buffers(m, 7)[0])
        assert load(good)
        assert not load(bad)
        assert not load(random_problem(rng, 8))
