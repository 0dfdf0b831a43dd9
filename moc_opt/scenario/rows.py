"""The rows of a run before it begins: references by the block, and a check that its record fits."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from moc_opt.errors import ScenarioError, TraceError
from moc_opt.inputs.memory import available_bytes
from moc_opt.numerics.arrays import Array
from moc_opt.scenario.config import Scenario

MEMORY_A_TICK, DISK_A_TICK = 4500, 1600
"""Bytes that a tick of a run takes at most: in memory while it is judged, and on the disk."""


class Timed:
    """A reference of every tick that is computed for the ticks that are asked for.

    Args:
        at: times (k,) [s] -> rows (k, rows, 3).
        period: of a tick [s].
        ticks: how many there are.
    """

    def __init__(self, at: Callable[[Array], Array], period: float, ticks: int) -> None:
        self._at, self._period, self._ticks = at, period, ticks

    def __len__(self) -> int:
        return self._ticks

    def __getitem__(self, ticks: slice) -> Array:
        first, last, _ = ticks.indices(self._ticks)
        return self._at(self._period * np.arange(first, last, dtype=np.float64))


def check_room(scenario: Scenario, ticks: int, to: str | os.PathLike[str] | None) -> None:
    """Check that a run fits into the memory, or onto the disk where it goes into a file.

    Raises:
        ScenarioError: it does not; says what it takes and the cure.
    """
    if to is None:
        need, free, where = ticks * MEMORY_A_TICK, available_bytes(), "of memory"
        cure = "let its trace go into a file while it grows (run --trace FILE, or run(..., to=FILE))"
    else:
        folder = Path(to).absolute().parent
        if not folder.is_dir():
            raise TraceError(f"the trace cannot be saved as {str(to)!r}: there is no folder {str(folder)!r}")
        need, free, where = ticks * DISK_A_TICK, shutil.disk_usage(folder).free, f"on the disk of {str(folder)!r}"
        cure = "make room there"
    if need > free:
        raise ScenarioError(
            f"{scenario.name!r}: {ticks} ticks take {need / 2**30:.1f} GiB {where}, and {free / 2**30:.1f} are free: "
            f"give a shorter duration_s, or {cure}"
        )
