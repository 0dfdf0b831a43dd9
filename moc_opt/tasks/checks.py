"""Checks of the numbers that define a task."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.arrays import Array, read_only
from moc_opt.errors import TaskError, is_number

TimeLike = float | ArrayLike


def number(name: str, value: object, above: float = -math.inf) -> float:
    """Return a finite float greater than ``above``, or raise a TaskError."""
    if not (is_number(value) and max(above, -1e300) < value < 1e300):  # type: ignore[operator]
        raise TaskError(f"{name} = {value!r}: give one finite number" + (" above zero" if above == 0.0 else ""))
    return float(value)  # type: ignore[arg-type]


def positive(name: str, value: object) -> float:
    """Return a finite float greater than zero, or raise a TaskError."""
    return number(name, value, above=0.0)


def vector3(name: str, value: ArrayLike, *, rows: bool = False) -> Array:
    """Return a read-only array (3,), or (k, 3) with ``rows``. Raise a TaskError if it is not finite."""
    wanted = "give finite numbers (k, 3)" if rows else "give three finite numbers"
    try:
        result = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TaskError(f"{name} = {value!r:.200}: {wanted}") from error
    if result.ndim != 1 + rows or result.shape[-1] != 3:
        raise TaskError(f"{name} has shape {result.shape}: {wanted}")
    if not np.isfinite(result).all():
        raise TaskError(f"{name} = {value!r:.200}: {wanted}")
    return read_only(result)


def direction3(name: str, value: ArrayLike) -> Array:
    """Return the unit vector (3,) along a vector. Raise a TaskError if it is zero."""
    given = vector3(name, value)
    largest = float(np.abs(given).max())
    if largest == 0.0:
        raise TaskError(f"{name} = {value!r} has no direction: give a vector of non-zero length")
    scaled = given / largest  # so that squares do not overflow or vanish
    return read_only(np.asarray(scaled / math.sqrt(float(scaled @ scaled))))


def sampled(name: str, value: TimeLike, rows: Callable[[Array], Array]) -> Array:
    """Evaluate ``rows``, which maps (k,) to (k, m, 3), at a number or a vector (k,).

    Return (m, 3) or (m, k, 3). Raise a TaskError if ``value`` is neither a number nor a vector.
    """
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TaskError(f"{name} = {value!r} is not usable: give a number or a vector of numbers") from error
    if array.ndim > 1:
        raise TaskError(f"{name} has shape {array.shape}: give a number or a vector (k,)")
    found = np.swapaxes(rows(array.reshape(-1)), 0, 1)
    return np.ascontiguousarray(found if array.ndim else found[:, 0])
