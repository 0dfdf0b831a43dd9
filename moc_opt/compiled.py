"""A short way into compiled kernels, for calls that are repeated at every tick."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

from numba import bool_, float64, int64

VECTOR, MATRIX = float64[::1], float64[:, ::1]
"""Contiguous arrays of one and two dimensions."""
INDICES, FLAGS = int64[::1], bool_[:, ::1]
"""The same of integers and of truth values."""


class Entry:
    """A kernel's machine code for arguments of fixed kinds, without numba's look at their types at every call.

    That look costs some 30 ns an argument, and three times as much where an array is read-only. The code still
    refuses what is no array and numbers of another size, but takes dimension, dtype and contiguous memory for granted:
    hand it only arrays that this package has made or checked itself.

    Args:
        kernel: an ``njit`` function.
        kinds: numba types of its arguments, in order.
    """

    def __init__(self, kernel: Any, *kinds: Any) -> None:
        self._kernel, self._kinds = kernel, kinds

    @cached_property
    def code(self) -> Callable[..., Any]:
        """The machine code; compiled, or read from the cache, when it is first asked for, not when imported."""
        self._kernel.compile(self._kinds)
        code: Callable[..., Any] = self._kernel.get_overload(self._kinds)
        return code
