"""Whole control periods in one compiled call: safety filter, tick, limits, plant, and the trace's rows.

The tick is a C function: that of the generated C, or one that calls a controller in Python (`python_tick`).

The parts are those that a single step calls one after the other, in the same order. Where a part finds anything that
Python has to judge, the call ends there, and the single step goes on with what was found.
"""

from __future__ import annotations

import ctypes
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.control import safety_tick as safety
from moc_opt.control.called_tick import BAD_INPUT, TICK, CalledTick, TickMemory
from moc_opt.control.safety_filter import SafetyFilter
from moc_opt.numerics.arrays import Array, read_only
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import (
    BYTES,
    CUBE,
    INDICES,
    INTEGER,
    MATRIX,
    VECTOR,
    CompiledKernel,
    ask,
    borrowed,
    call,
    named,
)
from moc_opt.sim import period
from moc_opt.sim.closed_loop import Stepped
from moc_opt.sim.faults import Faults
from moc_opt.sim.filtered import NOTHING, Begun
from moc_opt.sim.log import Block
from moc_opt.sim.period import PlantMemory
from moc_opt.sim.plant import Plant
from moc_opt.sim.sensors import Measurement

Indices = NDArray[np.int64]

MEASURED, COMPUTED, MOVED, ALL = range(4)
"""Where a call ended: before the tick, after it, in the plant; or nowhere, all periods done."""
ROW, WHERE, FOUND, STAMP, SLOT, LIMITED = range(6)
"""Places in the memory of a call: row and half where it ended, and what was found there; number of the measurement,
place in the drives' queue, joints limited last."""


class Rows(NamedTuple):
    """References of a block's rows (N, ...), and what is written down of them."""

    tip_refs: Array
    trocars: Array
    registered: Array
    truth: Array
    wrench: Array
    tau: Array
    tick_us: Array
    limited: NDArray[np.int8]
    reports: Array
    """(N, m) of the tick; (0, 0) where there is no third level"""
    codes: Indices
    """(N,) what the tick returned"""


class Now(NamedTuple):
    """What goes on from period to period, beside the memories of the parts."""

    at: Indices
    """(6,) see ROW; begins with the first row"""
    reading: Array
    """(2 n + 6,) what the sensors show"""
    seen: Array
    """(2 n + 6,) what they showed at the start of the last period"""
    applied: Array
    """(n,) torque of the last period [Nm]"""
    sent: Array
    """(n,) torque of this one"""
    record: Array
    """state of the model as the tick saw it"""
    clock: Indices
    """(2,) seconds and nanoseconds"""


@njit(cache=True, nogil=True)
def _microseconds(call_clock: int, clock: Indices) -> float:
    call(call_clock, time.CLOCK_MONOTONIC, clock.ctypes.data)
    return float(1e6 * clock[0] + 1e-3 * clock[1])


@njit(cache=True, nogil=True)
def steps(
    plant: PlantMemory, guard: safety.SafetyMemory, tick: TickMemory, rows: Rows, now: Now, last: int, parts: Indices,
    tissue: Array, pushed: Indices, pushes: Array, noise: Array, wrench_noise: Array, nothing: Array, call_clock: int,
) -> None:  # fmt: skip
    """Advance by periods until row ``last``, or until something is found that Python has to judge.

    Args:
        plant, guard, tick: memories of the parts.
        rows, now: written.
        last: the row before which it ends.
        parts: (3,) what the filter checks before and after the tick; turns of the drives' queue.
        tissue, pushed, pushes: as for `sim.period.advance`.
        noise, wrench_noise: (k, n), (k, 6) of the next readings, as many as there are periods.
        nothing: (0,).
        call_clock: address of C's ``clock_gettime``.
    """
    plant, guard, tick, rows, now = borrowed(plant), borrowed(guard), borrowed(tick), borrowed(rows), borrowed(now)
    noise, wrench_noise = borrowed(noise), borrowed(wrench_noise)
    at, first, n = now.at, now.at[ROW], now.applied.size
    q, v, wrench = now.seen[:n], now.seen[n : 2 * n], now.seen[2 * n :]
    while at[ROW] < last:
        row = at[ROW]
        tip_ref, registered = rows.tip_refs[row], rows.registered[row]
        rows.truth[row], now.seen[:] = plant.truth, now.reading
        begin = _microseconds(call_clock, now.clock)
        at[WHERE] = MEASURED
        at[FOUND] = safety.before(guard, parts[0], q, v, at[STAMP], now.applied, wrench, registered)
        if at[FOUND] != safety.ACCEPTED:
            return
        tick.q[:], tick.v[:], tick.tip_ref[:], tick.trocar[:] = q, v, tip_ref, registered
        p = tick.pointers
        tick.open[:] = 1
        rows.codes[row] = ask(tick.function[0], (p[0], p[1], p[2], p[3], p[4], p[5], p[6]))
        if tick.open.sum() > 0:  # an error before the tick's first line, as of Ctrl-C: what was returned says nothing
            rows.codes[row] = BAD_INPUT
        if rows.codes[row] == BAD_INPUT:  # called once more, it raises the reason
            return
        now.sent[:] = tick.tau
        for i in range(tick.places.size):
            now.record[i] = tick.known[tick.places[i]]
        at[WHERE] = COMPUTED
        at[FOUND] = safety.after(guard, nothing, parts[1], q, v, now.applied, now.record, nothing, tip_ref, now.sent)
        at[LIMITED] = at[FOUND] // safety.INSIDE - 2  # see `safety_tick.after`; below 0: not a number of joints
        rows.tick_us[row] = _microseconds(call_clock, now.clock) - begin
        if at[FOUND] % safety.INSIDE != 0 or at[LIMITED] < 0:
            return
        if at[LIMITED] > 0:
            tick.torque[:], rows.limited[row] = now.sent, at[LIMITED]
        if rows.reports.shape[0] > 0:
            rows.reports[row] = tick.report
        now.applied[:], rows.tau[row], rows.wrench[row] = now.sent, now.sent, wrench
        at[WHERE], k = MOVED, row - first
        at[FOUND] = period.advance(
            plant, now.sent, at[SLOT], rows.trocars[row], tissue, pushed, pushes, noise[k], wrench_noise[k],
            now.reading,
        )  # fmt: skip
        if at[FOUND] != period.DONE:
            return
        at[ROW], at[STAMP], at[SLOT] = row + 1, at[STAMP] + 1, (at[SLOT] + 1) % parts[2]
    at[WHERE] = ALL


_STEPS = CompiledKernel(
    steps, period.MEMORY, safety.MEMORY, TICK,
    named(Rows, *[CUBE] * 3, *[MATRIX] * 3, VECTOR, BYTES, MATRIX, INDICES),
    named(Now, INDICES, *[VECTOR] * 5, INDICES), INTEGER, INDICES, VECTOR, INDICES, MATRIX, MATRIX, MATRIX, VECTOR,
    INTEGER,
)  # fmt: skip


class CompiledSteps:
    """`steps` for a plant, a tick and a safety filter; see `sim.closed_loop.CompiledSteps`."""

    def __init__(self, plant: Plant, controller: CalledTick, safety_filter: SafetyFilter, clock: int) -> None:
        self._plant, self._controller, self._filter, self._clock = plant, controller, safety_filter, clock
        self._block: Block | None = None

    def __call__(self, block: Block, most: int, applied: Array) -> Stepped:
        """Advance from the block's first row that is not done, by so many periods at most; rows are filled in."""
        plant, tick, n = self._plant, self._controller.memory, applied.size
        if block is not self._block:
            self._block = block
            tip_refs, trocars, registered = (
                np.ascontiguousarray(told) for told in (block.tip_refs, block.trocars, block.registered)
            )
            self._rows = Rows(
                tip_refs=tip_refs, trocars=trocars, registered=registered, truth=block.truth, wrench=block.wrench,
                tau=block.tau, tick_us=block.tick_us, limited=block.limited, reports=self._controller.reports,
                codes=np.zeros(block.ticks, dtype=np.int64),
            )  # fmt: skip
        seen, ahead, first = plant.measure(), plant.ahead(), block.done
        most = min(most, self._controller.most)
        self._controller.begin(block.kept, first)
        now = Now(
            at=np.array([first, ALL, 0, seen.stamp, ahead.slot, 0]), reading=np.concatenate(seen[:3]),
            seen=np.empty(2 * n + 6), applied=np.array(applied), sent=np.empty(n), record=np.empty(tick.places.size),
            clock=np.zeros(2, dtype=np.int64),
        )  # fmt: skip
        last = min(block.ticks, first + most, first + len(ahead.noise), first + len(ahead.wrench_noise))
        with self._controller.calling():
            _STEPS.code(
                plant.memory, self._filter.memory, tick, self._rows, now, last,
                np.array([*self._filter.parts, ahead.turns]), ahead.tissue, ahead.pushed, ahead.pushes, ahead.noise,
                ahead.wrench_noise, np.empty(0), self._clock,
            )  # fmt: skip
        row, where, found, stamp, _, limited = now.at.tolist()
        ticked = row - first + (where in (COMPUTED, MOVED))
        self._controller.took(self._rows.codes[first : first + ticked], block.kept, first)
        self._filter.took(row - first, limited)
        plant.took(row - first, now.reading)
        begun = NOTHING
        if where == MEASURED:
            begun = Begun(found)
        elif where == COMPUTED:
            begun = Begun(safety.ACCEPTED, now.sent, found)
        elif where == MOVED:
            begun = Begun(safety.ACCEPTED, now.sent, safety.INSIDE * (limited + 2), found)
        block.done, arrived = row, read_only(now.seen)
        return Stepped(
            row - first, Measurement(arrived[:n], arrived[n : 2 * n], arrived[2 * n :], stamp - 1), now.applied, begun
        )  # fmt: skip


def compiled_steps(
    plant: Plant, controller: CalledTick, safety_filter: SafetyFilter, faults: Faults | None
) -> CompiledSteps | None:
    """Make the compiled steps of a run; None where faults act in Python, or the machine has no C clock."""
    clock = getattr(ctypes.CDLL(None), "clock_gettime", None) if hasattr(time, "CLOCK_MONOTONIC") else None
    if clock is None or faults is not None:
        return None
    return CompiledSteps(plant, controller, safety_filter, ctypes.cast(clock, ctypes.c_void_p).value or 0)
