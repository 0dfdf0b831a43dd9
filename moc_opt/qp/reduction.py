"""The reduction of the six equality rows to five independent ones.

Tip and wrist are rigidly tied: u^T (J_T - J_W) = 0 for the direction u of the tool, so the wrist's row along u
repeats the tip's. Left are the tip's three rows and the wrist's two across u: A5 = lift A6, and A5^T y5 =
A6^T (lift^T y5).

Plain functions of numbers, used as they are by ``NullSpaceQP`` and compiled by ``moc_opt.qp.equalities``: one
source, so that both take the same decision.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from moc_opt.numerics.arrays import Array
from moc_opt.qp.layout import offsets
from moc_opt.qp.residuals import TIED

Record = Sequence[float] | Array


def tool_direction(row: Record, n: int) -> tuple[bool, float, float, float]:
    """Find the unit vector u with u^T (J_T - J_W) = 0 in a packed subproblem, its largest entry positive.

    The adjugate of (J_T - J_W)(J_T - J_W)^T is a multiple of u u^T; its longest column is taken.

    Returns:
        Whether tip and wrist are tied, by the sixth singular value of A (``TIED``), and u.
    """
    a = b = c = d = e = f = size = 0.0
    for j in range(n):
        x, y, z = row[j] - row[3 * n + j], row[n + j] - row[4 * n + j], row[2 * n + j] - row[5 * n + j]
        a += x * x
        b += x * y
        c += x * z
        d += y * y
        e += y * z
        f += z * z
        for i in range(6):
            size += row[i * n + j] * row[i * n + j]
    i00, i11, i22 = d * f - e * e, a * f - c * c, a * d - b * b
    if i00 >= i11 and i00 >= i22:
        ux, uy, uz = i00, c * e - b * f, b * e - c * d
    elif i11 >= i22:
        ux, uy, uz = c * e - b * f, i11, b * c - a * e
    else:
        ux, uy, uz = b * e - c * d, b * c - a * e, i22
    length = math.sqrt(ux * ux + uy * uy + uz * uz)
    if n < 3 or not length > 0.0:
        return False, 0.0, 0.0, 0.0
    most = ux if abs(ux) >= abs(uy) and abs(ux) >= abs(uz) else uy if abs(uy) >= abs(uz) else uz
    if most < 0.0:
        length = -length
    ux, uy, uz = ux / length, uy / length, uz / length
    apart = 0.0
    for j in range(n):
        gap = (
            ux * (row[j] - row[3 * n + j])
            + uy * (row[n + j] - row[4 * n + j])
            + uz * (row[2 * n + j] - row[5 * n + j])
        )
        apart += gap * gap
    # [u; -u] / sqrt(2) is the left singular vector of A that belongs to its sixth singular value.
    return 0.5 * apart <= TIED * TIED * size, ux, uy, uz


def directions_across(x: float, y: float, z: float) -> tuple[float, float, float, float, float, float]:
    """Compute two unit vectors across the unit vector (x, y, z): u x e_k for its smallest entry k, and u x that."""
    if abs(x) <= abs(y) and abs(x) <= abs(z):
        ax, ay, az = 0.0, z, -y
    elif abs(y) <= abs(z):
        ax, ay, az = -z, 0.0, x
    else:
        ax, ay, az = y, -x, 0.0
    length = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    return ax, ay, az, y * az - z * ay, z * ax - x * az, x * ay - y * ax


def reduce_rows(row: Record, n: int, A5: Any, b5: Any, lift: Any) -> bool:
    """Fill A5 (5, n), b5 (5,) and lift (5, 6) from a packed subproblem.

    Returns:
        Whether there are five rows; where tip and wrist are not tied there are only the six.
    """
    tied, ux, uy, uz = tool_direction(row, n)
    if not tied:
        return False
    o = offsets(n).b
    across = directions_across(ux, uy, uz)
    lift[:] = 0.0
    for i in range(3):
        lift[i, i], b5[i] = 1.0, row[o + i]
        for j in range(n):
            A5[i, j] = row[i * n + j]
    for i in range(2):
        x, y, z = across[:3] if i == 0 else across[3:]
        lift[3 + i, 3], lift[3 + i, 4], lift[3 + i, 5] = x, y, z
        b5[3 + i] = x * row[o + 3] + y * row[o + 4] + z * row[o + 5]
        for j in range(n):
            A5[3 + i, j] = x * row[3 * n + j] + y * row[4 * n + j] + z * row[5 * n + j]
    return True
