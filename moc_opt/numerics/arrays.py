"""Arrays that nobody may write into."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Given = TypeVar("Given", bound=NDArray[Any])


def read_only(array: Given) -> Given:
    """Make an array read-only, and return it; other names of its memory stay writable."""
    array.setflags(write=False)
    return array


def read_only_copy(array: NDArray[np.float64]) -> NDArray[np.float64]:
    """Copy an array, read-only."""
    return read_only(array.copy())
