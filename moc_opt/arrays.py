"""The type of all arrays of doubles, and read-only arrays."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Given = TypeVar("Given", bound=NDArray[Any])


def read_only(array: Given) -> Given:
    """Make an array read-only, and return it; other arrays on the same memory stay writable."""
    array.setflags(write=False)
    return array
