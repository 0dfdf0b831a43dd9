"""Level 3, manipulability: the box of the subproblem, and the torque computed from its answer.

Box: lower = max(-vmax, -k0 (q - q_min)), upper = min(vmax, -k0 (q - q_max)), the velocity damper.
Torque: tau_mu = M Z^T (Z M Z^T)^-1 Z (K_N2 (x* - v) - D_N2 v), with Z the rows of an orthonormal
basis of ker A: it moves neither tip nor wrist, A M^-1 tau_mu = 0 (the consistent form of
[(Z M Z^T) Z M]^T, as printed by Su et al. 2019).
"""

from __future__ import annotations

import numpy as np

from moc_opt.control.feedforward import independent_rows
from moc_opt.errors import ControlError
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.dense import cholesky, dot, gram, solve_factored, solve_in_place, times, transpose_times
from moc_opt.qp.residuals import ranks


@njit(cache=True, nogil=True)
def velocity_damper(q: Array, limits: Array, k0: float, lower: Array, upper: Array) -> None:
    """Write the box on x [rad/s] for limits (3, n) rows q_min, q_max, v_max: it closes at k0 [1/s] and never crosses.

    Beyond a limit the box contains only velocities back inside, at most v_max.
    """
    for i in range(q.shape[0]):
        q_min, q_max, v_max = limits[0, i], limits[1, i], limits[2, i]
        lower[i] = min(max(-v_max, -k0 * (q[i] - q_min)), v_max)
        upper[i] = max(min(v_max, -k0 * (q[i] - q_max)), -v_max)


def box_limits(
    q_min: Array, q_max: Array, v_max: Array, *, margin: float | Array = 0.0, speed_fraction: float = 1.0
) -> Array:
    """Return the limits of the box on x: (3, n) rows q_min + margin, q_max - margin, speed_fraction v_max.

    The box has to close before the wall of the safety filter acts on the joint.

    Args:
        q_min, q_max: (n,) joint limits [rad].
        v_max: (n,) [rad/s].
        margin: distance kept from either joint limit, one number or (n,) [rad, m].
        speed_fraction: of v_max.

    Raises:
        ControlError: the margins of a joint meet.
    """
    left = 0.5 * (q_max - q_min) - margin
    j = int(np.argmin(left))
    if not left[j] > 0.0:
        raise ControlError(
            f"[control] limit_margin_rad = {float(np.broadcast_to(margin, left.shape)[j])}: nothing is left of joint "
            f"{j + 1} between its limits; give less than {0.5 * (q_max - q_min)[j]:.3g} (limit_margin_m, if it slides)"
        )
    return np.ascontiguousarray([q_min + margin, q_max - margin, speed_fraction * v_max])


@njit(cache=True, nogil=True)
def consistent_wrist_velocity(v_tip: Array, v_wrist: Array, u: Array) -> Array:
    """Return v_W with u^T (v_T - v_W) = 0: a rigid tool cannot change its length."""
    gap = dot(u, v_tip) - dot(u, v_wrist)
    consistent = np.empty(3)
    for i in range(3):
        consistent[i] = v_wrist[i] + gap * u[i]
    return consistent


@njit(cache=True, nogil=True)
def follow_null_space(A: Array, u: Array, Z: Array) -> bool:
    """Update the basis Z (r, n) of ker A from the last tick's, in place; False where that fails.

    Its rows are projected on the new kernel and made orthonormal again. So Z turns no further
    than the kernel does, whatever sign a fresh decomposition would have chosen. The dependent
    wrist row along u is left out. False near a singularity: start again from a decomposition.
    """
    r, n = Z.shape
    A5, _ = independent_rows(A, u)
    S = gram(A5)
    factor = cholesky(S)
    for i in range(5):  # also catches NaN
        if not factor[i, i] * factor[i, i] > 1e-9 * S[i, i]:
            return False
    off = np.empty(5)
    for i in range(r):
        for _ in range(2):  # twice is enough for orthogonality to rounding
            for k in range(5):
                off[k] = dot(A5[k], Z[i])
            solve_in_place(factor, off)
            for j in range(n):
                for k in range(5):
                    Z[i, j] -= A5[k, j] * off[k]
            for k in range(i):
                along = dot(Z[k], Z[i])
                for j in range(n):
                    Z[i, j] -= along * Z[k, j]
            length = np.sqrt(dot(Z[i], Z[i]))
            if not length > 0.5:
                return False
            for j in range(n):
                Z[i, j] /= length
    return True


def null_space(A: Array, like: Array | None = None) -> Array:
    """Compute orthonormal rows (r, n) of ker A by SVD, turned closest to ``like`` (orthogonal Procrustes)."""
    _, s, vh = np.linalg.svd(A)
    Z = vh[int(ranks(s)) :]
    if like is not None and like.shape == Z.shape:
        left, _, right = np.linalg.svd(like @ Z.T)
        Z = left @ right @ Z
    return np.ascontiguousarray(Z)


@njit(cache=True, nogil=True)
def self_motion_torque(M: Array, Z: Array, push: Array) -> Array:
    """Compute M Z^T (Z M Z^T)^-1 Z push, (n,) [Nm]."""
    r, n = Z.shape
    MZ, inertia = np.empty((r, n)), np.empty((r, r))
    for i in range(r):
        for j in range(n):
            MZ[i, j] = dot(M[j], Z[i])
    for i in range(r):
        for j in range(r):
            inertia[i, j] = dot(Z[i], MZ[j])
    torque: Array = transpose_times(MZ, solve_factored(cholesky(inertia), times(Z, push)))
    return torque


@njit(cache=True, nogil=True)
def into_the_box(A: Array, b: Array, Z: Array, lower: Array, upper: Array, sweeps: int) -> Array:
    """Find the smallest self-motion (n,) [rad/s] that brings the arm's other motion into the box; zero if none does.

    With a damped self-motion the arm follows its references with the shortest x of A x = b, which may move a joint
    to its limit. The shortest self-motion Z^T w that brings x + Z^T w into the box is found by Hildreth's dual
    coordinate ascent, one constraint a joint. It is zero if x is in the box already.

    Args:
        A: (6, n); b: (6,).
        Z: (r, n) orthonormal rows of ker A.
        lower, upper: (n,) [rad/s].
        sweeps: over the joints; one freedom needs two.
    """
    r, n = Z.shape
    S = np.zeros((n, n))  # A^T A + Z^T Z: regular, and the shortest solution of A x = b is S^-1 A^T b
    size = np.zeros(n)
    for i in range(n):
        for k in range(r):
            size[i] += Z[k, i] * Z[k, i]
        for j in range(n):
            for k in range(A.shape[0]):
                S[i, j] += A[k, i] * A[k, j]
            for k in range(r):
                S[i, j] += Z[k, i] * Z[k, j]
    shortest = solve_factored(cholesky(S), transpose_times(A, b))
    w, push = np.zeros(r), np.zeros(n)
    for _ in range(sweeps):
        change = 0.0
        for j in range(n):
            if size[j] > 1e-12:
                free = shortest[j] - size[j] * push[j]
                for k in range(r):
                    free += Z[k, j] * w[k]
                new = (min(max(free, lower[j]), upper[j]) - free) / size[j]
                for k in range(r):
                    w[k] += (new - push[j]) * Z[k, j]
                change = max(change, abs(new - push[j]))
                push[j] = new
        if change < 1e-12:
            break
    motion = transpose_times(Z, w)
    for j in range(n):
        x = shortest[j] + motion[j]
        if not lower[j] - 1e-6 <= x <= upper[j] + 1e-6:  # the box is empty, or A has lost more than a rank
            return np.zeros(n)
    return motion


@njit(cache=True, nogil=True)
def least_violation(A: Array, b: Array, lower: Array, upper: Array, sweeps: int) -> Array:
    """Minimize |A x - b|^2 over the box by coordinate descent: the fallback of the same name."""
    n = A.shape[1]
    x = np.empty(n)
    for j in range(n):
        x[j] = min(max(0.0, lower[j]), upper[j])
    residual = times(A, x) - b
    for _ in range(sweeps):
        for j in range(n):
            size = dot(A[:, j], A[:, j])
            if size > 1e-12:
                best = min(max(x[j] - dot(A[:, j], residual) / size, lower[j]), upper[j])
                residual += (best - x[j]) * A[:, j]
                x[j] = best
    return x
