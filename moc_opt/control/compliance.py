"""Level 1, the tip: Cartesian compliance on top of the arm's own dynamics.

F_T = K_X (X_d - X) + D_X (dX_d - J_T v),   tau_tip = h + J_T^T F_T
(Su et al. 2019, the paper's Cartesian compliance law.)
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from moc_opt.control.dense import cholesky, solve_factored

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def compliance_force(K: float, D: float, x_d: Array, dx_d: Array, x: Array, dx: Array) -> Array:
    """Spring and damper between a point and its reference, (3,) [N]; also the law of level 2."""
    return K * (x_d - x) + D * (dx_d - dx)


@njit(cache=True, nogil=True)
def task_inertia(J: Array, M_factor: Array) -> tuple[Array, Array]:
    """W = M^-1 J^T (n, m) and the factor of Lambda^-1 = J M^-1 J^T (m, m).

    Lambda is the inertia felt at the task (Khatib 1987, eq. 51).
    """
    m, n = J.shape
    W = np.empty((n, m))
    for i in range(m):
        W[:, i] = solve_factored(M_factor, J[i])
    mobility = np.empty((m, m))
    for i in range(m):
        for j in range(m):
            s = 0.0
            for k in range(n):
                s += J[i, k] * W[k, j]
            mobility[i, j] = s
    return W, cholesky(mobility)
