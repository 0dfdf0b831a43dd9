"""A controller in Python as a C function, so that compiled periods call it as they call the tick in C."""

from __future__ import annotations

import ctypes
import sys
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from time import perf_counter_ns
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.control.called_tick import BAD_INPUT, TickMemory
from moc_opt.model.kinematics_kernels import record_size
from moc_opt.numerics.arrays import Array
from moc_opt.scenario.adapter import ControllerAdapter

_CALLBACK = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_void_p] * 7)
_MOST = 500
"""Periods of one compiled call at most: as many times of `note` are kept."""


class PythonTick(ControllerAdapter):
    """`ControllerAdapter` whose tick can be called from compiled code, too; see `control.called_tick.CalledTick`.

    An error of the tick ends the compiled call. The single step, which goes on there, asks for the tick again, and is
    given the error.
    """

    def __init__(self, adapter: ControllerAdapter) -> None:
        super().__init__(adapter.controller)
        n = adapter.controller.robot.n
        me = weakref.ref(self)  # not the method: the object, with a run's columns, would hold itself

        def called(*_: object) -> int:
            this = me()
            return BAD_INPUT if this is None else this._called()

        self._function, self._call = called, _CALLBACK(called)  # kept: compiled code has its address alone
        size = record_size(n)
        self.memory = TickMemory(
            function=np.array([ctypes.cast(self._call, ctypes.c_void_p).value]), pointers=np.zeros(7, dtype=np.int64),
            q=np.zeros(n), v=np.zeros(n), tip_ref=np.zeros((3, 3)), trocar=np.zeros((2, 3)), tau=np.zeros(n),
            report=np.zeros(0), torque=np.full(n, np.nan), open=np.zeros(1, dtype=np.int64), known=np.zeros(size),
            places=np.arange(size),
        )  # fmt: skip
        self.reports, self.most = np.empty((0, 0)), _MOST
        self._columns: Mapping[str, NDArray[Any]] = {}
        self._first = self._row = 0
        self._note_us = np.zeros(_MOST)
        self._error: BaseException | None = None

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Compute the torque (n,) [Nm]; raise what ended the compiled call before."""
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        return super().tick(q, v, tip_ref, trocar)

    @contextmanager
    def calling(self) -> Iterator[None]:
        """Keep the error of a call that has not come to ``_called``, as Ctrl-C: ctypes hands it to a hook alone."""
        before = sys.unraisablehook

        def keep(found: Any) -> None:
            if found.object is not self._function:
                before(found)
            elif self._error is None:
                self._error = found.exc_value

        sys.unraisablehook = keep
        try:
            yield
        finally:
            sys.unraisablehook = before

    def begin(self, columns: Mapping[str, NDArray[Any]], first: int) -> None:
        """Prepare for ticks whose columns are those of rows from ``first`` on."""
        self._columns, self._first, self._row = columns, first, first

    def took(self, returned: NDArray[np.int64], columns: Mapping[str, NDArray[Any]], first: int) -> None:
        """Subtract the time of `note` from the ticks' times: the single step reads its clock before `note`."""
        self._take_torque()
        self._columns = {}
        columns["tick_us"][first : first + returned.size] -= self._note_us[: returned.size]

    def _called(self) -> int:
        """Do one tick on ``memory``; called from compiled code."""
        at = self.memory
        try:
            self._take_torque()
            at.tau[:] = super().tick(at.q, at.v, at.tip_ref, at.trocar)
            begin = perf_counter_ns()
            state = self.state
            assert state is not None
            at.known[:] = state.record
            self.note(self._row, self._columns)
            self._note_us[self._row - self._first] = 1e-3 * (perf_counter_ns() - begin)
            self._row += 1
        except BaseException as error:  # noqa: BLE001 - none goes through compiled code; the single step raises it
            self._error = error
            return BAD_INPUT
        at.open[0] = 0
        return 0

    def _take_torque(self) -> None:
        """Tell the controller the last torque where the safety filter changed it, as compiled code wrote it down."""
        torque = self.memory.torque
        if torque[0] == torque[0]:
            self.set_applied_torque(torque)
            torque[:] = np.nan
