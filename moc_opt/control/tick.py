"""The equations of one tick before and after the solver, compiled.

X, N are tip and wrist, P_t the trocar; docs/method.md has the same equations in the same order.
"""

from __future__ import annotations

import numpy as np

from moc_opt.control.feedforward import desired_wrist_acceleration, motion_feedforward
from moc_opt.control.law import DYNAMIC, STATIC, law_views
from moc_opt.control.null_space import (
    consistent_wrist_velocity,
    follow_null_space,
    self_motion_torque,
    velocity_damper,
)
from moc_opt.control.rcm import project_as_published, project_dynamic, project_static, published_share
from moc_opt.control.tip_impedance import compliance_force, task_inertia
from moc_opt.model.kinematics_kernels import state_views
from moc_opt.model.shaft_kernels import desired_wrist
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import borrowed
from moc_opt.numerics.dense import cholesky, times, transpose_times
from moc_opt.qp.equalities import joints_of, offsets

SHAFT_PULL = 0.1
"""Weight of log mu_shaft beside mu [m^3]; it fades out towards ``shaft_margin``."""
SHAFT_LOST = 0.1
"""Share of ``shaft_margin`` below which the push fades out again: at mu_shaft = 0 it has no direction."""
BOX_OPENS = 3.0
"""Inverse of the share of ``shaft_margin`` over which the box opens to the joints' whole speed."""


@njit(cache=True, nogil=True)
def tracking_torque(record: Array, law: Array, tip_ref: Array, trocar: Array, disturbance: Array) -> Array:
    """Compute levels 1 and 2 less the disturbance r: tau_tip + tau_rcm - r, (n,) [Nm].

    Args:
        law: packed constants, see ``law.Law``.
        tip_ref: (3, 3) rows X_d, dX_d, ddX_d.
        trocar: (2, 3) rows P_t, dP_t.
        disturbance: (n,) the observer's estimate r of the external torque [Nm].
    """
    n = disturbance.shape[0]
    s, c = state_views(borrowed(record), n), law_views(borrowed(law), n)
    tip_ref, trocar, disturbance = borrowed(tip_ref), borrowed(trocar), borrowed(disturbance)
    J_T, J_W, L = s.A[:3], s.A[3:], s.scalars[1]
    dX, dN = times(J_T, s.v), times(J_W, s.v)
    M_factor = cholesky(s.M)
    W, mobility = task_inertia(J_T, M_factor)

    # Tip: tau = h + J_T^T F_T, F_T = K_X (X_d - X) + D_X (dX_d - dX); the paper's compliance law.
    F_T = compliance_force(c.K_X, c.D_X, tip_ref[0], tip_ref[1], s.tip, dX)
    tau: Array = s.h + transpose_times(J_T, F_T)
    if c.feedforward != 0.0:
        ddN_d = desired_wrist_acceleration(s.tip, dX, tip_ref[2], trocar[0], trocar[1], L)
        tau += motion_feedforward(s.A, s.u, M_factor, s.drift, tip_ref[2], ddN_d)

    # RCM: N_d = X + L e, F_W = K_N (N_d - N) + D_N (dN_d - dN), tau += (I - J_T^T Jbar_T^T) J_W^T F_W.
    N_d, dN_d = desired_wrist(s.tip, dX, trocar[0], trocar[1], L)
    if c.rcm_lambda > 0.0:
        share = published_share(s.tip, s.wrist, trocar[0], L, c.rcm_lambda)
        for i in range(3):
            N_d[i] = s.wrist[i] + share * (N_d[i] - s.wrist[i])
    tau_W = transpose_times(J_W, compliance_force(c.K_N, c.D_N, N_d, dN_d, s.wrist, dN))
    if c.projector == DYNAMIC:
        tau += project_dynamic(J_T, W, mobility, tau_W)
    elif c.projector == STATIC:
        tau += project_static(J_T, tau_W)
    else:
        tau += project_as_published(J_T, tau_W)
    for i in range(n):
        tau[i] -= disturbance[i]
    return tau


@njit(cache=True, nogil=True)
def shaft_push(mu_shaft: float, margin: float) -> float:
    """Weight of grad mu_shaft beside grad mu [m], zero from the margin on.

    SHAFT_PULL (1 - mu_shaft/margin) mu_shaft/(mu_shaft^2 + lost^2), lost = SHAFT_LOST margin: the slope of a barrier
    that begins smoothly at the margin. Times grad mu_shaft it has no kink where mu_shaft is zero.
    """
    if mu_shaft < margin:
        lost = SHAFT_LOST * margin
        return SHAFT_PULL * (1.0 - mu_shaft / margin) * mu_shaft / (mu_shaft * mu_shaft + lost * lost)
    return 0.0


@njit(cache=True, nogil=True)
def fill_subproblem(record: Array, law: Array, tip_ref: Array, trocar: Array, row: Array) -> None:
    """Write this tick's NullSpaceQP record (10 n + 10,); arguments as for ``tracking_torque``.

    J_T x = v_T = dX_d and J_W x = v_W, where v_W is dN_d for a tip that moves at v_T, with u^T (v_T - v_W) = 0;
    lower, upper: the velocity damper; c0, c1, c2, rho and grad mu: the cost. Near a pose in which tip and shaft lose a
    direction the joints have to turn fast. There ``shaft_push`` times grad mu_shaft is added to grad mu, and the box
    opens from its share of v_max towards all of it.
    """
    n = joints_of(row.shape[0])
    s, c = state_views(borrowed(record), n), law_views(borrowed(law), n)
    at = offsets(n)
    for i in range(6):
        for j in range(n):
            row[i * n + j] = s.A[i, j]
    v_T = tip_ref[1]
    _, dN_d = desired_wrist(s.tip, v_T, trocar[0], trocar[1], s.scalars[1])
    v_W = consistent_wrist_velocity(v_T, dN_d, s.u)
    for i in range(3):
        row[at.b + i], row[at.b + 3 + i] = v_T[i], v_W[i]
    push, limits = shaft_push(s.scalars[2], c.shaft_margin), c.limits
    if s.scalars[2] < c.shaft_margin:
        limits, opened = c.limits.copy(), min(1.0, BOX_OPENS * (1.0 - s.scalars[2] / c.shaft_margin))
        for i in range(n):
            limits[2, i] *= 1.0 + c.spare_speed * opened
    for i in range(n):
        row[at.grad_mu + i], row[at.q + i] = s.grad_mu[i] + push * s.grad_mu_shaft[i], s.q[i]
    for i in range(4):
        row[at.weights + i] = c.weights[i]
    velocity_damper(s.q, limits, c.k0, row[at.lower : at.upper], row[at.upper : at.weights])


@njit(cache=True, nogil=True)
def prepare_third_level(record: Array, law: Array, tip_ref: Array, trocar: Array, Z: Array, row: Array) -> bool:
    """Do ``fill_subproblem``, and update the basis Z (r, n) of ker A for this state; False where that fails."""
    record, Z, row = borrowed(record), borrowed(Z), borrowed(row)
    fill_subproblem(record, law, borrowed(tip_ref), borrowed(trocar), row)
    s = state_views(record, Z.shape[1])
    return follow_null_space(s.A, s.u, Z)


@njit(cache=True, nogil=True)
def third_level(record: Array, law: Array, Z: Array, x: Array, share: float) -> Array:
    """Compute tau_mu = share M Z^T (Z M Z^T)^-1 Z (K_N2 (x - v) - D_N2 v), (n,) [Nm].

    K_N2 and D_N2 multiply joint by joint, before the projection.
    """
    n = x.shape[0]
    s, c = state_views(record, n), law_views(law, n)
    push = np.empty(n)
    for i in range(n):
        push[i] = share * (c.K_N2[i] * (x[i] - s.v[i]) - c.D_N2[i] * s.v[i])
    torque: Array = self_motion_torque(s.M, Z, push)
    return torque


@njit(cache=True, nogil=True)
def add_third_level(record: Array, law: Array, Z: Array, x: Array, share: float, tau: Array) -> None:
    """Add ``third_level`` to tau (n,), and cut the sum at tau_max."""
    record, law, Z, x, tau = borrowed(record), borrowed(law), borrowed(Z), borrowed(x), borrowed(tau)
    third = third_level(record, law, Z, x, share)
    tau_max = law_views(law, tau.shape[0]).tau_max
    for i in range(tau.shape[0]):
        tau[i] += third[i]
        if tau[i] > tau_max[i]:  # a NaN passes: the plant refuses it by name
            tau[i] = tau_max[i]
        elif tau[i] < -tau_max[i]:
            tau[i] = -tau_max[i]
