"""A short way into compiled kernels, for calls that are repeated at every tick."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import bool_, float64, int64

VECTOR, MATRIX, COLUMNS = float64[::1], float64[:, ::1], float64[::1, :]
"""Contiguous arrays of one and two dimensions; the last one column by column."""
INDICES, FLAGS = int64[::1], bool_[:, ::1]
"""The same of integers and of truth values."""


def entry(kernel: Any, *kinds: Any) -> Callable[..., Any]:
    """A kernel's machine code for arguments of these kinds, without numba's look at their types at every call.

    That look costs some 30 ns an argument, and three times as much where an array is read-only. What is returned
    still refuses objects of the wrong size or dimension, but takes contiguous memory and the dtype for granted:
    hand it only arrays that this package has made or checked itself.

    Args:
        kernel: an ``njit`` function.
        kinds: numba types of its arguments, in order.
    """
    kernel.compile(kinds)
    code: Callable[..., Any] = kernel.get_overload(kinds)
    return code
