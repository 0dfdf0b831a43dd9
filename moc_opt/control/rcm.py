"""Level 2, the remote centre of motion: turn the shaft about the tip until it passes through the trocar.

The tip X and the trocar P_t determine the desired wrist N_d = X + L e with
e = (P_t - X)/|P_t - X| (`moc_opt.model.shaft_kernels`). A spring pulls the wrist there,
F_W = K_N (N_d - N) + D_N (dN_d - J_W v), projected so that it does not move the tip (Su et al. 2019; the consistent
form of its projector).
For |N_d - N| the paper uses |e_N1| = d / lambda with a constant lambda: ``published_share``.
"""

from __future__ import annotations

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.dense import cholesky, gram, solve_factored, times, transpose_times


@njit(cache=True, nogil=True)
def published_share(tip: Array, wrist: Array, trocar: Array, span: float, rcm_lambda: float) -> float:
    """Return the factor that makes |N_d - N| the paper's |e_N1| = d / lambda with a constant lambda.

    d = |P_t - X| sin(theta) is the RCM error and theta the angle between e and the shaft N - X; |N_d - N| is
    2 L sin(theta/2), hence the true lambda is |P_t - X|/L cos(theta/2). It varies with the tip's depth, and the
    share is that lambda over the constant one.
    """
    square, along = 0.0, 0.0
    for i in range(3):
        e = trocar[i] - tip[i]
        square += e * e
        along += e * (wrist[i] - tip[i])
    distance = np.sqrt(square)
    half = np.sqrt(max(0.0, 0.5 * (1.0 + along / (distance * span))))
    share: float = distance / span * half / rcm_lambda
    return share


@njit(cache=True, nogil=True)
def project_dynamic(J_tip: Array, W: Array, mobility_factor: Array, tau: Array) -> Array:
    """Compute (I - J_T^T Jbar_T^T) tau with Jbar_T = M^-1 J_T^T Lambda_T: no acceleration of the tip."""
    free: Array = tau - transpose_times(J_tip, solve_factored(mobility_factor, transpose_times(W, tau)))
    return free


@njit(cache=True, nogil=True)
def project_static(J_tip: Array, tau: Array) -> Array:
    """Compute (I - J_T^T pinv(J_T)^T) tau: no force at the tip in rest; idempotent, but not dynamic."""
    free: Array = tau - transpose_times(J_tip, solve_factored(cholesky(gram(J_tip)), times(J_tip, tau)))
    return free


@njit(cache=True, nogil=True)
def project_as_published(J_tip: Array, tau: Array) -> Array:
    """Compute (I - J_T^T J_T) tau as the paper prints it: not idempotent, and its units do not fit."""
    free: Array = tau - transpose_times(J_tip, times(J_tip, tau))
    return free
