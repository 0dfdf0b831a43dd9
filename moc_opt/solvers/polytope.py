"""Several freedoms: the best point of a box cut by an affine subspace, as a projection.

With orthonormal Z and x0 across it, damping/2 |x|^2 - c2 g^T x over {x0 + Z w in the box} is the
projection of c2 Z^T g / damping onto a polytope in w. The dual active-set method of Goldfarb and
Idnani (Math. Programming 27, 1983, algorithm 1) does it from the unconstrained optimum, adding
violated bounds one by one; it needs no feasible start and proves infeasibility. For damping = 0
the proximal point iteration (finite for linear programs: Ferris 1991) repeats the projection.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

OK, EMPTY, STUCK = 0, 1, 2
FAR = 1e3  # box widths beyond which the unconstrained optimum is approached in proximal steps


@njit(cache=True, nogil=True)
def orthonormal(Z: Array) -> None:
    """Gram-Schmidt on the columns of Z (n, r), in place, twice over for orthogonality to rounding."""
    for c in range(Z.shape[1]):
        for _ in range(2):
            for d in range(c):
                Z[:, c] -= (Z[:, d] @ Z[:, c]) * Z[:, d]
        Z[:, c] /= np.sqrt(Z[:, c] @ Z[:, c])


@njit(cache=True, nogil=True)
def project(N: Array, c: Array, w: Array, multipliers: Array, tolerance: float) -> int:
    """Project w (r,) onto {N w >= c}, in place; multipliers (m,) of w - w_start = N^T multipliers."""
    m, r = N.shape
    active = np.empty(r, dtype=np.int64)
    lam = np.zeros(r + 1)
    k = 0
    multipliers[:] = 0.0
    for _ in range(20 * m):
        p, worst = -1, tolerance
        for i in range(m):
            gap = c[i] - N[i] @ w
            if gap > worst:
                p, worst = i, gap
        if p < 0:
            for i in range(k):
                multipliers[active[i]] = lam[i]
            return OK
        own = 0.0
        while True:
            z = N[p].copy()
            back = np.zeros(k)
            if k > 0:
                B = np.empty((k, r))
                for i in range(k):
                    B[i] = N[active[i]]
                back = np.linalg.solve(B @ B.T, B @ N[p])
                z -= B.T @ back
            drop, step = -1, np.inf
            for i in range(k):
                if back[i] > 1e-12 and lam[i] / back[i] < step:
                    drop, step = i, lam[i] / back[i]
            curvature = z @ N[p]
            full = np.inf
            if k < r and curvature > 1e-12 * (N[p] @ N[p]):
                full = (c[p] - N[p] @ w) / curvature
            if drop < 0 and full == np.inf:
                return EMPTY
            length = min(step, full)
            if full < np.inf:
                w += length * z
            for i in range(k):
                lam[i] -= length * back[i]
            own += length
            if full <= step:
                active[k], lam[k] = p, own
                k += 1
                break
            for i in range(drop, k - 1):
                active[i], lam[i] = active[i + 1], lam[i + 1]
            k -= 1
    return STUCK


@njit(cache=True, nogil=True)
def maximise_over_box(
    Z: Array,
    grad_mu: Array,
    lower: Array,
    upper: Array,
    c2: float,
    rho: float,
    tolerance: float,
    x: Array,
    bound_dual: Array,
) -> int:
    """Move x (n,) along the columns of Z to the optimum; adds the bounds' multipliers to bound_dual."""
    n, r = Z.shape
    orthonormal(Z)
    used = np.empty(n, dtype=np.int64)  # joints that Z moves: the others belong to somebody else
    m = 0
    for j in range(n):
        if np.max(np.abs(Z[j])) > 1e-13:
            used[m] = j
            m += 1
    along = Z.T @ x
    x -= Z @ along
    N, c = np.empty((2 * m, r)), np.empty(2 * m)
    width = 0.0
    for i in range(m):
        j = used[i]
        size = np.sqrt(Z[j] @ Z[j])  # unit normals: one tolerance fits all bounds
        N[i], c[i] = Z[j] / size, (lower[j] - x[j]) / size
        N[m + i], c[m + i] = -Z[j] / size, (x[j] - upper[j]) / size
        width = max(width, upper[j] - lower[j])
    pull = np.zeros(r)
    for i in range(n):
        pull += c2 * grad_mu[i] * Z[i]
    size = np.sqrt(pull @ pull)
    multipliers = np.empty(2 * m)
    w = np.zeros(r)
    small = 1e-14 * max(1.0, width)
    if rho > 0.0 and size <= FAR * width * rho:
        w[:] = pull / rho
        status = project(N, c, w, multipliers, small)
        multipliers *= rho
    else:
        status = project(N, c, w, multipliers, small)
        multipliers[:] = 0.0
        base = 10.0 * max(width, 1e-6) / size if size > 0.0 else 0.0
        # Long steps first: they also travel where the cost is almost flat. The short one at the end stays
        # at the vertex and takes the rounding of the long ones out.
        for scale in (1e8, 1e4, 1.0):
            step = scale * base
            for _ in range(50):
                if status != OK or step == 0.0:
                    break
                before = w.copy()
                w += step * pull
                w /= 1.0 + rho * step
                status = project(N, c, w, multipliers, small * max(1.0, 1e-3 * scale))
                multipliers *= rho + 1.0 / step
                if np.max(np.abs(w - before)) <= small * scale:
                    break
    x += Z @ w
    for i in range(m):
        j = used[i]
        bound_dual[j] += (multipliers[i] - multipliers[m + i]) / np.sqrt(Z[j] @ Z[j])
    return status
