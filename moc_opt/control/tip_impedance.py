"""Level 1, the tip: Cartesian compliance on top of the arm's own dynamics.

F_T = K_X (X_d - X) + D_X (dX_d - J_T v),   tau_tip = h + J_T^T F_T
(Su et al. 2019, the paper's Cartesian compliance law.)
"""

from __future__ import annotations

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.dense import cholesky, solve_in_place


@njit(cache=True, nogil=True)
def compliance_force(K: float, D: float, x_d: Array, dx_d: Array, x: Array, dx: Array) -> Array:
    """Compute the force (3,) [N] of spring and damper between a point and its reference; also the law of level 2."""
    force = np.empty(3)
    for i in range(3):
        force[i] = K * (x_d[i] - x[i]) + D * (dx_d[i] - dx[i])
    return force


@njit(cache=True, nogil=True)
def task_inertia(J: Array, M_factor: Array) -> tuple[Array, Array]:
    """Compute W = M^-1 J^T (n, m) and the factor of Lambda^-1 = J M^-1 J^T (m, m).

    Lambda is the inertia felt at the task (Khatib 1987, eq. 51).
    """
    m, n = J.shape
    columns = J.copy()
    for i in range(m):
        solve_in_place(M_factor, columns[i])
    mobility = np.empty((m, m))
    for i in range(m):
        for j in range(i + 1):
            s = 0.0
            for k in range(n):
                s += J[i, k] * columns[j, k]
            mobility[i, j] = mobility[j, i] = s
    return columns.T, cholesky(mobility)
