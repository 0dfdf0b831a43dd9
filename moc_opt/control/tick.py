"""The equations of one tick put together: state record in, torque out, no Python in between."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from moc_opt.control.feedforward import desired_wrist_acceleration, motion_feedforward
from moc_opt.control.null_space import (
    consistent_wrist_velocity,
    follow_null_space,
    self_motion_torque,
    velocity_damper,
)
from moc_opt.control.rcm import (
    desired_wrist,
    project_as_published,
    project_dynamic,
    project_static,
    published_share,
)
from moc_opt.control.tip_impedance import compliance_force, task_inertia
from moc_opt.model.kinematics_kernels import StateViews, state_views
from moc_opt.numerics.compiled import borrowed
from moc_opt.numerics.dense import cholesky, times, transpose_times
from moc_opt.qp.equalities import offsets

Array = NDArray[np.float64]

DYNAMIC, STATIC, AS_PUBLISHED = 0, 1, 2


@njit(cache=True, nogil=True)
def tracking_torque(
    record: Array,
    n: int,
    tip_ref: Array,
    trocar: Array,
    gains: Array,
    projector: int,
    feedforward: bool,
    rcm_lambda: float = 0.0,
) -> Array:
    """Levels 1 and 2: tau_tip + tau_rcm, (n,) [Nm].

    Args:
        record: flat state record.
        tip_ref: (3, 3) rows X_d, dX_d, ddX_d.
        trocar: (2, 3) rows P_t, dP_t.
        gains: K_X, D_X, K_N, D_N, ...
        projector: DYNAMIC, STATIC or AS_PUBLISHED.
        feedforward: add the accelerations of tip and desired wrist.
        rcm_lambda: constant lambda of the paper's |e_N1| = d / lambda; 0 takes |N_d - N| itself.
    """
    return _tracking(state_views(record, n), tip_ref, trocar, gains, projector, feedforward, rcm_lambda)


@njit(cache=True, nogil=True)
def _tracking(
    s: StateViews,
    tip_ref: Array,
    trocar: Array,
    gains: Array,
    projector: int,
    feedforward: bool,
    rcm_lambda: float,
) -> Array:
    J_tip, J_wrist = s.A[:3], s.A[3:]
    tip_velocity, wrist_velocity = times(J_tip, s.v), times(J_wrist, s.v)
    M_factor = cholesky(s.M)
    W, mobility = task_inertia(J_tip, M_factor)

    force = compliance_force(gains[0], gains[1], tip_ref[0], tip_ref[1], s.tip, tip_velocity)
    tau: Array = s.h + transpose_times(J_tip, force)
    if feedforward:
        bend = desired_wrist_acceleration(s.tip, tip_velocity, tip_ref[2], trocar[0], trocar[1], s.scalars[1])
        tau += motion_feedforward(s.A, s.u, M_factor, s.drift, tip_ref[2], bend)

    wish, wish_velocity = desired_wrist(s.tip, tip_velocity, trocar[0], trocar[1], s.scalars[1])
    if rcm_lambda > 0.0:
        share = published_share(s.tip, s.wrist, trocar[0], s.scalars[1], rcm_lambda)
        for i in range(3):
            wish[i] = s.wrist[i] + share * (wish[i] - s.wrist[i])
    turn = compliance_force(gains[2], gains[3], wish, wish_velocity, s.wrist, wrist_velocity)
    tau_wrist = transpose_times(J_wrist, turn)
    if projector == DYNAMIC:
        tau += project_dynamic(J_tip, W, mobility, tau_wrist)
    elif projector == STATIC:
        tau += project_static(J_tip, tau_wrist)
    else:
        tau += project_as_published(J_tip, tau_wrist)
    return tau


@njit(cache=True, nogil=True)
def fill_subproblem(
    record: Array, n: int, tip_ref: Array, trocar: Array, limits: Array, weights: Array, k0: float, row: Array
) -> None:
    """Write this tick's NullSpaceQP record (10 n + 10,).

    v_T = dX_d, and v_W is the velocity of the desired wrist for that tip velocity, made
    consistent with the rigid tool. ``limits`` (3, n) rows q_min, q_max, v_max.
    """
    _fill(state_views(record, n), tip_ref, trocar, limits, weights, k0, row)


@njit(cache=True, nogil=True)
def _fill(s: StateViews, tip_ref: Array, trocar: Array, limits: Array, weights: Array, k0: float, row: Array) -> None:
    n = s.q.shape[0]
    at = offsets(n)
    for i in range(6):
        for j in range(n):
            row[i * n + j] = s.A[i, j]
    v_tip = tip_ref[1]
    _, v_wrist = desired_wrist(s.tip, v_tip, trocar[0], trocar[1], s.scalars[1])
    consistent = consistent_wrist_velocity(v_tip, v_wrist, s.u)
    for i in range(3):
        row[at.b + i], row[at.b + 3 + i] = v_tip[i], consistent[i]
    for i in range(n):
        row[at.grad_mu + i], row[at.q + i] = s.grad_mu[i], s.q[i]
    for i in range(4):
        row[at.weights + i] = weights[i]
    velocity_damper(
        s.q,
        limits[0],
        limits[1],
        limits[2],
        k0,
        row[at.lower : at.upper],
        row[at.upper : at.weights],
    )


@njit(cache=True, nogil=True)
def third_level(record: Array, n: int, Z: Array, x: Array, gain: Array, damping: Array, share: float) -> Array:
    """tau_mu = share M Z^T (Z M Z^T)^-1 Z (gain * (x - v) - damping * v), (n,) [Nm].

    gain and damping (n,) multiply joint by joint, before the projection.
    """
    s = state_views(record, n)
    push = np.empty(n)
    for i in range(n):
        push[i] = share * (gain[i] * (x[i] - s.v[i]) - damping[i] * s.v[i])
    torque: Array = self_motion_torque(s.M, Z, push)
    return torque


@njit(cache=True, nogil=True)
def before_solver(
    record: Array,
    n: int,
    tip_ref: Array,
    trocar: Array,
    gains: Array,
    projector: int,
    feedforward: bool,
    rcm_lambda: float,
    limits: Array,
    weights: Array,
    k0: float,
    Z: Array,
    tau: Array,
    row: Array,
) -> bool:
    """All that a tick can do before its solver is asked, in one call: levels 1 and 2, subproblem, null space.

    Args are those of ``tracking_torque`` and ``fill_subproblem``; tau (n,) and row (10 n + 10,) are written,
    Z (r, n) follows. Returns False where Z could not follow.
    """
    s, Z, tau, row = state_views(borrowed(record), n), borrowed(Z), borrowed(tau), borrowed(row)
    tip_ref, trocar, gains = borrowed(tip_ref), borrowed(trocar), borrowed(gains)
    limits, weights = borrowed(limits), borrowed(weights)
    found = _tracking(s, tip_ref, trocar, gains, projector, feedforward, rcm_lambda)
    for i in range(n):
        tau[i] = found[i]
    _fill(s, tip_ref, trocar, limits, weights, k0, row)
    return follow_null_space(s.A, s.u, Z)


@njit(cache=True, nogil=True)
def after_solver(
    record: Array,
    n: int,
    Z: Array,
    x: Array,
    gain: Array,
    damping: Array,
    share: float,
    disturbance: Array,
    tau_max: Array,
    tau: Array,
) -> None:
    """Add the third level's share to tau (n,), take the observer's disturbance (n,) out, and cut at tau_max (n,)."""
    record, Z, x, tau = borrowed(record), borrowed(Z), borrowed(x), borrowed(tau)
    gain, damping, disturbance, tau_max = borrowed(gain), borrowed(damping), borrowed(disturbance), borrowed(tau_max)
    third = third_level(record, n, Z, x, gain, damping, share)
    for i in range(n):
        tau[i] = tau[i] + third[i] - disturbance[i]
        if tau[i] > tau_max[i]:  # a NaN passes: the plant refuses it by name
            tau[i] = tau_max[i]
        elif tau[i] < -tau_max[i]:
            tau[i] = -tau_max[i]
