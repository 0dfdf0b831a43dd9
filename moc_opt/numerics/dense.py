"""Small dense algebra for one tick: at 7 x 7 a plain loop beats the call into LAPACK."""

from __future__ import annotations

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit


@njit(cache=True, nogil=True)
def cholesky(S: Array) -> Array:
    """Lower factor of a symmetric positive definite S (m, m); NaN where S is not."""
    m = S.shape[0]
    L = np.zeros((m, m))
    for j in range(m):
        d = S[j, j]
        for k in range(j):
            d -= L[j, k] * L[j, k]
        L[j, j] = np.sqrt(d) if d > 0.0 else np.nan
        inverse = 1.0 / L[j, j]
        for i in range(j + 1, m):
            s = S[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            L[i, j] = s * inverse
    return L


@njit(cache=True, nogil=True)
def solve_in_place(L: Array, x: Array) -> None:
    """Replace x (m,) by S^-1 x, given the factor of S. No step waits for a division: they need no x."""
    m = L.shape[0]
    for i in range(m):
        s = x[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s * (1.0 / L[i, i])
    for i in range(m - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, m):
            s -= L[k, i] * x[k]
        x[i] = s * (1.0 / L[i, i])


@njit(cache=True, nogil=True)
def forward_in_place(L: Array, x: Array) -> None:
    """Replace x (m,) by L^-1 x, L being a lower triangle."""
    for i in range(L.shape[0]):
        s = x[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s * (1.0 / L[i, i])


@njit(cache=True, nogil=True)
def solve_factored(L: Array, b: Array) -> Array:
    """Compute S^-1 b for a vector b (m,), given the factor of S."""
    x = b.copy()
    solve_in_place(L, x)
    return x


@njit(cache=True, nogil=True)
def times(A: Array, x: Array) -> Array:
    """Compute A x."""
    out = np.empty(A.shape[0])
    for i in range(A.shape[0]):
        s = 0.0
        for j in range(A.shape[1]):
            s += A[i, j] * x[j]
        out[i] = s
    return out


@njit(cache=True, nogil=True)
def transpose_times(A: Array, x: Array) -> Array:
    """Compute A^T x."""
    out = np.empty(A.shape[1])
    for j in range(A.shape[1]):
        s = 0.0
        for i in range(A.shape[0]):
            s += A[i, j] * x[i]
        out[j] = s
    return out


@njit(cache=True, nogil=True)
def gram(A: Array) -> Array:
    """Compute A A^T."""
    m, n = A.shape
    S = np.zeros((m, m))
    for i in range(m):
        for j in range(i + 1):
            s = 0.0
            for k in range(n):
                s += A[i, k] * A[j, k]
            S[i, j] = s
            S[j, i] = s
    return S


@njit(cache=True, nogil=True)
def dot(a: Array, b: Array) -> float:
    """Compute a . b without asking for contiguous memory."""
    s = 0.0
    for i in range(a.shape[0]):
        s += a[i] * b[i]
    return s
