"""A short way into compiled kernels, for calls that are repeated at every tick."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import float64, int64

VECTOR, MATRIX = float64[::1], float64[:, ::1]
"""Argument kinds beside ``float64``, ``int64`` and ``bool_``: contiguous float64 arrays of one and two dimensions."""
INDICES = int64[::1]


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
