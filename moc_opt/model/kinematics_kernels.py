"""The compiled kernels behind RobotModel, one equation each, and the layout of a state record.

Spatial axes: `axes` (n,6) holds one row per joint, [linear, angular] velocity at the world origin for unit
joint velocity, in world axes (the transpose of pinocchio's data.J). A revolute joint has a unit angular part,
a prismatic one has none; every equation here holds for both.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.model.dynamics_kernels import energy_slope, gravity_torque
from moc_opt.model.place_kernels import place_joints, point_in_world
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import borrowed

Array = NDArray[np.float64]

OK, BAD_Q, BAD_V = 0, 1, 2
# Below this det(J J^T), relative to the cube of the mean of its diagonal, mu is rounding noise.
_SINGULAR = 1e-14


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
    """Length of the flat record of an n-joint state."""
    return n * n + 13 * n + 18


@njit(cache=True)
def state_views(record: Array, n: int) -> StateViews:
    """The named views of a flat record; for use inside other kernels, and in Python through `.py_func`."""
    a = 2 * n + 9
    d = a + 6 * n
    g = d + 6
    m = g + 2 * n
    h = m + n * n
    return StateViews(
        record[0:n],
        record[n : 2 * n],
        record[2 * n : 2 * n + 3],
        record[2 * n + 3 : 2 * n + 6],
        record[2 * n + 6 : a],
        record[a:d].reshape((6, n)),
        record[d:g],
        record[g : g + n],
        record[g + n : m],
        record[m:h].reshape((n, n)),
        record[h : h + n],
        record[h + n : h + 2 * n],
        record[h + 2 * n : h + 3 * n],
        record[h + 3 * n : h + 3 * n + 3],
    )


@njit(cache=True)
def all_finite(x: Array) -> bool:
    """Whether no entry is NaN or infinite."""
    total = 0.0
    for value in x:
        total += 0.0 * value  # NaN for NaN and for both infinities
    return total == 0.0


@njit(cache=True)
def point_jacobian(axes: Array, point: Array, moves: Array, out: Array) -> None:
    """Translational Jacobian (3,n) of a point fixed to the last link: J_j = lin_j + ang_j x point.

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
    """The acceleration dJ v (3,) of a point at zero joint acceleration.

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
def gram(jacobian: Array) -> tuple[float, float, float, float, float, float]:
    """Compute a .. f of J J^T = [[a, b, c], [b, d, e], [c, e, f]] for J (3,n)."""
    a = b = c = d = e = f = 0.0
    for j in range(jacobian.shape[1]):
        x, y, z = jacobian[0, j], jacobian[1, j], jacobian[2, j]
        a += x * x
        b += x * y
        c += x * z
        d += y * y
        e += y * z
        f += z * z
    return a, b, c, d, e, f


@njit(cache=True)
def yoshikawa(jacobian: Array) -> float:
    """mu = sqrt(det(J J^T)) alone, to the bit that of `manipulability`."""
    a, b, c, d, e, f = gram(jacobian)
    return math.sqrt(max(a * (d * f - e * e) + b * (c * e - b * f) + c * (b * e - c * d), 0.0))


@njit(cache=True)
def manipulability(axes: Array, jacobian: Array, grad: Array) -> float:
    """mu = sqrt(det(J J^T)) (Yoshikawa), and its gradient (n,) into `grad`.

    dmu/dq_k = mu trace(dJ/dq_k pinv(J)), with the dJ_j/dq_k of `drift` and rows P_j = (J J^T)^-1 J_j of the
    pseudo-inverse: dmu/dq_k = mu (ang_k . sum_{j>=k} J_j x P_j + J_k . sum_{j<k} P_j x ang_j).
    At a singularity mu has a kink and no gradient: zero is returned there, never NaN.
    """
    n = axes.shape[0]
    a, b, c, d, e, f = gram(jacobian)
    i00, i01, i02 = d * f - e * e, c * e - b * f, b * e - c * d
    i11, i12, i22 = a * f - c * c, b * c - a * e, a * d - b * b
    det = a * i00 + b * i01 + c * i02
    mean = (a + d + f) / 3.0
    mu = math.sqrt(max(det, 0.0))
    if det <= _SINGULAR * mean * mean * mean:
        for k in range(n):
            grad[k] = 0.0
        return mu
    # From the base the sums of P_j x ang_j over j < k; then from the tip those of J_j x P_j over j >= k.
    sx = sy = sz = 0.0
    for k in range(n):
        x, y, z = jacobian[0, k], jacobian[1, k], jacobian[2, k]
        grad[k] = x * sx + y * sy + z * sz
        px, py, pz = i00 * x + i01 * y + i02 * z, i01 * x + i11 * y + i12 * z, i02 * x + i12 * y + i22 * z
        wx, wy, wz = axes[k, 3], axes[k, 4], axes[k, 5]
        sx += py * wz - pz * wy
        sy += pz * wx - px * wz
        sz += px * wy - py * wx
    sx = sy = sz = 0.0
    for k in range(n - 1, -1, -1):
        x, y, z = jacobian[0, k], jacobian[1, k], jacobian[2, k]
        px, py, pz = i00 * x + i01 * y + i02 * z, i01 * x + i11 * y + i12 * z, i02 * x + i12 * y + i22 * z
        sx += y * pz - z * py
        sy += z * px - x * pz
        sz += x * py - y * px
        grad[k] = (grad[k] + axes[k, 3] * sx + axes[k, 4] * sy + axes[k, 5] * sz) / mu
    return mu


@njit(cache=True)
def shaft_manipulability(axes: Array, A: Array, u: Array, grad: Array) -> float:
    """Manipulability of the shaft once the tip is held, mu_s = sqrt(pdet(C)) [m^2], and its gradient (n,) into `grad`.

    C = J_W N J_W^T (3,3) with N = I - pinv(J_T) J_T: how motion that leaves the tip alone moves the wrist; it has no
    part along the shaft u, so that pdet(C) is the product of its other two eigenvalues. mu mu_s is the volume of the
    five rows of tip and shaft together: where mu_s is zero a joint speed without bound is needed to turn the shaft.

    In the axes of the tool, which turn with ang_k, dJ_j/dq_k is zero for k <= j and ang_j x J_k - ang_k x J_j else, so
    with Q = C^+ J_W N on the wrist's columns and -K^T Q on the tip's, K = J_W pinv(J_T),
    dmu_s/dq_k = mu_s sum_{wrist, tip} (J_k . sum_{j<k} P_j x ang_j - ang_k . sum_{j<k} J_j x P_j).
    Zero where mu or mu_s has a kink.
    """
    n = axes.shape[0]
    for k in range(n):
        grad[k] = 0.0
    T, W = A[0:3], A[3:6]
    room = np.zeros((6, 3, 3))
    tip, mixed, rest, inverse, K, C = room[0], room[1], room[2], room[3], room[4], room[5]
    for j in range(n):
        for a in range(3):
            for b in range(3):
                tip[a, b] += T[a, j] * T[b, j]
                mixed[a, b] += W[a, j] * T[b, j]
                rest[a, b] += W[a, j] * W[b, j]
    det = _adjugate3(tip, inverse)
    mean = (tip[0, 0] + tip[1, 1] + tip[2, 2]) / 3.0
    if det <= _SINGULAR * mean * mean * mean:
        return 0.0
    inverse /= det
    for a in range(3):
        for b in range(3):
            K[a, b] = mixed[a, 0] * inverse[0, b] + mixed[a, 1] * inverse[1, b] + mixed[a, 2] * inverse[2, b]
    for a in range(3):
        for b in range(3):
            C[a, b] = rest[a, b] - K[a, 0] * mixed[b, 0] - K[a, 1] * mixed[b, 1] - K[a, 2] * mixed[b, 2]
    trace = C[0, 0] + C[1, 1] + C[2, 2]
    minors = 0.0  # of rank two: the sum of the principal minors is the product of both eigenvalues
    for a in range(3):
        b = (a + 1) % 3
        minors += C[a, a] * C[b, b] - C[a, b] * C[b, a]
    mu = math.sqrt(max(minors, 0.0))
    if not minors > _SINGULAR * trace * trace:
        return mu
    size = 0.5 * trace  # any number above zero: it only fills the direction of u, which is taken out below
    for a in range(3):
        for b in range(3):
            C[a, b] += size * u[a] * u[b]
    inverse /= _adjugate3(C, inverse)
    sums = np.zeros((7, 3))
    moved, P, turns, pulls = sums[0], sums[1:3], sums[3:5], sums[5:7]
    for k in range(n):
        for a in range(3):  # column k of J_W N; u^T (J_W N) = 0
            moved[a] = W[a, k] - K[a, 0] * T[0, k] - K[a, 1] * T[1, k] - K[a, 2] * T[2, k]
        for a in range(3):
            P[1, a] = inverse[a, 0] * moved[0] + inverse[a, 1] * moved[1] + inverse[a, 2] * moved[2]
        for a in range(3):
            P[0, a] = -(K[0, a] * P[1, 0] + K[1, a] * P[1, 1] + K[2, a] * P[1, 2])
        for i in range(2):
            J, p, turn, pull = A[3 * i : 3 * i + 3, k], P[i], turns[i], pulls[i]
            for a in range(3):
                grad[k] += mu * (J[a] * pull[a] - axes[k, 3 + a] * turn[a])
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                pull[a] += p[b] * axes[k, 3 + c] - p[c] * axes[k, 3 + b]
                turn[a] += J[b] * p[c] - J[c] * p[b]
    return mu


@njit(cache=True)
def _adjugate3(S: Array, out: Array) -> float:
    """Write the adjugate of a symmetric (3,3), its inverse times its determinant; returns the determinant."""
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        for d in range(3):
            e, f = (d + 1) % 3, (d + 2) % 3
            out[a, d] = S[b, e] * S[c, f] - S[b, f] * S[c, e]
    return float(S[0, 0] * out[0, 0] + S[0, 1] * out[0, 1] + S[0, 2] * out[0, 2])


@njit(cache=True)
def tip_manipulability(q: Array, axes: Array, joints: Array, offsets: Array, moves: Array) -> float:
    """mu of the tip, from the arguments of `fill_state`."""
    n = axes.shape[0]
    tip, jacobian, places = np.empty(3), np.empty((3, n)), np.empty((n, 12))
    place_joints(joints, q, places)
    point_in_world(places[n - 1, :9].reshape((3, 3)), places[n - 1, 9:], offsets[0], tip)
    point_jacobian(axes, tip, moves[0], jacobian)
    return float(yoshikawa(jacobian))


@njit(cache=True)
def fill_state(
    record: Array,
    q: Array,
    v: Array,
    axes: Array,
    joints: Array,
    places: Array,
    bodies: Array,
    field: Array,
    offsets: Array,
    moves: Array,
    inertia: Array,
    bias: Array,
) -> int:
    """Fill a record; returns OK, BAD_Q or BAD_V (not finite).

    Args:
        record: (record_size(n),).
        q, v: (n,).
        axes: (n,6) spatial axes.
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
