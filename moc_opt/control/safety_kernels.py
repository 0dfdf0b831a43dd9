"""The compiled parts of the safety filter: torque limits, bounds of a measurement, and the tip's squared error."""

from __future__ import annotations

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit


@njit(cache=True, nogil=True)
def limit_torque(
    tau: Array, before: Array, q: Array, v: Array, hold: Array, limits: Array, wall: Array, step: float
) -> int:
    """Apply walls, speed limit, torque rate and torque limit to tau (n,), in place.

    At a distance d from its wall a joint may move towards it at v_allowed = min(v_max, sqrt(2 brake d)).
    A faster one is braked: tau <= hold - damping (v - v_allowed), and inside the wall
    tau <= hold - stiffness depth - damping v, whatever the command is.

    Args:
        before: (n,) torque of the last tick [Nm].
        hold: (n,) torque that carries the arm's weight [Nm]; empty: not known yet.
        limits: (4, n) rows: where the walls begin, below and above [rad or m]; v_max, tau_max.
        wall: stiffness [Nm/rad], damping [Nm s/rad], brake [rad/s^2].
        step: largest change from ``before`` [Nm].

    Returns:
        The number of joints at which something was limited; -1 where ``hold`` is empty and a joint must be
        braked, -2 where the torque is no number. tau is as it was in both of these cases.
    """
    n = tau.shape[0]
    stiffness, damping, brake = wall[0], wall[1], wall[2]
    push = np.zeros((2, n))  # least and largest torque above ``hold`` that walls and brakes allow
    braked = False
    for i in range(n):
        if not np.isfinite(tau[i]):
            return -2
        push[0, i], push[1, i] = -np.inf, np.inf
        below, above = q[i] - limits[0, i], limits[1, i] - q[i]
        fall = min(limits[2, i], np.sqrt(2.0 * brake * max(below, 0.0)))
        rise = min(limits[2, i], np.sqrt(2.0 * brake * max(above, 0.0)))
        if below < 0.0 or v[i] < -fall:
            push[0, i] = stiffness * max(-below, 0.0) - damping * min(v[i] + fall, 0.0)
            braked = True
        if above < 0.0 or v[i] > rise:
            push[1, i] = -stiffness * max(-above, 0.0) - damping * max(v[i] - rise, 0.0)
            braked = True
        if push[0, i] > push[1, i]:  # leaving a wall too fast already: neither spring nor brake
            push[0, i] = push[1, i] = 0.0
    if braked and hold.shape[0] != n:
        return -1
    touched = 0
    for i in range(n):
        asked = tau[i]
        if braked:
            tau[i] = max(min(tau[i], hold[i] + push[1, i]), hold[i] + push[0, i])
        tau[i] = min(max(tau[i], before[i] - step), before[i] + step)
        tau[i] = min(max(tau[i], -limits[3, i]), limits[3, i])
        if tau[i] != asked:
            touched += 1
    return touched


@njit(cache=True, nogil=True)
def believable(q: Array, v: Array, q_before: Array, jump: float, ticks: int, bounds: Array) -> bool:
    """Decide whether q (n,) [rad] is no farther from q_before than jump + ticks per_tick, and |v| <= fastest.

    ``bounds`` (2, n): rows per_tick and fastest. NaN is never believable.
    """
    per_tick, fastest = bounds[0], bounds[1]
    for i in range(q.shape[0]):
        if not (abs(q[i] - q_before[i]) <= jump + ticks * per_tick[i] and abs(v[i]) <= fastest[i]):
            return False
    return True


@njit(cache=True, nogil=True)
def squared_error(tip: Array, tip_ref: Array) -> float:
    """Compute |tip - X_d|^2 [m^2], X_d the first row of tip_ref (3, 3)."""
    square = 0.0
    for i in range(3):
        square += (tip[i] - tip_ref[0, i]) ** 2
    return square


@njit(cache=True, nogil=True)
def holding_friction(weight: Array, tau_max: Array, share: float, friction: Array) -> None:
    """Fill friction (n,) [Nm] of the brakes, enough to hold the arm in a stop also with weak drives.

    ``share`` of the drive's largest torque, and one and a half times what that drive cannot carry of the weight (n,).
    """
    for i in range(weight.shape[0]):
        friction[i] = share * tau_max[i] + 1.5 * max(abs(weight[i]) - tau_max[i], 0.0)
