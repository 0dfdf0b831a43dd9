"""Acceleration feed-forward of both tracking levels: what the springs would otherwise have to ask for.

a = [ddX_d - dJ_T v; b^T (ddN_d - dJ_W v)] on the five independent rows A5 (tip, and the wrist across the shaft),
tau = A5^T (A5 M^-1 A5^T)^-1 a. On the tip alone this is the Lambda_T (ddX_d - dJ_T v) of Khatib 1987, eq. 51; the
wrist's part takes out what a travelling elbow does to the shaft. The paper's law has none.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from moc_opt.control.compliance import task_inertia
from moc_opt.control.dense import dot, solve_factored, transpose_times

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def desired_wrist_acceleration(
    tip: Array,
    tip_velocity: Array,
    tip_acceleration: Array,
    trocar: Array,
    trocar_velocity: Array,
    span: float,
) -> Array:
    """ddN_d (3,) [m/s^2] of N_d = X + L e, the trocar's own acceleration left out.

    With r = P_t - X = |r| e:  e'' = (I - e e^T)(r'' - 2 |r|' e')/|r| - |e'|^2 e.
    """
    r = trocar - tip
    distance = np.sqrt(dot(r, r))
    e = r / distance
    slip = trocar_velocity - tip_velocity
    closing = dot(e, slip)
    turn = (slip - closing * e) / distance
    pull = -tip_acceleration - 2.0 * closing * turn
    bend: Array = (pull - dot(e, pull) * e) / distance - dot(turn, turn) * e
    return tip_acceleration + span * bend


@njit(cache=True, nogil=True)
def independent_rows(A: Array, u: Array) -> tuple[Array, Array]:
    """A5 (5, n): the tip's rows and the wrist's across u; and the two directions across u, (2, 3)."""
    n = A.shape[1]
    axis = np.zeros(3)
    axis[np.argmin(np.abs(u))] = 1.0
    across = np.empty((2, 3))
    across[0] = np.cross(u, axis)
    across[0] /= np.sqrt(dot(across[0], across[0]))
    across[1] = np.cross(u, across[0])
    A5 = np.empty((5, n))
    A5[:3] = A[:3]
    for i in range(2):
        for j in range(n):
            A5[3 + i, j] = across[i, 0] * A[3, j] + across[i, 1] * A[4, j] + across[i, 2] * A[5, j]
    return A5, across


@njit(cache=True, nogil=True)
def motion_feedforward(
    A: Array, u: Array, M_factor: Array, drift: Array, tip_acceleration: Array, wrist_acceleration: Array
) -> Array:
    """Torque (n,) [Nm] that gives tip and wrist these accelerations (3,) each, on top of gravity and Coriolis."""
    A5, across = independent_rows(A, u)
    gap = wrist_acceleration - drift[3:]
    a = np.empty(5)
    a[:3] = tip_acceleration - drift[:3]
    a[3], a[4] = dot(across[0], gap), dot(across[1], gap)
    _, mobility = task_inertia(A5, M_factor)
    torque: Array = transpose_times(A5, solve_factored(mobility, a))
    return torque
