"""The orthogonal projector Pi on ker A, from a basis, and swept on some joints and back.

All numbers of a projection onto a polytope lie in one matrix M, n to a row and zeros up to m, a multiple of eight.
Below the rows that are named here come Pi (n rows from PI on) and an orthogonal basis of ker A (r rows).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moc_opt.numerics.cache import njit
from moc_opt.numerics.simd import load, store, total, unit, zeros

Array = NDArray[np.float64]

S, LOW, HIGH, PULL = 0, 1, 2, 3  # s and its bounds [rad/s]; c2 Pi g
SIDE, FORCE = 4, 5  # +1 at an active lower bound, -1 at an upper one, 0 elsewhere; multiplier of that bound
SIZE, INVERSE = 6, 7  # the diagonal of Pi; 1 / |z|^2 of every row z of the basis
STEP, BEFORE, TARGET = 8, 9, 10  # scratch for one kernel; s before a proximal step; what is projected
PI = 11


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def along(M: Array, m: int, a: int, b: int) -> float:
    """Inner product of two rows."""
    product = zeros()
    for c in range(0, m, 8):
        product = product + load(M, a, c) * load(M, b, c)
    return float(total(product))


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def add(M: Array, m: int, to: int, scale: float, what: int) -> None:
    """A multiple of one row onto another."""
    for c in range(0, m, 8):
        store(M, to, c, load(M, to, c) + scale * load(M, what, c))


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def orthogonalise(M: Array, n: int, m: int, r: int) -> None:
    """Gram-Schmidt on the r rows of the basis, without making them unit vectors."""
    for a in range(PI + n, PI + n + r):
        inverse = 1.0 / along(M, m, a, a)
        M[INVERSE, a - PI - n] = inverse
        for b in range(a + 1, PI + n + r):
            add(M, m, b, -inverse * along(M, m, a, b), a)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def onto_basis(M: Array, n: int, m: int, r: int, what: int, to: int, scale: float) -> None:
    """Row ``to`` = scale * Pi of row ``what``, through the basis."""
    for c in range(0, m, 8):
        store(M, to, c, 0.0)
    for k in range(r):
        z = PI + n + k
        add(M, m, to, scale * M[INVERSE, k] * along(M, m, z, what), z)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def projector(M: Array, n: int, m: int, r: int) -> None:
    """Pi = sum of z z^T / |z|^2 over the basis, not swept."""
    Z = PI + n
    for i in range(n):
        for c in range(0, m, 8):
            row = zeros()
            for k in range(r):
                row = row + M[Z + k, i] * M[INVERSE, k] * load(M, Z + k, c)
            store(M, PI + i, c, row)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def sweep(M: Array, n: int, m: int, p: int, sign: float) -> None:
    """Exchange joint p's s for its multiplier in Pi (sign 1), or back again (sign -1)."""
    inverse = 1.0 / M[PI + p, p]
    for c in range(0, m, 8):
        here = unit(p - c)
        store(M, STEP, c, load(M, PI + p, c) * (1.0 - here) - sign * here)
    for i in range(n):
        scale = M[PI + i, p] * inverse
        for c in range(0, m, 8):
            store(M, PI + i, c, load(M, PI + i, c) * (1.0 - unit(p - c)) - scale * load(M, STEP, c))
    for c in range(0, m, 8):
        here = unit(p - c)
        store(M, PI + p, c, (sign * (1.0 - here) * load(M, STEP, c) - here) * inverse)
