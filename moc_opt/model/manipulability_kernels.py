"""Manipulability of the tip, and of the shaft once the tip is held, each with its gradient. Compiled."""

from __future__ import annotations

import math

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit

# Below this det(J J^T), relative to the cube of the mean of its diagonal, mu is rounding noise.
_SINGULAR = 1e-14


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
def adjugate(
    a: float, b: float, c: float, d: float, e: float, f: float
) -> tuple[float, float, float, float, float, float, float]:
    """Compute the determinant of [[a, b, c], [b, d, e], [c, e, f]], and the adjugate, its inverse times that, alike."""
    i, j, k = d * f - e * e, c * e - b * f, b * e - c * d
    return a * i + b * j + c * k, i, j, k, a * f - c * c, b * c - a * e, a * d - b * b


@njit(cache=True)
def yoshikawa(jacobian: Array) -> float:
    """Compute mu = sqrt(det(J J^T)) alone, to the bit that of `manipulability`."""
    a, b, c, d, e, f = gram(jacobian)
    return math.sqrt(max(adjugate(a, b, c, d, e, f)[0], 0.0))


@njit(cache=True)
def manipulability(axes: Array, jacobian: Array, grad: Array) -> float:
    """Compute mu = sqrt(det(J J^T)) (Yoshikawa), and its gradient (n,) into `grad`.

    dmu/dq_k = mu trace(dJ/dq_k pinv(J)), with the dJ_j/dq_k of `drift` and rows P_j = (J J^T)^-1 J_j of the
    pseudo-inverse: dmu/dq_k = mu (ang_k . sum_{j>=k} J_j x P_j + J_k . sum_{j<k} P_j x ang_j).
    At a singularity mu has a kink and no gradient: zero is returned there, never NaN.
    """
    n = axes.shape[0]
    a, b, c, d, e, f = gram(jacobian)
    det, i00, i01, i02, i11, i12, i22 = adjugate(a, b, c, d, e, f)
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
    """Compute mu_s = sqrt(pdet(C)) [m^2] of the shaft once the tip is held, and its gradient (n,) into `grad`.

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
    room = np.zeros((5, 3, 3))
    mixed, rest, inverse, K, C = room[0], room[1], room[2], room[3], room[4]
    for j in range(n):
        for a in range(3):
            for b in range(3):
                mixed[a, b] += W[a, j] * T[b, j]
                rest[a, b] += W[a, j] * W[b, j]
    xx, xy, xz, yy, yz, zz = gram(T)
    mean = (xx + yy + zz) / 3.0
    if _invert(xx, xy, xz, yy, yz, zz, inverse) <= _SINGULAR * mean * mean * mean:
        return 0.0
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
    _invert(C[0, 0], C[0, 1], C[0, 2], C[1, 1], C[1, 2], C[2, 2], inverse)
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
def _invert(a: float, b: float, c: float, d: float, e: float, f: float, out: Array) -> float:
    """Write the inverse (3,3) of [[a, b, c], [b, d, e], [c, e, f]], zeros if it has none; returns the determinant."""
    det, i, j, k, m, o, p = adjugate(a, b, c, d, e, f)
    scale = 1.0 / det if det != 0.0 else 0.0
    out[0, 0], out[1, 1], out[2, 2] = i * scale, m * scale, p * scale
    out[0, 1] = out[1, 0] = j * scale
    out[0, 2] = out[2, 0] = k * scale
    out[1, 2] = out[2, 1] = o * scale
    return det
