"""The equality rows that a solver gets, the six of the paper or five independent ones, and its cost, compiled.

In a control loop every subproblem is new, and its P, p and five rows are needed once: the kernel here computes all of
them at once, some thirty times faster than the plain numpy of ``moc_opt.qp.problem``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable

from moc_opt.numerics.arrays import Array, read_only
from moc_opt.numerics.cache import njit
from moc_opt.qp import layout, reduction
from moc_opt.qp.layout import C0, C1, C2, RHO
from moc_opt.qp.problem import NullSpaceQP

ROWS = (5, 6)
_SIX = read_only(np.eye(6))

# Kernels may call these from here on.
offsets = register_jitable(layout.offsets)
joints_of = register_jitable(layout.joints_of)
directions_across = register_jitable(reduction.directions_across)
reduce_rows = register_jitable(reduction.reduce_rows)
register_jitable(reduction.tool_direction)


class Assembled(NamedTuple):
    """A subproblem as a solver takes it: 1/2 x^T P x + p^T x, A x = b, and y6 = lift^T y."""

    P: Array
    """(n, n)"""
    p: Array
    """(n,)"""
    A: Array
    """(m, n)"""
    b: Array
    """(m,)"""
    lift: Array
    """(m, 6)"""


@njit(cache=True, nogil=True)
def assemble(row: Array, n: int, P: Array, p: Array, A5: Array, b5: Array, lift: Array) -> bool:
    """Fill P (n, n), p (n,), and the five rows A5 (5, n), b5 (5,), lift (5, 6) of one packed subproblem.

    Returns False where there are no five rows, only six.
    """
    at = offsets(n)
    c0, c1, c2, rho = (row[at.weights + C0], row[at.weights + C1], row[at.weights + C2], row[at.weights + RHO])
    for i in range(n):
        for j in range(i + 1):
            tip = wrist = 0.0
            for k in range(3):
                tip += row[k * n + i] * row[k * n + j]
                wrist += row[(k + 3) * n + i] * row[(k + 3) * n + j]
            P[i, j] = P[j, i] = c0 * tip + c1 * wrist
        P[i, i] += rho
        tip = wrist = 0.0
        for k in range(3):
            tip += row[k * n + i] * row[at.b + k]
            wrist += row[(k + 3) * n + i] * row[at.b + 3 + k]
        p[i] = -c0 * tip - c1 * wrist - c2 * row[at.grad_mu + i]
    return reduce_rows(row, n, A5, b5, lift)


def assembled(qp: NullSpaceQP, rows: int = 5) -> Assembled:
    """Compute cost and equality rows of ``qp`` in the form that was asked for; read-only arrays.

    rows = 5 still gives six where tip and wrist are not rigidly tied.
    """
    n = qp.n
    P, p, A5, b5, lift = np.empty((n, n)), np.empty(n), np.empty((5, n)), np.empty(5), np.empty((5, 6))
    five = assemble(qp.row, n, P, p, A5, b5, lift)
    for array in (P, p, A5, b5, lift):
        read_only(array)
    return Assembled(P, p, A5, b5, lift) if five and rows == 5 else Assembled(P, p, qp.A, qp.b, _SIX)
