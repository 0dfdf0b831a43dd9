"""The numbers a task is built from, checked where they come in, and the two shapes of time a task accepts."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import TaskError
from moc_opt.numerics.arrays import read_only

Vector = NDArray[np.float64]
TimeLike = float | ArrayLike


def number(name: str, value: object) -> float:
    """Return a finite float.

    Raises:
        TaskError: it is no number, or not finite.
    """
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise TaskError(f"{name} = {value!r} is not a number: give one finite number")
    try:
        result = float(value)
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise TaskError(f"{name} = {value!r} is not finite: give one finite number")
    return result


def positive(name: str, value: object) -> float:
    """Return a finite float above zero.

    Raises:
        TaskError: it is no number, not finite, or not above zero.
    """
    result = number(name, value)
    if result <= 0.0:
        raise TaskError(f"{name} = {value!r} must be positive: give a finite number above zero")
    return result


def vector3(name: str, value: ArrayLike) -> Vector:
    """Return a read-only (3,) copy with finite entries.

    Raises:
        TaskError: it has another shape or an entry that is not finite.
    """
    try:
        result = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TaskError(f"{name} = {value!r} is not a vector: give three numbers") from error
    if result.shape != (3,) or not np.isfinite(result).all():
        raise TaskError(f"{name} = {value!r} must hold three finite numbers")
    return read_only(result)


def direction3(name: str, value: ArrayLike) -> Vector:
    """Return a read-only unit vector (3,).

    Raises:
        TaskError: it is no vector of three finite numbers, or its length is zero.
    """
    given = vector3(name, value)
    largest = float(np.abs(given).max())
    if largest == 0.0:
        raise TaskError(f"{name} = {value!r} has no direction: give a vector of non-zero length")
    # Divided by its largest entry first, so that very long and very short vectors keep their direction.
    scaled = given / largest
    return read_only(np.asarray(scaled / math.sqrt(float(scaled @ scaled)), dtype=np.float64))


def sampled(
    name: str, value: TimeLike, rows: Callable[[float], Vector], columns: Callable[[Vector], Vector] | None = None
) -> Vector:
    """Evaluate `rows` at one number or at each of a vector of them.

    Both forms go through the same arithmetic: the value of a controller at a tick and that of a report
    afterwards for the whole run are then the same to the last bit. numpy's vector sine does not promise that.

    Args:
        value: a number, or a vector (k,).
        rows: number -> (m, 3).
        columns: vector (k,), k > 0 -> (m, k, 3), the same to the last bit; None: ``rows`` at each of them.

    Returns:
        (m, 3) for a number, (m, k, 3) for a vector.

    Raises:
        TaskError: `value` is neither a number nor a vector.
    """
    if isinstance(value, (float, int)):
        return rows(value)
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TaskError(f"{name} = {value!r} is not usable: give a number or a vector of numbers") from error
    if array.ndim == 0:
        return rows(float(array))
    if array.ndim != 1:
        raise TaskError(f"{name} has shape {array.shape}: give a number or a vector (k,)")
    if array.size == 0:
        return np.empty((rows(0.0).shape[0], 0, 3))
    if columns is not None:
        return np.ascontiguousarray(columns(array))
    first = rows(float(array[0]))
    found = np.empty((array.size, *first.shape))
    for i, entry in enumerate(array.tolist()):
        found[i] = rows(entry)
    return np.ascontiguousarray(np.swapaxes(found, 0, 1))
