"""Readings that came before: a recording played once more, or an encoder that lags. Compiled.

A sensor with noise never shows the same numbers twice. A reading that equals an earlier one to the last bit, in joints,
velocities and wrench, is that earlier one; several with the same lag are a recording. A recording agrees with
its own velocities and with the model, so no other sign of ``motion_kernels`` finds it. The same holds for one encoder
whose filtered velocity comes with its position: if it begins to lag by k readings, it shows k of them once more.
"""

from __future__ import annotations

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit

SLOTS, JOINT_SLOTS = 4096, 256
"""Slots for stored readings, whole and of one encoder; a later reading with the same slot replaces the stored one."""
READINGS, LAG, HITS = range(3)
"""Places of a count (3,): readings so far; the lag of the last one that came before; how many came with that lag."""
_SHRINK, _FINE, _LARGEST = 0.61803398875, 1e9, 1e6


@njit(cache=True, nogil=True)
def _take_in(number: float, numbers: Array, places: Array, count: Array) -> float:
    """Remember a reading by its number; return how many came before, all of them by the same number of readings."""
    if not abs(number) < _LARGEST:
        return count[HITS]
    count[READINGS] += 1.0
    slot = int(abs(number) * _FINE) % numbers.shape[0]
    lag = count[READINGS] - places[slot]
    if places[slot] > 0.0 and numbers[slot] == number and lag > 1.0:  # lag 1: a frozen reading, a sign of its own
        count[HITS] = count[HITS] + 1.0 if lag == count[LAG] else 1.0
        count[LAG] = lag
    numbers[slot], places[slot] = number, count[READINGS]
    return count[HITS]


@njit(cache=True, nogil=True)
def count_replayed(q: Array, v: Array, wrench: Array, seen: Array, count: Array) -> float:
    """Take in a new reading; return how many came before, all of them by the same number of readings.

    Each reading is reduced to one number, a weighted sum, which equal readings share to the last bit.

    Args:
        q, v: (n,) [rad], [rad/s].
        wrench: (6,) [N], [Nm].
        seen: (2, SLOTS) changed in place: that number and the count of the reading with it; zeros at the start.
        count: (3,) changed in place; zeros at the start.
    """
    number = 0.0
    for values in (q, v, wrench):
        for i in range(values.shape[0]):
            number = _SHRINK * number + values[i]
    return _take_in(number, seen[0], seen[1], count)


@njit(cache=True, nogil=True)
def count_lagging(q: Array, v: Array, seen: Array, counts: Array) -> float:
    """Take in a new reading; return how many of one encoder came before, of the one with the most.

    Args:
        q, v: (n,) [rad], [rad/s].
        seen: (2 n, JOINT_SLOTS) changed in place: for each encoder two rows as for `count_replayed`.
        counts: (n, 3) changed in place; zeros at the start.
    """
    most = 0.0
    for i in range(q.shape[0]):
        most = max(most, _take_in(_SHRINK * q[i] + v[i], seen[2 * i], seen[2 * i + 1], counts[i]))
    return most
