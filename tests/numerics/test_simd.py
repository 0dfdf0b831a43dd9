"""Eight numbers at a time: every function against numpy, and nothing read or written beyond what was asked for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numba import njit
from numba.core.errors import TypingError

from moc_opt.numerics import simd

NUMBERS = st.floats(-1e6, 1e6) | st.sampled_from([0.0, np.inf, -np.inf, np.nan])
EIGHT = arrays(float, 8, elements=NUMBERS)
FINITE = arrays(float, 8, elements=st.floats(-1e6, 1e6))


@njit(cache=True, error_model="numpy")
def arithmetic(M, number, out):
    a, b = simd.load(M, 0, 0), simd.load(M, 1, 0)
    simd.store(out, 0, 0, a + b)
    simd.store(out, 1, 0, a - number)
    simd.store(out, 2, 0, 3 * a)
    simd.store(out, 3, 0, a / b)
    simd.store(out, 4, 0, number / b)
    simd.store(out, 5, 0, simd.magnitude(a))
    simd.store(out, 6, 0, simd.above(a, b, number, simd.magnitude(b)))
    simd.store(out, 7, 0, simd.above(b, 1.0, a, -1.0))


@settings(max_examples=100)
@given(a=EIGHT, b=EIGHT, number=NUMBERS)
def test_entry_by_entry(a, b, number):
    out = np.empty((8, 8))
    arithmetic(np.array([a, b]), number, out)
    with np.errstate(all="ignore"):
        expected = [
            a + b, a - number, 3.0 * a, a / b, number / b, np.abs(a),
            np.where(a > b, number, np.abs(b)), np.where(b > 1.0, a, -1.0),
        ]  # fmt: skip
    np.testing.assert_array_equal(out, expected)


@njit(cache=True)
def compared(M, out):
    a, b = simd.load(M, 0, 0), simd.load(M, 1, 0)
    simd.store(out, 0, 0, simd.larger(a, b))
    simd.store(out, 1, 0, simd.lesser(a, b))
    return simd.largest(a), simd.least(a), simd.total(a), simd.first(a, simd.largest(a))


@settings(max_examples=100)
@given(a=FINITE, b=FINITE)
def test_comparisons_and_sums(a, b):
    out = np.empty((2, 8))
    largest, least, total, first = compared(np.array([a, b]), out)
    np.testing.assert_array_equal(out, [np.maximum(a, b), np.minimum(a, b)])
    assert (largest, least, first) == (a.max(), a.min(), a.argmax())
    assert total == pytest.approx(a.sum(), abs=1e-9 * max(1.0, np.abs(a).max()))


def test_of_what_is_no_number_the_second_is_taken():
    out, nan = np.empty((2, 8)), np.full(8, np.nan)
    compared(np.array([nan, np.ones(8)]), out)
    np.testing.assert_array_equal(out, 1.0)


@njit(cache=True)
def found(M, value):
    return simd.first(simd.load(M, 0, 0), value)


def test_the_first_of_several_and_eight_for_none():
    M = np.array([[3.0, 1.0, 2.0, 1.0, np.nan, 0.0, -0.0, 1.0]])
    assert [found(M, value) for value in (1.0, 0.0, 3.0, 7.0, np.nan)] == [1, 5, 0, 8, 8]


@njit(cache=True)
def copied(vector, to, at, count, out):
    simd.keep(to, at, count, simd.part(vector, at, count))
    simd.store(out, 0, 0, simd.part(vector, at, count))


@pytest.mark.parametrize("count", [-3, 0, 1, 5, 8, 11])
def test_parts_end_where_they_are_told_to(count):
    vector, to, out = np.arange(1.0, 21.0), np.full(20, -1.0), np.empty((1, 8))
    copied(vector, to, 3, count, out)
    size = min(max(count, 0), 8)
    np.testing.assert_array_equal(out[0], np.append(vector[3 : 3 + size], np.zeros(8 - size)))
    expected = np.full(20, -1.0)
    expected[3 : 3 + size] = vector[3 : 3 + size]
    np.testing.assert_array_equal(to, expected)


@njit(cache=True)
def units(out):
    for k in range(-1, 9):
        simd.store(out, k + 1, 0, simd.unit(k))
    simd.store(out, 10, 0, simd.zeros())


def test_units_and_zeros():
    out = np.empty((11, 8))
    units(out)
    np.testing.assert_array_equal(out[1:9], np.eye(8))
    np.testing.assert_array_equal(out[[0, 9, 10]], 0.0)


@njit(cache=True)
def shifted(M, i, c):
    out = np.empty((1, 8))
    simd.store(out, 0, 0, simd.load(M, i, c))
    return out[0]


def test_pieces_lie_where_a_matrix_has_them():
    M = np.arange(72.0).reshape(3, 24)
    for i, c in ((0, 0), (1, 8), (2, 16), (1, 3)):
        np.testing.assert_array_equal(shifted(M, i, c), M[i, c : c + 8])


@njit(cache=True)
def in_frame(rows, columns):
    M, N, indices = simd.stack(rows, columns), simd.stack(rows, columns), simd.stack_indices(columns)
    for i in range(rows):
        for j in range(columns):
            M[i, j], N[i, j] = i + j, 1.0
    for j in range(columns):
        indices[j] = j
    return M.sum(), N.sum(), indices.sum(), M.ctypes.data % 64


@njit(cache=True)
def many_frames(times):
    total = 0.0
    for _ in range(times):
        total += in_frame(20, 16)[1]
    return total


def test_memory_of_the_frame_is_apart_aligned_and_given_back():
    assert in_frame(3, 8) == (108.0, 24.0, 28, 0)
    assert many_frames(100_000) == 100_000 * 320.0  # half a gigabyte, were it kept until the end


@pytest.mark.parametrize(("n", "wide"), [(1, 8), (7, 8), (8, 8), (9, 16), (17, 24)])
def test_width(n, wide):
    assert simd.width(n) == wide


def test_from_python_they_are_refused():
    with pytest.raises(NotImplementedError):
        simd.unit(0)


def test_lanes_and_what_is_no_number_are_refused():
    @njit
    def wrong(M):
        return simd.total(simd.load(M, 0, 0) + "1")

    with pytest.raises(TypingError):
        wrong(np.zeros((1, 8)))
