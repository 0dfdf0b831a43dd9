"""Kinematics and dynamics of a serial arm as CasADi SX expressions, in link frames.

Recursive Newton-Euler for h, composite rigid bodies for M and gravity, and momenta for the observer
(Featherstone 2008, chapters 5 and 6, written with 3-vectors). Numbers that are zero or one drop out while
the expressions are built, so that the result is close to a hand-simplified model of this arm.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from moc_opt.embedded.arm import Arm
from moc_opt.numerics.arrays import Array

SX = Any

_SINGULAR = 1e-14  # det(J J^T) relative to the cube of its mean diagonal, as in kinematics_kernels.manipulability


class Frame(NamedTuple):
    """Joint frame j seen from joint frame j - 1, displaced by q_j."""

    R: SX
    """(3,3)"""
    p: SX
    """(3,) [m]"""


class Points(NamedTuple):
    """The terms of the tool in the control laws, in world axes."""

    tip: SX
    """(3,) [m]"""
    wrist: SX
    """(3,) [m]"""
    R: SX
    """(3,3) orientation of the last joint's frame"""
    axes: SX
    """(3,n) angular velocity for unit joint velocity"""
    J_tip: SX
    """(3,n)"""
    J_wrist: SX
    """(3,n)"""


def joint_frames(arm: Arm, q: SX) -> list[Frame]:
    """Compute the displaced joint frames, base first."""
    frames = []
    for j in range(arm.n):
        placement, axis = ca.SX(arm.rotations[j]), ca.SX(arm.axes[j])
        R, p = placement, ca.SX(arm.origins[j])
        if arm.prismatic[j]:
            p = p + placement @ axis * q[j]
        else:
            R = placement @ _rotation_about(arm.axes[j], q[j])
        frames.append(Frame(R, p))
    return frames


def points(arm: Arm, frames: list[Frame]) -> Points:
    """Compute tip, wrist and their Jacobians: J_j = axis_j x (point - origin_j), or axis_j where the joint slides."""
    R, p = ca.SX.eye(3), ca.SX.zeros(3)
    axes, origins = [], []
    for j, frame in enumerate(frames):
        p = p + R @ frame.p
        R = R @ frame.R
        axes.append(R @ ca.SX(arm.axes[j]))
        origins.append(p)
    tip, wrist = (p + R @ ca.SX(offset) for offset in arm.offsets)
    jacobians = []
    for point, moves in ((tip, arm.moves[0]), (wrist, arm.moves[1])):
        columns = [ca.SX.zeros(3)] * arm.n
        for j in np.flatnonzero(moves).tolist():
            columns[j] = axes[j] if arm.prismatic[j] else ca.cross(axes[j], point - origins[j])
        jacobians.append(ca.horzcat(*columns))
    turning = [ca.SX.zeros(3) if slides else axis for axis, slides in zip(axes, arm.prismatic, strict=True)]
    return Points(tip, wrist, R, ca.horzcat(*turning), *jacobians)


def manipulability(at: Points) -> tuple[SX, SX]:
    """Compute mu = sqrt(det(J J^T)) and its gradient (n,), the sums of `manipulability_kernels.manipulability`.

    dmu/dq_k = mu (ang_k . sum_{j>=k} J_j x P_j + J_k . sum_{j<k} P_j x ang_j), P_j = (J J^T)^-1 J_j; zero
    where J J^T is singular.
    """
    J, n = at.J_tip, at.J_tip.shape[1]
    S = J @ J.T
    det, adjugate = _adjugate(S)
    mean = ca.trace(S) / 3
    regular = det > _SINGULAR * mean**3
    mu = ca.sqrt(ca.fmax(det, 0))
    P = adjugate @ J  # det times the rows of the pseudo-inverse
    behind, ahead = [ca.SX.zeros(3)], [ca.SX.zeros(3)]
    for k in range(n):
        behind.append(behind[-1] + ca.cross(P[:, k], at.axes[:, k]))
        ahead.append(ahead[-1] + ca.cross(J[:, n - 1 - k], P[:, n - 1 - k]))
    grad = [at.axes[:, k].T @ ahead[n - k] + J[:, k].T @ behind[k] for k in range(n)]
    inverse = ca.if_else(regular, 1 / ca.if_else(regular, mu, 1), 0)
    return mu, ca.vertcat(*grad) * inverse


def shaft_manipulability(at: Points) -> tuple[SX, SX]:
    """Compute mu_shaft and its gradient (n,), the sums of `manipulability_kernels.shaft_manipulability`."""
    T, W, n = at.J_tip, at.J_wrist, at.J_tip.shape[1]
    u = (at.tip - at.wrist) / ca.norm_2(at.tip - at.wrist)
    S = T @ T.T
    det, adjugate = _adjugate(S)
    held = det > _SINGULAR * (ca.trace(S) / 3) ** 3
    K = W @ T.T @ adjugate / ca.if_else(held, det, 1)
    C = W @ W.T - K @ T @ W.T
    minors = sum(C[a, a] * C[b, b] - C[a, b] * C[b, a] for a, b in ((0, 1), (1, 2), (2, 0)))
    regular = ca.logic_and(held, minors > _SINGULAR * ca.trace(C) ** 2)
    mu = ca.if_else(held, ca.sqrt(ca.fmax(minors, 0)), 0)
    det, adjugate = _adjugate(C + 0.5 * ca.trace(C) * u @ u.T)
    Q = adjugate @ (W - K @ T) / ca.if_else(regular, det, 1)
    grad = ca.SX.zeros(n)
    for J, P in ((W, Q), (T, -K.T @ Q)):
        turn, pull = ca.SX.zeros(3), ca.SX.zeros(3)
        for k in range(n):
            grad[k] += ca.dot(J[:, k], pull) - ca.dot(at.axes[:, k], turn)
            pull += ca.cross(P[:, k], at.axes[:, k])
            turn += ca.cross(J[:, k], P[:, k])
    return mu, ca.if_else(regular, mu * grad, 0)


def _adjugate(S: SX) -> tuple[SX, SX]:
    """Compute the determinant of a symmetric (3, 3), and its adjugate: the determinant times the inverse."""
    rows = [S[:, 1], S[:, 2], S[:, 0]]
    adjugate = ca.horzcat(*(ca.cross(rows[i], rows[(i + 1) % 3]) for i in range(3)))
    det = S[:, 0].T @ adjugate[:, 0]
    return det, adjugate


def bias_torque(arm: Arm, frames: list[Frame], v: SX) -> SX:
    """Compute h = C v + g (n,) [Nm] by recursive Newton-Euler at zero joint acceleration."""
    w, dw, a = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX(-arm.gravity)
    forces, moments = [], []
    for j, (R, p) in enumerate(frames):
        rate = ca.SX(arm.axes[j]) * v[j]
        a = R.T @ (a + ca.cross(dw, p) + ca.cross(w, ca.cross(w, p)))
        w, dw = R.T @ w, R.T @ dw
        if arm.prismatic[j]:
            a = a + 2 * ca.cross(w, rate)
        else:
            dw, w = dw + ca.cross(w, rate), w + rate
        m, mc, inertia = arm.mass[j], ca.SX(arm.first_moment[j]), ca.SX(arm.inertia[j])
        forces.append(m * a + ca.cross(dw, mc) + ca.cross(w, ca.cross(w, mc)))
        moments.append(inertia @ dw + ca.cross(w, inertia @ w) + ca.cross(mc, a))
    return ca.vertcat(
        *(_along(arm, j, force, moment) for j, (force, moment) in enumerate(_summed(frames, forces, moments)))
    )


def inertia_and_gravity(arm: Arm, frames: list[Frame]) -> tuple[SX, SX]:
    """Compute M (n,n) with rotor inertia, and gravity torque g (n,) [Nm], from the bodies beyond each joint."""
    n = arm.n
    down = [frames[0].R.T @ ca.SX(arm.gravity)]
    for R, _ in frames[1:]:
        down.append(R.T @ down[-1])
    M, g = ca.SX.zeros(n, n), ca.SX.zeros(n)
    m, mc, inertia = 0.0, ca.SX.zeros(3), ca.SX.zeros(3, 3)
    for j in reversed(range(n)):
        m, mc, inertia = m + arm.mass[j], mc + ca.SX(arm.first_moment[j]), inertia + ca.SX(arm.inertia[j])
        axis = ca.SX(arm.axes[j])
        # Force and moment that give the composite body unit acceleration along or about the joint.
        force, moment = (m * axis, ca.cross(mc, axis)) if arm.prismatic[j] else (
            ca.cross(axis, mc), inertia @ axis)  # fmt: skip
        g[j] = -(m * axis.T @ down[j] if arm.prismatic[j] else ca.dot(axis, ca.cross(mc, down[j])))
        M[j, j] = _along(arm, j, force, moment) + arm.rotor_inertia[j]
        for i in reversed(range(j)):
            R, p = frames[i + 1]
            force = R @ force
            moment = R @ moment + ca.cross(p, force)
            M[i, j] = M[j, i] = _along(arm, i, force, moment)
        R, p = frames[j]
        arm_of_p, mc = ca.skew(p), R @ mc
        shift = arm_of_p @ ca.skew(mc)
        inertia = R @ inertia @ R.T - shift - shift.T - m * arm_of_p @ arm_of_p
        mc = mc + m * p
    return M, g


def momentum(arm: Arm, frames: list[Frame], v: SX) -> tuple[SX, SX]:
    """Compute p = M v (n,) [Nm s] and dT/dq (n,) [Nm], the gradient of the kinetic energy at fixed v.

    dT/dq = C^T v, so that De Luca's observer needs no Coriolis matrix: C^T v - g = d(T - U)/dq. With the
    momentum (P, H) of everything beyond joint k and the velocity (a, w) of its frame, turning joint k
    changes T by (P, H) . ((a, w) x axis_k), x being the spatial cross product.
    """
    w, a = ca.SX.zeros(3), ca.SX.zeros(3)
    turning, linear, angular = [], [], []
    for j, (R, p) in enumerate(frames):
        a, w = R.T @ (a + ca.cross(w, p)), R.T @ w
        rate = ca.SX(arm.axes[j]) * v[j]
        a, w = (a + rate, w) if arm.prismatic[j] else (a, w + rate)
        mc = ca.SX(arm.first_moment[j])
        turning.append((a, w))
        linear.append(arm.mass[j] * a + ca.cross(w, mc))
        angular.append(ca.SX(arm.inertia[j]) @ w + ca.cross(mc, a))
    p, gradient = [], []
    for j, (P, H) in enumerate(_summed(frames, linear, angular)):
        axis, (a, w) = ca.SX(arm.axes[j]), turning[j]
        p.append(_along(arm, j, P, H) + arm.rotor_inertia[j] * v[j])
        if arm.prismatic[j]:
            gradient.append(ca.dot(P, ca.cross(w, axis)))
        else:
            gradient.append(ca.dot(H, ca.cross(w, axis)) + ca.dot(P, ca.cross(a, axis)))
    return ca.vertcat(*p), ca.vertcat(*gradient)


def drift(at: Points, J: SX, v: SX) -> SX:
    """Compute dJ v (3,) [m/s^2]: sum_m (2 sum_{k<m} w_k + w_m) x J_m v_m with w_k = ang_k v_k."""
    total, before = ca.SX.zeros(3), ca.SX.zeros(3)
    for m in range(J.shape[1]):
        w = at.axes[:, m] * v[m]
        total = total + ca.cross(2 * before + w, J[:, m] * v[m])
        before = before + w
    return total


def _summed(frames: list[Frame], linear: list[SX], angular: list[SX]) -> list[tuple[SX, SX]]:
    """Return force-like pairs of the bodies, each summed with all beyond it, in its own joint's frame."""
    n = len(frames)
    sums = [(linear[n - 1], angular[n - 1])]
    for j in reversed(range(n - 1)):
        R, p = frames[j + 1]
        carried = R @ sums[-1][0]
        sums.append((linear[j] + carried, angular[j] + R @ sums[-1][1] + ca.cross(p, carried)))
    return sums[::-1]


def _along(arm: Arm, j: int, force: SX, moment: SX) -> SX:
    """Return what joint j feels of a force and a moment in its own frame."""
    return ca.dot(ca.SX(arm.axes[j]), force if arm.prismatic[j] else moment)


def _rotation_about(axis: Array, angle: SX) -> SX:
    """Compute Rodrigues' formula c I + s [a]x + (1 - c) a a^T, exact ones and zeros for a coordinate axis."""
    c, s = ca.cos(angle), ca.sin(angle)
    outer = np.outer(axis, axis)
    return ca.SX(outer) + c * ca.SX(np.eye(3) - outer) + s * ca.skew(ca.SX(axis))
