"""The shaft through the trocar: where the wrist belongs for a tip, and how the line from tip to trocar turns."""

from __future__ import annotations

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.dense import dot


@njit(cache=True, nogil=True)
def shaft_turn(
    tip: Array, tip_velocity: Array, trocar: Array, trocar_velocity: Array
) -> tuple[float, Array, float, Array]:
    """Compute how the line from tip to trocar lies and turns.

    Returns:
        |P_t - X| [m]; e (3,); its rate of change e^T (dP_t - dX) [m/s]; and
        de/dt = (I - e e^T)(dP_t - dX)/|P_t - X| (3,) [1/s].
    """
    e, turn, square = np.empty(3), np.empty(3), 0.0
    for i in range(3):
        e[i], turn[i] = trocar[i] - tip[i], trocar_velocity[i] - tip_velocity[i]
        square += e[i] * e[i]
    distance = np.sqrt(square)
    for i in range(3):
        e[i] /= distance
    closing = dot(e, turn)
    for i in range(3):
        turn[i] = (turn[i] - closing * e[i]) / distance
    return distance, e, closing, turn


@njit(cache=True, nogil=True)
def desired_wrist(
    tip: Array, tip_velocity: Array, trocar: Array, trocar_velocity: Array, span: float
) -> tuple[Array, Array]:
    """Compute N_d = X + L e, which puts the shaft through the trocar, and dN_d = dX + L de/dt, (3,) [m], [m/s]."""
    _, e, _, turn = shaft_turn(tip, tip_velocity, trocar, trocar_velocity)
    for i in range(3):
        e[i], turn[i] = tip[i] + span * e[i], tip_velocity[i] + span * turn[i]
    return e, turn


@njit(cache=True, nogil=True)
def desired_wrists(tips: Array, trocars: Array, span: float) -> Array:
    """Compute N_d (k, 3) [m] for rows of tips and trocars (k, 3) [m], each pair apart; see `desired_wrist`."""
    wrists, rest = np.empty_like(tips), np.zeros(3)
    for i in range(len(tips)):
        wrists[i] = desired_wrist(tips[i], rest, trocars[i], rest, span)[0]
    return wrists
