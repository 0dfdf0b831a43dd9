"""Arrays that nobody may write into."""

from __future__ import annotations

from typing import Any, TypeVar

from numpy.typing import NDArray

Kept = TypeVar("Kept", bound=NDArray[Any])


def read_only(array: Kept) -> Kept:
    """Make an array read-only, in place; returns it."""
    array.setflags(write=False)
    return array
