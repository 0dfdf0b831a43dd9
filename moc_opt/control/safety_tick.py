"""The safety filter's two halves of a tick, each compiled as one: before the controller, and after it."""

from __future__ import annotations

import numpy as np
from numba import float64, int64
from numpy.typing import NDArray

from moc_opt.control import incision
from moc_opt.control import motion_kernels as motion
from moc_opt.control.replay_kernels import count_lagging, count_replayed
from moc_opt.control.safety_kernels import believable, limit_torque, squared_error
from moc_opt.model.kinematics_kernels import state_views
from moc_opt.model.place_kernels import tool_pose
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import INDICES, MATRIX, VECTOR, CompiledKernel, borrowed

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


@njit(cache=True, nogil=True)
def before(
    jump: float, period: float, patience: int, bounds: Array, tau_max: Array, levels: Array, most_replayed: Array,
    clock: Indices, counts: Indices, believed: Array, memory: Array, still: Array, tip: Array, seen: Array,
    count: Array, joints_seen: Array, joints_count: Array, joints: Array, mount: Array, tool_tip: Array, tool: Array,
    lowest: Array, means: Array, point: Array,
    parts: int, q: Array, v: Array, stamp: int, applied: Array, wrench: Array, trocar: Array,
) -> int:  # fmt: skip
    """Judge a measurement, and what it says of the incision; return flags and digits.

    Args:
        jump, bounds: as for ``believable``.
        period: control period [s].
        patience, tau_max, levels, clock, memory, still, tip: as for ``motion_kernels``.
        most_replayed: (2,) readings in a row that may have come before, without and with noise of the wrench sensor.
        counts: (3,) changed in place.
        believed: (2, n) changed in place: rows q and v, the last accepted ones or what follows from them.
        seen, count: as for ``count_replayed``; joints_seen, joints_count: as for ``count_lagging``.
        joints, mount, tool_tip: as for ``tool_pose``.
        tool, lowest, means: as for ``incision.take``; point: (3,) written: the trocar.
        parts: what is to be checked beside what can be believed: AGE, READING, INCISION.
        q, v: (n,) as measured [rad], [rad/s]; stamp: number of the control period in which they were.
        applied: (n,) torque that was applied before [Nm]; wrench: (6,) at the tool's mount; trocar: (2, 3).
    """
    q, v, believed, memory, wrench = borrowed(q), borrowed(v), borrowed(believed), borrowed(memory), borrowed(wrench)
    found, late = 0, motion.FRESH
    if parts & AGE:
        gap = clock[1]
        late = motion.age(stamp, patience, clock)
        counts[GAP] += clock[1] - gap
        if late == motion.OLD:
            found += TOO_OLD
    if late == motion.FRESH and believable(q, v, believed[0], jump, 1 + counts[BAD], bounds):
        found += ACCEPTED
        believed[0], believed[1], counts[BAD] = q, v, 0
        if parts & READING:
            what = motion.compare_readings(
                patience, tau_max, levels, memory, still, q, v, applied, wrench, tip, period * max(1, counts[GAP])
            )
            counts[GAP] = 0
            # Where no encoder repeats a reading, one that came before is found as soon as one that comes twice.
            most = levels[motion.REPEAT_READING_TICKS]
            if count_lagging(q, v, joints_seen, joints_count) > most and what == motion.NOTHING:
                what = motion.LAGGING
            most = min(most, most_replayed[1 if motion.has_noise(still) else 0])
            if count_replayed(q, v, wrench, seen, count) > most:
                what = motion.RECORDED
            found += WHAT * what
    else:
        counts[BAD] += 1
        for i in range(q.shape[0]):
            believed[0, i] += believed[1, i] * period
    if parts & INCISION:
        pose = np.empty((4, 3))
        tool_pose(joints, believed[0], mount, tool_tip, pose)
        point[:] = trocar[0]
        found += INSIDE * incision.take(tool, lowest, means, pose, point, wrench)
    return found


@njit(cache=True, nogil=True)
def after(
    period: float, patience: int, step: float, share: float, most: float, settling: int, limits: Array, wall: Array,
    hold: Array, levels: Array, held: Array, counts: Indices, memory: Array, reference: Array, square: Array,
    parts: int, q: Array, v: Array, applied: Array, record: Array, tip: Array, tip_ref: Array, tau: Array,
) -> int:  # fmt: skip
    """Judge the tip and the motion, and limit a torque in place; return flags and digits.

    Args:
        period, patience, levels, held, memory: as for ``compare_momentum``.
        step, limits, wall: as for ``limit_torque``; hold: empty, the weight is not known.
        share: of a tick in the mean square of the tip's error; most: its limit [m^2].
        settling: ticks until the momentum residual is what it will be.
        counts: (3,) changed in place.
        reference: (3,) written: X_d, for the next reading; square: (1,) changed in place: that mean [m^2].
        parts: what is to be checked beside the torque: TIP, MOMENTUM.
        q, v: (n,) believed; applied: (n,) torque that was applied before [Nm].
        record: state of (q, v); empty: not known.
        tip: (3,) as the controller computes it [m]; empty: that of the state.
        tip_ref: (3, 3) rows X_d, dX_d, ddX_d.
        tau: (n,) changed in place [Nm].
    """
    n, found = tau.shape[0], 0
    record, limits = borrowed(record), borrowed(limits)
    if parts & TIP:
        for i in range(3):
            reference[i] = tip_ref[0, i]
        at = tip if tip.shape[0] == 3 else state_views(record, n).tip
        square[0] += share * (squared_error(at, tip_ref) - square[0])
        if not square[0] <= most:
            found += OFF_REFERENCE
    if parts & MOMENTUM:
        counts[CHECKED] += 1
        settled = -1 if counts[CHECKED] == 1 else 1 if counts[CHECKED] > settling else 0
        found += WHAT * motion.compare_momentum(
            patience, limits[3], levels, memory, held, period, record, applied, settled
        )
    return found + INSIDE * (2 + limit_torque(tau, applied, q, v, hold, limits, wall, step))


BEFORE = CompiledKernel(
    before, float64, float64, int64, MATRIX, *[VECTOR] * 3, INDICES, INDICES, MATRIX, MATRIX, VECTOR, VECTOR, MATRIX,
    VECTOR, *[MATRIX] * 4, *[VECTOR] * 5, int64, VECTOR, VECTOR, int64, VECTOR, VECTOR, MATRIX,
)  # fmt: skip
AFTER = CompiledKernel(
    after, float64, int64, float64, float64, float64, int64, MATRIX, *[VECTOR] * 4, INDICES, MATRIX, VECTOR, VECTOR,
    int64, *[VECTOR] * 5, MATRIX, VECTOR,
)  # fmt: skip
