"""Which equality rows a solver gets: the six of the paper, or five independent ones.

Tip and wrist are rigidly tied, so one of the six rows repeats the others. Many solvers factorise
A P^-1 A^T or pivot on it and fail there; five rows cure them. Either way the duals come back as six:
A5 = lift A6 gives A5^T y5 = A6^T (lift^T y5).

In a control loop every subproblem is new, and its P, p and five rows are needed once: the kernel here
computes all of them at once, some thirty times faster than the plain numpy of ``moc_opt.qp.problem``.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from moc_opt.qp.problem import NullSpaceQP, Reduced
from moc_opt.qp.residuals import TIED

Array = NDArray[np.float64]

ROWS = (5, 6)
_SIX = np.eye(6)
_SIX.flags.writeable = False


@njit(cache=True, nogil=True)
def tool_direction(row: Array, n: int, u: Array) -> bool:
    """u (3,) with u^T (J_T - J_W) = 0, largest entry positive; False where tip and wrist are not tied.

    The adjugate of (J_T - J_W)(J_T - J_W)^T is a multiple of u u^T; its longest column is taken.
    """
    D = np.empty((3, n))
    size = 0.0
    for i in range(3):
        for j in range(n):
            tip, wrist = row[i * n + j], row[(i + 3) * n + j]
            D[i, j] = tip - wrist
            size += tip * tip + wrist * wrist
    a = b = c = d = e = f = 0.0
    for j in range(n):
        x, y, z = D[0, j], D[1, j], D[2, j]
        a += x * x
        b += x * y
        c += x * z
        d += y * y
        e += y * z
        f += z * z
    i00, i11, i22 = d * f - e * e, a * f - c * c, a * d - b * b
    if i00 >= i11 and i00 >= i22:
        u[0], u[1], u[2] = i00, c * e - b * f, b * e - c * d
    elif i11 >= i22:
        u[0], u[1], u[2] = c * e - b * f, i11, b * c - a * e
    else:
        u[0], u[1], u[2] = b * e - c * d, b * c - a * e, i22
    length = np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    if not length > 0.0:
        return False
    k = 0 if abs(u[0]) >= abs(u[1]) and abs(u[0]) >= abs(u[2]) else 1 if abs(u[1]) >= abs(u[2]) else 2
    if u[k] < 0.0:
        length = -length
    u[0], u[1], u[2] = u[0] / length, u[1] / length, u[2] / length
    apart = 0.0
    for j in range(n):
        gap = u[0] * D[0, j] + u[1] * D[1, j] + u[2] * D[2, j]
        apart += gap * gap
    return bool(0.5 * apart <= TIED * TIED * size)


@njit(cache=True, nogil=True)
def assemble(row: Array, n: int, P: Array, p: Array, A5: Array, b5: Array, lift: Array) -> bool:
    """Fill P (n, n), p (n,), and the five rows A5 (5, n), b5 (5,), lift (5, 6) of one flat record.

    Returns False where there are no five rows, only six.
    """
    o = 6 * n
    c0, c1, c2, rho = row[o + 6 + 3 * n], row[o + 7 + 3 * n], row[o + 8 + 3 * n], row[o + 9 + 3 * n]
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
            tip += row[k * n + i] * row[o + k]
            wrist += row[(k + 3) * n + i] * row[o + 3 + k]
        p[i] = -c0 * tip - c1 * wrist - c2 * row[o + 6 + i]
    u = np.empty(3)
    if not tool_direction(row, n, u):
        return False
    lift[:] = 0.0
    lift[0, 0] = lift[1, 1] = lift[2, 2] = 1.0
    # Across u: u x e_k for its smallest entry k, and u x that; written out, np.cross costs more than all the rest.
    x, y, z = u[0], u[1], u[2]
    if abs(x) <= abs(y) and abs(x) <= abs(z):
        ax, ay, az = 0.0, z, -y
    elif abs(y) <= abs(z):
        ax, ay, az = -z, 0.0, x
    else:
        ax, ay, az = y, -x, 0.0
    length = np.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    lift[3, 3], lift[3, 4], lift[3, 5] = ax, ay, az
    lift[4, 3], lift[4, 4], lift[4, 5] = y * az - z * ay, z * ax - x * az, x * ay - y * ax
    for i in range(3):
        b5[i] = row[o + i]
        for j in range(n):
            A5[i, j] = row[i * n + j]
    for i in range(2):
        x, y, z = lift[3 + i, 3], lift[3 + i, 4], lift[3 + i, 5]
        b5[3 + i] = x * row[o + 3] + y * row[o + 4] + z * row[o + 5]
        for j in range(n):
            A5[3 + i, j] = x * row[3 * n + j] + y * row[4 * n + j] + z * row[5 * n + j]
    return True


def expand(qp: NullSpaceQP) -> None:
    """Compute P, p and the reduced rows of ``qp`` and leave them where its own properties look first."""
    n = qp.n
    P, p, A5, b5, lift = np.empty((n, n)), np.empty(n), np.empty((5, n)), np.empty(5), np.empty((5, 6))
    five = assemble(qp.row, n, P, p, A5, b5, lift)
    for array in (P, p, A5, b5, lift):
        array.flags.writeable = False
    reduced = Reduced(A5, b5, lift) if five else Reduced(qp.A, qp.b, _SIX)
    qp.__dict__.update(P=P, p=p, _reduced=reduced)


def equalities(qp: NullSpaceQP, rows: int) -> Reduced:
    """The rows A (m, n), b (m,) and lift (m, 6) in the form that was asked for.

    rows = 5 still gives six where tip and wrist are not rigidly tied.
    """
    if "_reduced" not in qp.__dict__:
        expand(qp)
    return qp.reduced() if rows == 5 else Reduced(qp.A, qp.b, _SIX)
