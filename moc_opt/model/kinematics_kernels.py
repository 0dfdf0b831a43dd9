"""The compiled kernels behind RobotModel, one equation each, and the layout of a state record.

Spatial axes: `axes` (n,6) holds one row per joint, [linear, angular] velocity at the world origin for unit
joint velocity, in world axes (the transpose of pinocchio's data.J). A revolute joint has a unit angular part,
a prismatic one has none; every equation here holds for both.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moc_opt.model.dynamics_kernels import energy_slope, gravity_torque
from moc_opt.model.manipulability_kernels import manipulability, shaft_manipulability, yoshikawa
from moc_opt.model.place_kernels import place_joints, point_in_world, spatial_axes
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import borrowed

OK, BAD_Q, BAD_V = 0, 1, 2


class StateViews(NamedTuple):
    """Named views into one flat state record; the order and shapes here are the layout, defined once."""

    q: Array
    """(n,)"""
    v: Array
    """(n,)"""
    tip: Array
    """(3,)"""
    wrist: Array
    """(3,)"""
    u: Array
    """(3,) unit vector from wrist to tip"""
    A: Array
    """(6,n) J_tip over J_wrist"""
    drift: Array
    """(6,) drift of tip, then of wrist"""
    grad_mu: Array
    """(n,)"""
    grad_mu_shaft: Array
    """(n,)"""
    M: Array
    """(n,n)"""
    h: Array
    """(n,)"""
    energy_slope: Array
    """(n,)"""
    gravity: Array
    """(n,)"""
    scalars: Array
    """(3,) mu, distance from wrist to tip, mu of the shaft"""


def record_size(n: int) -> int:
    """Return the length of the flat record of an n-joint state."""
    return n * n + 13 * n + 18


@njit(cache=True)
def state_views(record: Array, n: int) -> StateViews:
    """Compute the named views of a flat record; for use inside other kernels, and in Python through `.py_func`."""
    a = 2 * n + 9
    d = a + 6 * n
    g = d + 6
    m = g + 2 * n
    h = m + n * n
    return StateViews(
        record[0:n], record[n : 2 * n], record[2 * n : 2 * n + 3], record[2 * n + 3 : 2 * n + 6],
        record[2 * n + 6 : a], record[a:d].reshape((6, n)), record[d:g], record[g : g + n], record[g + n : m],
        record[m:h].reshape((n, n)), record[h : h + n], record[h + n : h + 2 * n], record[h + 2 * n : h + 3 * n],
        record[h + 3 * n : h + 3 * n + 3],
    )  # fmt: skip


@njit(cache=True)
def all_finite(x: Array) -> bool:
    """Return whether no entry is NaN or infinite."""
    total = 0.0
    for value in x:
        total += 0.0 * value  # NaN for NaN and for both infinities
    return total == 0.0


@njit(cache=True)
def point_jacobian(axes: Array, point: Array, moves: Array, out: Array) -> None:
    """Fill the translational Jacobian (3,n) of a point fixed to the last link: J_j = lin_j + ang_j x point.

    Columns of joints that can never move the point (moves[j] false) are exactly zero.
    """
    for j in range(axes.shape[0]):
        if moves[j]:
            wx, wy, wz = axes[j, 3], axes[j, 4], axes[j, 5]
            out[0, j] = axes[j, 0] + wy * point[2] - wz * point[1]
            out[1, j] = axes[j, 1] + wz * point[0] - wx * point[2]
            out[2, j] = axes[j, 2] + wx * point[1] - wy * point[0]
        else:
            out[0, j] = out[1, j] = out[2, j] = 0.0


@njit(cache=True)
def drift(axes: Array, jacobian: Array, v: Array, out: Array) -> None:
    """Compute the acceleration dJ v (3,) of a point at zero joint acceleration.

    In a serial chain dJ_j/dq_k = ang_min(j,k) x J_max(j,k), so that, with w_k = ang_k v_k,
    dJ v = sum_m (2 sum_{k<m} w_k + w_m) x J_m v_m.
    """
    sx = sy = sz = 0.0
    out[0] = out[1] = out[2] = 0.0
    for m in range(axes.shape[0]):
        wx, wy, wz = axes[m, 3] * v[m], axes[m, 4] * v[m], axes[m, 5] * v[m]
        ax, ay, az = 2.0 * sx + wx, 2.0 * sy + wy, 2.0 * sz + wz
        bx, by, bz = jacobian[0, m] * v[m], jacobian[1, m] * v[m], jacobian[2, m] * v[m]
        out[0] += ay * bz - az * by
        out[1] += az * bx - ax * bz
        out[2] += ax * by - ay * bx
        sx += wx
        sy += wy
        sz += wz


@njit(cache=True)
def mu_along(poses: Array, joints: Array, offsets: Array, moves: Array, mu: Array) -> None:
    """Write mu of the tip at the poses (k,n) into mu (k,); other arguments as of `fill_state`."""
    n = poses.shape[1]
    tip, jacobian, places, axes = np.empty(3), np.empty((3, n)), np.empty((n, 12)), np.empty((n, 6))
    for k in range(poses.shape[0]):
        place_joints(joints, poses[k], places)
        spatial_axes(joints, places, axes)
        point_in_world(places[n - 1, :9].reshape((3, 3)), places[n - 1, 9:], offsets[0], tip)
        point_jacobian(axes, tip, moves[0], jacobian)
        mu[k] = yoshikawa(jacobian)


@njit(cache=True)
def fill_state(
    record: Array, q: Array, v: Array, axes: Array, joints: Array, places: Array, bodies: Array, field: Array,
    offsets: Array, moves: Array, inertia: Array, bias: Array,
) -> int:  # fmt: skip
    """Fill a record; returns OK, BAD_Q or BAD_V (not finite).

    Args:
        record: (record_size(n),).
        q, v: (n,).
        axes: (n,6) written, as by `spatial_axes`.
        joints: (n,16) as in `Chain.joints`.
        places: (n,12) written, as by `place_joints`.
        bodies: (n,10) of every link, in its joint's axes: mass [kg], mass times centre of mass [kg m], and the inertia
            about that centre xx, xy, yy, xz, yz, zz [kg m^2].
        field: (3,) gravity [m/s^2].
        offsets: (2,3) tip and wrist in the last joint's frame [m].
        moves: (2,n) bool: which joints can move tip and wrist.
        inertia, bias: M (n,n) and h (n,).
    """
    n = axes.shape[0]
    record, q, v, axes, places = borrowed(record), borrowed(q), borrowed(v), borrowed(axes), borrowed(places)
    bodies, field, offsets, moves = borrowed(bodies), borrowed(field), borrowed(offsets), borrowed(moves)
    joints = borrowed(joints)
    if not all_finite(q):
        return BAD_Q
    if not all_finite(v):
        return BAD_V
    s = state_views(record, n)
    place_joints(joints, q, places)
    spatial_axes(joints, places, axes)
    rotation_t, origin = places[n - 1, :9].reshape((3, 3)), places[n - 1, 9:]
    point_in_world(rotation_t, origin, offsets[0], s.tip)
    point_in_world(rotation_t, origin, offsets[1], s.wrist)
    span = 0.0
    for i in range(3):
        s.u[i] = s.tip[i] - s.wrist[i]
        span += s.u[i] * s.u[i]
    span = math.sqrt(span)
    for i in range(3):
        s.u[i] /= span
    point_jacobian(axes, s.tip, moves[0], s.A[0:3])
    point_jacobian(axes, s.wrist, moves[1], s.A[3:6])
    drift(axes, s.A[0:3], v, s.drift[0:3])
    drift(axes, s.A[3:6], v, s.drift[3:6])
    s.scalars[0] = manipulability(axes, s.A[0:3], s.grad_mu)
    s.scalars[1] = span
    s.scalars[2] = shaft_manipulability(axes, s.A, s.u, s.grad_mu_shaft)
    energy_slope(axes, places, bodies, v, s.energy_slope)
    gravity_torque(axes, places, bodies, field, s.gravity)
    for i in range(n):
        s.q[i], s.v[i], s.h[i] = q[i], v[i], bias[i]
        for j in range(n):
            s.M[i, j] = inertia[i, j]
    return OK
