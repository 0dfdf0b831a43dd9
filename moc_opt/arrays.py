"""The one type of all numbers, and arrays that nobody may write into."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Given = TypeVar("Given", bound=NDArray[Any])


def read_only(array: Given) -> Given:
    """Make an array read-only, and return it; other names of its memory stay writable."""
    array.setflags(write=False)
    return array
