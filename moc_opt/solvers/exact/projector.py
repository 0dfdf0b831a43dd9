"""The orthogonal projector Pi on ker A, from a basis, and swept on some joints and back.

All numbers of a projection onto a polytope lie in one matrix M, n to a row and zeros up to m, a multiple of eight.
Below the rows that are named here come Pi (n rows from PI on) and an orthogonal basis of ker A (r rows).
"""

from __future__ import annotations

from moc_opt.numerics.arrays import Array
from moc_opt.solvers.exact.elimination import inlined

S, LOW, HIGH, PULL = 0, 1, 2, 3  # s and its bounds [rad/s]; c2 Pi g
SIDE, FORCE = 4, 5  # +1 at an active lower bound, -1 at an upper one, 0 elsewhere; multiplier of that bound
SIZE, INVERSE = 6, 7  # the diagonal of Pi; 1 / |z|^2 of every row z of the basis
STEP, BEFORE, TARGET = 8, 9, 10  # scratch for one kernel; s before a proximal step; what is projected
PI = 11


@inlined
def along(M: Array, m: int, a: int, b: int) -> float:
    """Compute the inner product of two rows."""
    product = 0.0
    for c in range(m):
        product += M[a, c] * M[b, c]
    return product


@inlined
def add(M: Array, m: int, to: int, scale: float, what: int) -> None:
    """Add a multiple of one row onto another."""
    for c in range(m):
        M[to, c] += scale * M[what, c]


@inlined
def orthogonalise(M: Array, n: int, m: int, r: int) -> None:
    """Orthogonalise the r rows of the basis by Gram-Schmidt, without making them unit vectors."""
    for a in range(PI + n, PI + n + r):
        inverse = 1.0 / along(M, m, a, a)
        M[INVERSE, a - PI - n] = inverse
        for b in range(a + 1, PI + n + r):
            add(M, m, b, -inverse * along(M, m, a, b), a)


@inlined
def onto_basis(M: Array, n: int, m: int, r: int, what: int, to: int, scale: float) -> None:
    """Write scale * Pi of row ``what`` into row ``to``, through the basis."""
    for c in range(m):
        M[to, c] = 0.0
    for k in range(r):
        z = PI + n + k
        add(M, m, to, scale * M[INVERSE, k] * along(M, m, z, what), z)


@inlined
def projector(M: Array, n: int, m: int, r: int) -> None:
    """Fill Pi = sum of z z^T / |z|^2 over the basis, not swept."""
    Z = PI + n
    for i in range(n):
        for c in range(m):
            M[PI + i, c] = 0.0
        for k in range(r):
            add(M, m, PI + i, M[Z + k, i] * M[INVERSE, k], Z + k)


@inlined
def sweep(M: Array, n: int, m: int, p: int, sign: float) -> None:
    """Exchange joint p's s for its multiplier in Pi (sign 1), or back again (sign -1)."""
    inverse = 1.0 / M[PI + p, p]
    for c in range(m):
        M[STEP, c] = M[PI + p, c]
    M[STEP, p] = -sign
    for i in range(n):
        scale = M[PI + i, p] * inverse
        M[PI + i, p] = 0.0
        add(M, m, PI + i, -scale, STEP)
    for c in range(m):
        M[PI + p, c] = sign * inverse * M[STEP, c]
    M[PI + p, p] = -inverse
