"""Whether the encoders show the motion that the torque made: compiled checks on flat state.

Five signs, each of which a sound arm stays well below:

- the reading runs away from its own velocity: |q - integral of v|, forgotten over a time;
- all encoders repeat their reading to the last bit, while the tip is told to move or the torque changes; a little is
  enough where the wrench sensor repeats its reading too;
- one encoder repeats its reading for longer than its noise lets it, or its filtered velocity with it (in a row when it
  is stuck, now and then when it lags more and more), or while the joint must have gathered speed;
- the wrench sensor repeats its reading, as its noise does not let it: the trocar's force is no longer seen;
- the momentum residual (De Luca & Mattone 2003) leaves its own mean, or is larger than any load explains, as where its
  mean follows it because the torque grows slowly: the torque went into motion that no encoder shows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moc_opt.control.observer import momentum_residual
from moc_opt.model.kinematics_kernels import state_views
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit

GAP, PEAK, SHOWN, REPEATS, TORQUE, INTEGRAL, RESIDUAL, MEAN, AT_REPEAT, UNSEEN, EXCEEDED, SPEED, WHOLE = range(13)
"""Rows of the memory (ROWS, n): q - integral of v; largest recent |v|; the last q; ticks in a row with the same q; the
torque where all had repeated for the patience; the observer's integral, its residual r, and the mean of r; that mean
where the joint began to repeat, and the speed that it must have gathered since; ticks in a row with r far from its
mean; the last v; ticks so far with the same q and v as the tick before."""
ROWS = 13
FIRST_TICKS = 100.0

(
    MOTION_S, MOTION_RAD, MOTION_LAG_S, REPEAT_M, REPEAT_TORQUE, REPEAT_WHOLE_TORQUE, REPEAT_JOINT_TICKS, STUCK_SPEED,
    RESIDUAL_TORQUE, RESIDUAL_RATE, RESIDUAL_S, REPEAT_WHOLE_M, REPEAT_WHOLE_TICKS, RESIDUAL_WHOLE_TORQUE,
    REPEAT_READING_TICKS,
) = range(15)  # fmt: skip
"""Places in the levels (15,), in the order of ``MotionSettings.levels``."""

WRENCH, SAME_WRENCH, COUNTED, EVER_SAME, OLD_READINGS = 3, 9, 10, 11, 12
"""Places in ``still`` (13,): a tip (3,) comes first; see ``compare_readings``."""

NOTHING, RAN_AWAY, REPEATED, STUCK, UNEXPLAINED, ONE_REPEATED, RECORDED, WRENCH_REPEATED, LAGGING = range(9)

FRESH, REPEAT, OLD = 0, 1, 2


@njit(cache=True, nogil=True)
def age(stamp: int, patience: int, clock: NDArray[np.int64]) -> int:
    """Judge the age of a measurement by its number; call once a tick.

    The delay with which the first new measurement came is ordinary; an age of ``patience`` ticks more is too old.

    Args:
        stamp: number of the control period in which it was taken, by the arm's count.
        patience: ticks.
        clock: (3,) changed in place: the number that a measurement of this tick would have, that of the newest one
            seen, and the ordinary delay, -1 while it is not known; (s - 1, s - 1, -2) before the first one, number s.

    Returns:
        FRESH; REPEAT, for one that is not newer than the newest one seen, or is from the future; OLD.
    """
    clock[0] += 1
    late = clock[0] - stamp
    if -patience <= late < 0:  # the arm counted on while the controller missed ticks: its clock holds
        clock[0], late = stamp, 0
    newer = late >= 0 and stamp > clock[1]
    if newer:
        clock[1] = stamp
        if clock[2] < 0:  # the one that the run is started with is as old as it is told to be
            clock[2] = late if clock[2] == -1 else -1
    if clock[0] - clock[1] > max(clock[2], 0) + patience:
        return OLD
    return FRESH if newer else REPEAT


@njit(cache=True, nogil=True)
def has_noise(still: Array) -> bool:
    """Say whether the wrench sensor never repeated itself in the first readings; False until they are in."""
    return bool(still[COUNTED] >= FIRST_TICKS and still[EVER_SAME] == 0.0)  # of Python, also where it is not compiled


@njit(cache=True, nogil=True)
def compare_readings(
    patience: int, tau_max: Array, levels: Array, memory: Array, still: Array,
    q: Array, v: Array, tau: Array, wrench: Array, tip: Array, elapsed: float,
) -> int:  # fmt: skip
    """Compare a new reading with its own velocity and with the last one.

    Args:
        patience: ticks.
        tau_max: (n,) [Nm].
        levels: as in ``MotionSettings.levels``.
        memory: (ROWS, n) changed in place.
        still: (13,) changed in place: ``tip`` where all encoders had repeated themselves for the patience, the last
            wrench, the ticks in a row in which it was the same, the first ticks counted, and whether the wrench ever
            repeated itself in them: where it never did its sensor has noise; readings so far in which all
            encoders repeated position and velocity: each is an old one under a new number.
        q, v: (n,) as the sensors show them [rad], [rad/s].
        tau: (n,) the torque that went out last [Nm].
        wrench: (6,) as the sensor at the tool's mount shows it; NaN where there is none.
        tip: (3,) where the tip was told to be last [m].
        elapsed: time since the reading before [s].

    Returns:
        NOTHING, RAN_AWAY, REPEATED, ONE_REPEATED, or WRENCH_REPEATED.
    """
    n = q.shape[0]
    still[SAME_WRENCH] += 1.0
    for i in range(6):
        if wrench[i] != still[WRENCH + i]:
            still[SAME_WRENCH] = 0.0
        still[WRENCH + i] = wrench[i]
    if still[COUNTED] < FIRST_TICKS:
        still[COUNTED] += 1.0
        if still[SAME_WRENCH] > 0.0:
            still[EVER_SAME] = 1.0
    keep = 1.0 - min(1.0, elapsed / levels[MOTION_S])
    ran_away, fewest, most, all_whole, most_whole = False, 1e18, 0.0, True, 0.0
    for i in range(n):
        if memory[REPEATS, i] < 0.0:  # the first one: what it is compared with begins here
            memory[SHOWN, i] = q[i] - elapsed * v[i]
        memory[GAP, i] = keep * memory[GAP, i] + (q[i] - memory[SHOWN, i]) - elapsed * v[i]
        memory[PEAK, i] = max(keep * memory[PEAK, i], abs(v[i]))
        if abs(memory[GAP, i]) > levels[MOTION_RAD] + levels[MOTION_LAG_S] * memory[PEAK, i]:
            ran_away = True
        # A velocity that was never other than zero is no sign: the joint has rested since the start.
        same = q[i] == memory[SHOWN, i] and v[i] == memory[SPEED, i]
        whole = memory[REPEATS, i] >= 0.0 and same and memory[PEAK, i] > 0.0
        memory[WHOLE, i] += 1.0 if whole else 0.0
        memory[SPEED, i] = v[i]
        all_whole, most_whole = all_whole and whole, max(most_whole, memory[WHOLE, i])
        if memory[REPEATS, i] < 0.0 or q[i] == memory[SHOWN, i]:
            memory[REPEATS, i] += 1.0
        else:
            memory[REPEATS, i] = 0.0
            # The mean, as in r itself the velocity that one coarse step shows has its share.
            memory[AT_REPEAT, i], memory[UNSEEN, i] = memory[MEAN, i], 0.0
        fewest, most = min(fewest, memory[REPEATS, i]), max(most, memory[REPEATS, i])
        memory[SHOWN, i] = q[i]
    still[OLD_READINGS] += 1.0 if all_whole else 0.0
    if still[OLD_READINGS] > levels[REPEAT_READING_TICKS]:
        return REPEATED
    if fewest <= patience:  # from here on a repeated reading counts: what changes is counted from here as well
        for i in range(n):
            memory[TORQUE, i] = tau[i]
        for i in range(3):
            still[i] = tip[i]
    else:
        if has_noise(still) and still[SAME_WRENCH] > levels[REPEAT_WHOLE_TICKS]:
            return REPEATED
        wrench_too = still[SAME_WRENCH] > patience
        least = levels[REPEAT_WHOLE_TORQUE] if wrench_too else levels[REPEAT_TORQUE]
        way = levels[REPEAT_WHOLE_M] if wrench_too else levels[REPEAT_M]
        for i in range(3):
            if abs(tip[i] - still[i]) > way:
                return REPEATED
        for i in range(n):
            if abs(tau[i] - memory[TORQUE, i]) > least * tau_max[i]:
                return REPEATED
    if ran_away:
        return RAN_AWAY
    if most > levels[REPEAT_JOINT_TICKS] or most_whole > levels[REPEAT_READING_TICKS]:
        return ONE_REPEATED
    frozen = has_noise(still) and still[SAME_WRENCH] > levels[REPEAT_WHOLE_TICKS]
    return WRENCH_REPEATED if frozen else NOTHING


@njit(cache=True, nogil=True)
def compare_momentum(
    patience: int, tau_max: Array, levels: Array, memory: Array, held: Array, period: float,
    record: Array, tau: Array, settled: int,
) -> int:  # fmt: skip
    """Compare the motion that is seen with the torque (n,) [Nm] that acted over the period that ended at ``record``.

    Args are those of ``compare_readings``; held (n,) is the change of torque that static friction
    holds [Nm], record the flat state of the measurement, period the control period [s], and settled -1 at
    the first tick and 0 while the residual is still on its way from nothing to what the model does not know.

    Returns:
        NOTHING, STUCK or UNEXPLAINED.
    """
    n = tau.shape[0]
    s = state_views(record, n)
    if settled < 0:
        for i in range(n):
            memory[INTEGRAL, i] = 0.0
            for j in range(n):
                memory[INTEGRAL, i] += s.M[i, j] * s.v[j]
        return NOTHING
    momentum_residual(
        s.M, s.energy_slope, s.gravity, s.v, tau, levels[RESIDUAL_RATE], period, memory[INTEGRAL], memory[RESIDUAL]
    )
    share = min(1.0, period / levels[RESIDUAL_S])
    found = NOTHING
    for i in range(n):
        r = memory[RESIDUAL, i]
        if settled == 0:
            memory[MEAN, i], memory[AT_REPEAT, i], memory[UNSEEN, i] = r, r, 0.0
        memory[MEAN, i] += share * (r - memory[MEAN, i])
        beyond = r - memory[AT_REPEAT, i]
        beyond -= min(max(beyond, -held[i]), held[i])
        memory[UNSEEN, i] += period * beyond / s.M[i, i]
        if memory[REPEATS, i] > patience and abs(memory[UNSEEN, i]) > levels[STUCK_SPEED]:
            found = STUCK
        off_its_mean = abs(r - memory[MEAN, i]) > levels[RESIDUAL_TORQUE] * tau_max[i]
        far = off_its_mean or abs(r) > levels[RESIDUAL_WHOLE_TORQUE] * tau_max[i]
        memory[EXCEEDED, i] = memory[EXCEEDED, i] + 1.0 if far else 0.0
        if memory[EXCEEDED, i] > patience:
            return UNEXPLAINED
    return found
