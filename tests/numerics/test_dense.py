"""The small dense algebra of one tick against numpy, compiled and as plain Python."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.numerics import dense

SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.integers(1, 9)
BOTH = pytest.mark.parametrize("form", ["compiled", "plain"])


def kernel(name, form):
    """The compiled kernel, or the Python function it was made from."""
    found = getattr(dense, name)
    return found if form == "compiled" else found.py_func


def positive_definite(rng, m):
    """A random S (m, m) of condition number up to 1e6."""
    Q = np.linalg.qr(rng.normal(size=(m, m)))[0]
    return (Q * 10.0 ** rng.uniform(-3.0, 3.0, m)) @ Q.T


@BOTH
@settings(max_examples=60)
@given(seed=SEEDS, m=SIZES)
def test_cholesky(form, seed, m):
    S = positive_definite(np.random.default_rng(seed), m)
    S = 0.5 * (S + S.T)
    L = kernel("cholesky", form)(S)
    np.testing.assert_array_equal(L, np.tril(L))
    np.testing.assert_allclose(L @ L.T, S, rtol=0.0, atol=1e-13 * np.abs(S).max())
    np.testing.assert_allclose(L, np.linalg.cholesky(S), rtol=1e-6, atol=1e-9 * np.sqrt(np.abs(S).max()))


@BOTH
@pytest.mark.parametrize("S", [np.diag([1.0, -1.0]), np.zeros((2, 2)), np.array([[1.0, 2.0], [2.0, 1.0]])])
def test_a_matrix_that_is_not_positive_definite_is_told_by_nan(form, S):
    assert np.isnan(kernel("cholesky", form)(S)).any()


@BOTH
@settings(max_examples=60)
@given(seed=SEEDS, m=SIZES)
def test_solve_factored(form, seed, m):
    rng = np.random.default_rng(seed)
    S, b = positive_definite(rng, m), rng.normal(size=m)
    S = 0.5 * (S + S.T)
    kept = b.copy()
    x = kernel("solve_factored", form)(np.linalg.cholesky(S), b)
    wanted = np.linalg.solve(S, b)
    assert np.abs(x - wanted).max() <= 1e-14 * m * np.linalg.cond(S) * np.abs(wanted).max() + 1e-14
    np.testing.assert_array_equal(b, kept)


@BOTH
@settings(max_examples=60)
@given(seed=SEEDS, m=SIZES, n=SIZES)
def test_products(form, seed, m, n):
    rng = np.random.default_rng(seed)
    A, x, y = rng.normal(size=(m, n)), rng.normal(size=n), rng.normal(size=m)
    np.testing.assert_allclose(kernel("times", form)(A, x), A @ x, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(kernel("transpose_times", form)(A, y), A.T @ y, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(kernel("gram", form)(A), A @ A.T, rtol=0.0, atol=1e-13)
    assert kernel("dot", form)(x, A[0]) == pytest.approx(float(x @ A[0]), abs=1e-13)


@BOTH
def test_dot_takes_memory_that_is_not_contiguous(form):
    A = np.arange(12.0).reshape(3, 4)
    assert kernel("dot", form)(A[:, 1], A[:, 2]) == 1 * 2 + 5 * 6 + 9 * 10


@BOTH
def test_gram_is_symmetric_to_the_bit(form):
    S = kernel("gram", form)(np.random.default_rng(3).normal(size=(6, 7)))
    np.testing.assert_array_equal(S, S.T)
