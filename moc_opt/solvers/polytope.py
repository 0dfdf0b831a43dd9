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
def dot(a: Array, b: Array) -> float:
    """a . b as a loop: at this size a call into BLAS costs more than the sum."""
    s = 0.0
    for i in range(a.shape[0]):
        s += a[i] * b[i]
    return s


@njit(cache=True, nogil=True)
def orthonormal(Z: Array) -> None:
    """Gram-Schmidt on the rows of Z (r, n), in place, twice over for orthogonality to rounding."""
    r, n = Z.shape
    for c in range(r):
        for _ in range(2):
            for d in range(c):
                along = dot(Z[d], Z[c])
                for j in range(n):
                    Z[c, j] -= along * Z[d, j]
        length = np.sqrt(dot(Z[c], Z[c]))
        for j in range(n):
            Z[c, j] /= length


@njit(cache=True, nogil=True)
def steer(N: Array, active: NDArray[np.int64], k: int, p: int, z: Array, back: Array, G: Array) -> float:
    """Split the normal of bound p into z (r,), across the k active normals, and ``back`` (k,) along them.

    back = (B B^T)^-1 B n_p for the active rows B, by Cholesky in G (r, r). Returns n_p . z.
    """
    r = N.shape[1]
    for i in range(k):
        for j in range(i + 1):
            s = 0.0
            for c in range(r):
                s += N[active[i], c] * N[active[j], c]
            for c in range(j):
                s -= G[i, c] * G[j, c]
            G[i, j] = np.sqrt(max(s, 1e-300)) if i == j else s / G[j, j]
        s = 0.0
        for c in range(r):
            s += N[active[i], c] * N[p, c]
        for c in range(i):
            s -= G[i, c] * back[c]
        back[i] = s / G[i, i]
    for i in range(k - 1, -1, -1):
        for c in range(i + 1, k):
            back[i] -= G[c, i] * back[c]
        back[i] /= G[i, i]
    curvature = 0.0
    for c in range(r):
        z[c] = N[p, c]
        for i in range(k):
            z[c] -= N[active[i], c] * back[i]
        curvature += N[p, c] * z[c]
    return curvature


@njit(cache=True, nogil=True)
def gap(N: Array, c: Array, w: Array, i: int) -> float:
    """How far w violates bound i."""
    s = c[i]
    for j in range(w.shape[0]):
        s -= N[i, j] * w[j]
    return s


@njit(cache=True, nogil=True)
def project(N: Array, c: Array, w: Array, multipliers: Array, tolerance: float) -> int:
    """Project w (r,) onto {N w >= c}, in place; multipliers (m,) of w - w_start = N^T multipliers."""
    m, r = N.shape
    active = np.empty(r, dtype=np.int64)
    lam, back, z, G = np.zeros(r + 1), np.zeros(r), np.zeros(r), np.empty((r, r))
    k = 0
    multipliers[:] = 0.0
    for _ in range(20 * m):
        p, worst = -1, tolerance
        for i in range(m):
            violation = gap(N, c, w, i)
            if violation > worst:
                p, worst = i, violation
        if p < 0:
            for i in range(k):
                multipliers[active[i]] = lam[i]
            return OK
        own = 0.0
        while True:
            curvature = steer(N, active, k, p, z, back, G)
            drop, step = -1, np.inf
            for i in range(k):
                if back[i] > 1e-12 and lam[i] / back[i] < step:
                    drop, step = i, lam[i] / back[i]
            full = np.inf
            if k < r and curvature > 1e-12:  # the normals are unit vectors
                full = gap(N, c, w, p) / curvature
            if drop < 0 and full == np.inf:
                return EMPTY
            length = min(step, full)
            if full < np.inf:
                for j in range(r):
                    w[j] += length * z[j]
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
    Z: Array, grad_mu: Array, lower: Array, upper: Array, c2: float, rho: float, tolerance: float,
    x: Array, bound_dual: Array,
) -> int:  # fmt: skip
    """Move x (n,) along the rows of Z (r, n) to the optimum; adds the bounds' multipliers to bound_dual."""
    r, n = Z.shape
    orthonormal(Z)
    for c in range(r):
        along = dot(Z[c], x)
        for j in range(n):
            x[j] -= along * Z[c, j]
    # Unit normals, so that one tolerance fits all bounds; joints that Z does not move belong to somebody else.
    used, sizes, m = np.empty(n, dtype=np.int64), np.empty(n), 0
    for j in range(n):
        size = np.sqrt(dot(Z[:, j], Z[:, j]))
        if size > 1e-13:
            used[m], sizes[m] = j, size
            m += 1
    N, c_bound, width = np.empty((2 * m, r)), np.empty(2 * m), 0.0
    for i in range(m):
        j = used[i]
        for c in range(r):
            N[i, c] = Z[c, j] / sizes[i]
            N[m + i, c] = -N[i, c]
        c_bound[i], c_bound[m + i] = (lower[j] - x[j]) / sizes[i], (x[j] - upper[j]) / sizes[i]
        width = max(width, upper[j] - lower[j])
    pull, largest = np.empty(r), 0.0
    for c in range(r):
        pull[c] = c2 * dot(Z[c], grad_mu)
        largest += pull[c] * pull[c]
    largest = np.sqrt(largest)
    multipliers, w, before = np.empty(2 * m), np.zeros(r), np.empty(r)
    small = 1e-14 * max(1.0, width)
    if rho > 0.0 and largest <= FAR * width * rho:
        for c in range(r):
            w[c] = pull[c] / rho
        status = project(N, c_bound, w, multipliers, small)
        weight = rho
    else:
        status = project(N, c_bound, w, multipliers, small)
        multipliers[:] = 0.0
        weight = 0.0
        base = 10.0 * max(width, 1e-6) / largest if largest > 0.0 else 0.0
        # Long steps first: they also travel where the cost is almost flat. The short one at the end stays
        # at the vertex and takes the rounding of the long ones out.
        for scale in (1e8, 1e4, 1.0):
            step = scale * base
            for _ in range(50):
                if status != OK or step == 0.0:
                    break
                moved = 0.0
                for c in range(r):
                    before[c] = w[c]
                    w[c] = (w[c] + step * pull[c]) / (1.0 + rho * step)
                status = project(N, c_bound, w, multipliers, small * max(1.0, 1e-3 * scale))
                weight = rho + 1.0 / step
                for c in range(r):
                    moved = max(moved, abs(w[c] - before[c]))
                if moved <= small * scale:
                    break
    for c in range(r):
        for j in range(n):
            x[j] += w[c] * Z[c, j]
    for i in range(m):
        bound_dual[used[i]] += weight * (multipliers[i] - multipliers[m + i]) / sizes[i]
    return status
