"""A controller's tick as compiled code calls it: a C function, and the memory that it reads and writes."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.compiled import INDICES, MATRIX, VECTOR, named

BAD_INPUT = 3
"""Returned where an input, or the torque, is not usable. The tick in C has changed nothing then, and raises the reason
when it is called again; one in Python has kept its error, to raise it then. Smaller numbers are the statuses of
`solvers.exact`."""


class TickMemory(NamedTuple):
    """A tick's function and the memory that it reads and writes, for compiled code that calls it."""

    function: NDArray[np.int64]
    """(1,) address of ``int tick(...)``"""
    pointers: NDArray[np.int64]
    """(7,) addresses of its arguments"""
    q: Array
    """(n,) measured [rad], and v [rad/s]"""
    v: Array
    tip_ref: Array
    """(3, 3) rows X_d, dX_d, ddX_d; trocar (2, 3) rows P_t, dP_t"""
    trocar: Array
    tau: Array
    """(n,) written [Nm]"""
    report: Array
    """(m,) written: what becomes columns of a trace"""
    torque: Array
    """(n,) the one that the observer takes for applied [Nm]"""
    open: NDArray[np.int64]
    """(1,) of a controller in Python: 1 before its tick, 0 at its end; (0,) of one in C, which nothing interrupts"""
    known: Array
    """numbers from which ``places`` takes a state's record"""
    places: NDArray[np.int64]


TICK = named(TickMemory, INDICES, INDICES, VECTOR, VECTOR, MATRIX, MATRIX, *[VECTOR] * 3, INDICES, VECTOR, INDICES)


@runtime_checkable
class CalledTick(Protocol):
    """A controller whose tick compiled periods call."""

    memory: TickMemory
    reports: Array
    """(N, m) rows of ``memory.report``; (0, 0) where there are none"""
    most: int
    """periods of one compiled call at most"""

    def calling(self) -> AbstractContextManager[None]:
        """Return what surrounds the compiled call that calls the tick."""

    def begin(self, columns: Mapping[str, NDArray[Any]], first: int) -> None:
        """Prepare for ticks whose columns are those of rows from ``first`` on."""

    def took(self, returned: NDArray[np.int64], columns: Mapping[str, NDArray[Any]], first: int) -> None:
        """Note what the ticks returned (k,), whose rows begin at ``first``."""
