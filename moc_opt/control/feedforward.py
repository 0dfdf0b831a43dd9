"""Acceleration feed-forward of both tracking levels, which the springs would otherwise have to supply.

a = [ddX_d - dJ_T v; b^T (ddN_d - dJ_W v)] on the five independent rows A5 (tip, and the wrist across the shaft),
tau = A5^T (A5 M^-1 A5^T)^-1 a. On the tip alone this is the Lambda_T (ddX_d - dJ_T v) of Khatib 1987, eq. 51; the
wrist's part compensates the effect of a moving elbow on the shaft. The paper's law has no feed-forward.

With M = L L^T the rows of A5 L^-T are made orthogonal instead of squared: the torque of a nearly straight elbow keeps
twice the digits. A nearly straight elbow can hardly move the wrist in one direction. Where the mobility in it is at
most ``STRAIGHT`` times that in the other one, this direction is left out: at the straight elbow itself it would need
an infinite torque, whose sign rounding would decide.
"""

from __future__ import annotations

import numpy as np

from moc_opt.model.shaft_kernels import shaft_turn
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.dense import dot, forward_in_place
from moc_opt.qp.equalities import directions_across

STRAIGHT = 1e-3
"""Mobility of the wrist in its harder direction over that in its easier one; about the elbow's angle [rad]."""


@njit(cache=True, nogil=True)
def desired_wrist_acceleration(
    tip: Array,
    tip_velocity: Array,
    tip_acceleration: Array,
    trocar: Array,
    trocar_velocity: Array,
    span: float,
) -> Array:
    """Compute ddN_d (3,) [m/s^2] of N_d = X + L e, without the trocar's own acceleration.

    With r = P_t - X = |r| e:  e'' = (I - e e^T)(r'' - 2 |r|' e')/|r| - |e'|^2 e.
    """
    distance, e, closing, turn = shaft_turn(tip, tip_velocity, trocar, trocar_velocity)
    pull = -tip_acceleration - 2.0 * closing * turn
    bend: Array = (pull - dot(e, pull) * e) / distance - dot(turn, turn) * e
    return tip_acceleration + span * bend


@njit(cache=True, nogil=True)
def independent_rows(A: Array, u: Array) -> tuple[Array, Array]:
    """Return A5 (5, n), the tip's rows and the wrist's across u, and the two directions across u (2, 3)."""
    n = A.shape[1]
    across, directions = np.empty((2, 3)), directions_across(u[0], u[1], u[2])
    for c in range(3):
        across[0, c], across[1, c] = directions[c], directions[3 + c]
    A5 = np.empty((5, n))
    for c in range(n):
        for d in range(3):
            A5[d, c] = A[d, c]
        for d in range(2):
            A5[3 + d, c] = across[d, 0] * A[3, c] + across[d, 1] * A[4, c] + across[d, 2] * A[5, c]
    return A5, across


@njit(cache=True, nogil=True)
def motion_feedforward(
    A: Array, u: Array, M_factor: Array, drift: Array, tip_acceleration: Array, wrist_acceleration: Array
) -> Array:
    """Compute the torque (n,) [Nm] that gives tip and wrist these accelerations (3,) beyond gravity and Coriolis."""
    A5, across = independent_rows(A, u)
    n, gap = A.shape[1], wrist_acceleration - drift[3:]
    a, c = np.empty(5), np.empty(5)
    a[:3] = tip_acceleration - drift[:3]
    a[3], a[4] = dot(across[0], gap), dot(across[1], gap)
    for i in range(5):  # rows of A5 L^-T; the tip's become orthonormal, the wrist's orthogonal to them
        forward_in_place(M_factor, A5[i])
        for k in range(min(i, 3)):
            along = dot(A5[k], A5[i])
            a[i] -= along * c[k]
            for j in range(n):
                A5[i, j] -= along * A5[k, j]
        if i < 3:
            length = np.sqrt(dot(A5[i], A5[i]))
            inverse = 1.0 / length if length > 0.0 else np.nan
            c[i] = a[i] * inverse
            for j in range(n):
                A5[i, j] *= inverse
    # Jacobi's rotation (Golub and Van Loan, 8.5.2), without its cosine, makes the wrist's two rows orthogonal as well.
    product, gap_of_squares = dot(A5[3], A5[4]), dot(A5[3], A5[3]) - dot(A5[4], A5[4])
    size = abs(gap_of_squares) + np.sqrt(gap_of_squares * gap_of_squares + 4.0 * product * product)
    side = 2.0 if gap_of_squares >= 0.0 else -2.0
    tangent = side * product / size if size > 0.0 else 0.0
    a[3], a[4] = a[3] + tangent * a[4], a[4] - tangent * a[3]
    for j in range(n):
        A5[3, j], A5[4, j] = A5[3, j] + tangent * A5[4, j], A5[4, j] - tangent * A5[3, j]
    one, other = dot(A5[3], A5[3]), dot(A5[4], A5[4])
    least = STRAIGHT * STRAIGHT * max(one, other)
    c[3] = a[3] / one if one > least else 0.0
    c[4] = a[4] / other if other > least else 0.0
    torque = np.zeros(n)
    for i in range(n):  # L times the sum of the rows
        for k in range(i + 1):
            along = 0.0
            for row in range(5):
                along += c[row] * A5[row, k]
            torque[i] += M_factor[i, k] * along
    return torque
