"""The last seconds of a live run, for its plots."""

from __future__ import annotations

import numpy as np

from moc_opt.numerics.arrays import Array

QUANTITIES = ("t_s", "mu", "mu_bound", "tip_error_m", "rcm_error_m", "force_N", "solve_us", "tick_us")


class History:
    """A ring of rows, one per tick."""

    def __init__(self, rows: int) -> None:
        self._ring = np.full((rows, len(QUANTITIES)), np.nan)
        self._count = 0

    def add(self, **values: float) -> None:
        """Add one tick: each of `QUANTITIES` by its name."""
        self._ring[self._count % len(self._ring)] = [values[name] for name in QUANTITIES]
        self._count += 1

    def clear(self) -> None:
        """Forget all."""
        self._count = 0

    def latest(self) -> Array:
        """Return the rows (k, 8), the oldest first; a copy."""
        if self._count <= len(self._ring):
            return self._ring[: self._count].copy()
        return np.roll(self._ring, -(self._count % len(self._ring)), axis=0)


def thinned(rows: Array, points: int) -> Array:
    """Return at most `points` rows, of every stretch the last time and the largest of each quantity: peaks stay."""
    if len(rows) <= points:
        return rows
    size = -(-len(rows) // points)
    whole = rows[len(rows) % size :].reshape(-1, size, rows.shape[1])  # the oldest few are left out
    known = np.where(np.isnan(whole), -np.inf, whole).max(axis=1)
    return np.where(np.isinf(known), np.nan, known)
