"""The short way into compiled kernels: the same numbers, compiled late, and objects of another kind refused."""

import ctypes
import sys
from typing import NamedTuple

import numpy as np
import pytest
from numba import float64, njit
from numba.core.errors import TypingError

from moc_opt.numerics.compiled import (
    INTEGER,
    MATRIX,
    REAL,
    VECTOR,
    CompiledKernel,
    ask,
    borrowed,
    call,
    named,
)


def scaled_sums():
    @njit
    def kernel(A, factor, out):
        for i in range(A.shape[0]):
            out[i] = factor * A[i].sum()

    return kernel


def test_the_code_is_the_kernel_and_is_compiled_when_asked_for():
    kernel = scaled_sums()
    entry = CompiledKernel(kernel, MATRIX, float64, VECTOR)
    assert not kernel.overloads
    A, ours, theirs = np.arange(12.0).reshape(3, 4), np.empty(3), np.empty(3)
    entry.code(A, 2.0, ours)
    assert len(kernel.overloads) == 1
    assert entry.code is entry.code
    kernel(A, 2.0, theirs)
    np.testing.assert_array_equal(ours, theirs)


def test_read_only_memory_is_read():
    A, out = np.ones((2, 3)), np.empty(2)
    A.flags.writeable = False
    CompiledKernel(scaled_sums(), MATRIX, float64, VECTOR).code(A, 1.0, out)
    np.testing.assert_array_equal(out, 3.0)


@pytest.mark.parametrize("wrong", [np.ones((2, 3), dtype=np.float32), [[1.0, 2.0]], None])
def test_another_kind_is_refused(wrong):
    with pytest.raises(TypeError):
        CompiledKernel(scaled_sums(), MATRIX, float64, VECTOR).code(wrong, 1.0, np.empty(2))


def test_what_is_borrowed_is_the_array_and_is_not_counted():
    @njit
    def doubled(A, out):
        lent = borrowed(A)
        for i in range(A.shape[0]):
            row = lent[i]
            out[i] = 2.0 * row.sum()

    A, out = np.arange(12.0).reshape(3, 4), np.empty(3)
    before = sys.getrefcount(A)
    for _ in range(100):
        doubled(A, out)
    np.testing.assert_array_equal(out, 2.0 * A.sum(axis=1))
    assert sys.getrefcount(A) == before
    assert borrowed(A) is A


def test_writing_to_what_is_borrowed_writes_to_its_owner():
    @njit
    def fill(out):
        lent = borrowed(out)
        lent[1:] = 5.0

    out = np.zeros(4)
    fill(out)
    np.testing.assert_array_equal(out, [0.0, 5.0, 5.0, 5.0])


def test_only_arrays_are_lent():
    @njit
    def wrong(number):
        return borrowed(number)

    with pytest.raises(TypingError):
        wrong(1.0)


def test_c_is_called_alike_from_a_kernel_and_from_python():
    seen = []
    callback = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(lambda *given: seen.append(given))
    address = ctypes.cast(callback, ctypes.c_void_p).value

    @njit
    def kernel(function, first, second):
        call(function, first, second)
        call(function, second, first)

    for run in (kernel, kernel.py_func):
        run(address, 3, 1 << 40)
    assert seen == 2 * [(3, 1 << 40), (1 << 40, 3)]


class Memory(NamedTuple):
    scale: float
    rows: int
    A: np.ndarray
    out: np.ndarray


def test_a_named_tuple_is_one_argument_and_lends_all_its_arrays():
    @njit
    def kernel(memory):
        lent = borrowed(memory)
        for i in range(lent.rows):
            lent.out[i] = lent.scale * lent.A[i].sum()

    memory = Memory(2.0, 2, np.arange(12.0).reshape(3, 4), np.zeros(3))
    counts = [sys.getrefcount(part) for part in memory[2:]]
    code = CompiledKernel(kernel, named(Memory, REAL, INTEGER, MATRIX, VECTOR)).code
    for _ in range(100):
        code(memory)
    np.testing.assert_array_equal(memory.out, [12.0, 44.0, 0.0])
    assert [sys.getrefcount(part) for part in memory[2:]] == counts
    assert borrowed(memory) is memory


def test_a_c_function_is_asked_by_its_address():
    """In Python and in a kernel; what it answers keeps its sign."""
    kind = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)

    def differ(*addresses):
        first, second, third = (ctypes.cast(at, ctypes.POINTER(ctypes.c_double))[0] for at in addresses)
        return int(first - second * third)

    function = kind(differ)
    numbers = np.array([3.0, 4.0, 5.0])
    given = tuple(numbers.ctypes.data + 8 * i for i in range(3))
    address = ctypes.cast(function, ctypes.c_void_p).value
    assert ask(address, given) == njit(lambda f, g: ask(f, g))(address, given) == -17
