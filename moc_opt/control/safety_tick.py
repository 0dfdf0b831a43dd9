"""The safety filter's two halves of a tick, each compiled as one: before the controller, and after it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.control import incision
from moc_opt.control import motion_kernels as motion
from moc_opt.control.replay_kernels import count_lagging, count_replayed
from moc_opt.control.safety_kernels import believable, limit_torque, squared_error
from moc_opt.model.kinematics_kernels import state_views
from moc_opt.model.place_kernels import tool_pose
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import INDICES, INTEGER, MATRIX, REAL, VECTOR, CompiledKernel, borrowed, named

Indices = NDArray[np.int64]

AGE, READING, INCISION, TIP, MOMENTUM = 1, 2, 4, 8, 16
"""What is to be checked, added up."""
BAD, GAP, CHECKED = range(3)
"""Places in the counts (3,): measurements in a row that were not accepted; control periods since the last reading that
was looked at; readings that were compared with the torque."""
ACCEPTED, TOO_OLD, OFF_REFERENCE = 1, 2, 4
"""Flags of what was found; the rest lies above them, a digit each."""
WHAT, INSIDE = 8, 128
"""Values of these digits: what ``motion_kernels`` found, and what ``incision.take`` did, or joints limited plus two."""



class SafetyMemory(NamedTuple):
    """Constants and memory of one safety filter; its kernels change the arrays in place."""

    jump: float
    """as for ``believable``"""
    period: float
    """control period [s]"""
    patience: int
    """[ticks]"""
    step: float
    """as for ``limit_torque``"""
    share: float
    """of a tick in the mean square of the tip's error"""
    most: float
    """limit of that mean [m^2]"""
    settling: int
    """ticks until the momentum residual is what it will be"""
    bounds: Array
    """as for ``believable``"""
    limits: Array
    """as for ``limit_torque``; its last row is tau_max"""
    wall: Array
    """as for ``limit_torque``"""
    levels: Array
    """as for ``motion_kernels``, and so held, clock, memory, still"""
    held: Array
    most_replayed: Array
    """(2,) readings in a row that may have come before, without and with noise of the wrench sensor"""
    clock: Indices
    counts: Indices
    """(3,) BAD, GAP, CHECKED"""
    believed: Array
    """(2, n) rows q and v, the last accepted ones or what follows from them"""
    memory: Array
    still: Array
    told: Array
    """(3,) X_d of the last tick [m]"""
    square: Array
    """(1,) mean square of the tip's error [m^2]"""
    readings: Array
    """as for ``count_replayed``, and so its count"""
    readings_count: Array
    joints_seen: Array
    """as for ``count_lagging``, and so joints_count"""
    joints_count: Array
    joints: Array
    """as for ``tool_pose``, and so mount, tip"""
    mount: Array
    tip: Array
    tool: Array
    """as for ``incision.take``, and so lowest, means"""
    lowest: Array
    means: Array
    point: Array
    """(3,) the trocar"""


MEMORY = named(
    SafetyMemory, REAL, REAL, INTEGER, *[REAL] * 3, INTEGER, MATRIX, MATRIX, *[VECTOR] * 4, INDICES, INDICES, MATRIX,
    MATRIX, *[VECTOR] * 3, MATRIX, VECTOR, *[MATRIX] * 4, *[VECTOR] * 5,
)  # fmt: skip


@njit(cache=True, nogil=True)
def before(
    at: SafetyMemory, parts: int, q: Array, v: Array, stamp: int, applied: Array, wrench: Array, trocar: Array
) -> int:
    """Judge a measurement, and what it says of the incision; return flags and digits.

    Args:
        at: changed in place.
        parts: what is to be checked beside what can be believed: AGE, READING, INCISION.
        q, v: (n,) as measured [rad], [rad/s]; stamp: number of the control period in which they were.
        applied: (n,) torque that was applied before [Nm]; wrench: (6,) at the tool's mount; trocar: (2, 3).
    """
    at, q, v, wrench = borrowed(at), borrowed(q), borrowed(v), borrowed(wrench)
    believed, found, late = at.believed, 0, motion.FRESH
    if parts & AGE:
        gap = at.clock[1]
        late = motion.age(stamp, at.patience, at.clock)
        at.counts[GAP] += at.clock[1] - gap
        if late == motion.OLD:
            found += TOO_OLD
    if late == motion.FRESH and believable(q, v, believed[0], at.jump, 1 + at.counts[BAD], at.bounds):
        found += ACCEPTED
        believed[0], believed[1], at.counts[BAD] = q, v, 0
        if parts & READING:
            found += WHAT * _look(at, q, v, applied, wrench)
    else:
        at.counts[BAD] += 1
        for i in range(q.shape[0]):
            believed[0, i] += believed[1, i] * at.period
    if parts & INCISION:
        pose = np.empty((4, 3))
        tool_pose(at.joints, believed[0], at.mount, at.tip, pose)
        at.point[:] = trocar[0]
        found += INSIDE * incision.take(at.tool, at.lowest, at.means, pose, at.point, wrench)
    return found


@njit(cache=True, nogil=True)
def _look(at: SafetyMemory, q: Array, v: Array, applied: Array, wrench: Array) -> int:
    """Compare a new reading with the ones before; return what ``motion_kernels`` calls it."""
    levels, still = at.levels, at.still
    what = motion.compare_readings(
        at.patience, at.limits[3], levels, at.memory, still, q, v, applied, wrench, at.told,
        at.period * max(1, at.counts[GAP]),
    )  # fmt: skip
    at.counts[GAP] = 0
    # Where no encoder repeats a reading, one that came before is found as soon as one that comes twice.
    most = levels[motion.REPEAT_READING_TICKS]
    if most < np.inf and count_lagging(q, v, at.joints_seen, at.joints_count) > most and what == motion.NOTHING:
        what = motion.LAGGING
    most = min(most, at.most_replayed[1 if motion.has_noise(still) else 0])
    if count_replayed(q, v, wrench, at.readings, at.readings_count) > most:
        what = motion.RECORDED
    return what


@njit(cache=True, nogil=True)
def after(
    at: SafetyMemory, hold: Array, parts: int, q: Array, v: Array, applied: Array, record: Array, tip: Array,
    tip_ref: Array, tau: Array,
) -> int:  # fmt: skip
    """Judge the tip and the motion, and limit a torque in place; return flags and digits.

    Args:
        at: changed in place.
        hold: as for ``limit_torque``; empty: the weight is not known.
        parts: what is to be checked beside the torque: TIP, MOMENTUM.
        q, v: (n,) believed; applied: (n,) torque that was applied before [Nm].
        record: state of (q, v); empty: not known.
        tip: (3,) where the controller sees the tip [m]; empty: where the state has it.
        tip_ref: (3, 3) rows X_d, dX_d, ddX_d.
        tau: (n,) changed in place [Nm].
    """
    n, found = tau.shape[0], 0
    at, record = borrowed(at), borrowed(record)
    limits = at.limits
    if parts & TIP:
        for i in range(3):
            at.told[i] = tip_ref[0, i]
        seen = tip if tip.shape[0] == 3 else state_views(record, n).tip
        at.square[0] += at.share * (squared_error(seen, tip_ref) - at.square[0])
        if not at.square[0] <= at.most:
            found += OFF_REFERENCE
    if parts & MOMENTUM:
        at.counts[CHECKED] += 1
        settled = -1 if at.counts[CHECKED] == 1 else 1 if at.counts[CHECKED] > at.settling else 0
        found += WHAT * motion.compare_momentum(
            at.patience, limits[3], at.levels, at.memory, at.held, at.period, record, applied, settled
        )
    return found + INSIDE * (2 + limit_torque(tau, applied, q, v, hold, limits, at.wall, at.step))


BEFORE = CompiledKernel(before, MEMORY, INTEGER, VECTOR, VECTOR, INTEGER, VECTOR, VECTOR, MATRIX)
AFTER = CompiledKernel(after, MEMORY, VECTOR, INTEGER, *[VECTOR] * 5, MATRIX, VECTOR)
