"""The array type `Array`, and `read_only`, which protects an array."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Given = TypeVar("Given", bound=NDArray[Any])


def read_only(array: Given) -> Given:
    """Make an array read-only, and return it."""
    array.setflags(write=False)
    return array
