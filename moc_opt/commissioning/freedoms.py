"""How many freedoms tip and shaft leave an arm, and which of them change anything."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.model.robot_model import RobotModel

Array = NDArray[np.float64]
RANK_TOLERANCE = 1e-6
"""Of the largest singular value."""


class Freedoms(NamedTuple):
    """What is left of n joints when tip and wrist are held; rank + real + idle = n."""

    rank: int
    """Of A: 5 where the arm can place and turn the shaft."""
    real: int
    """Motions that move links while tip and wrist stay."""
    idle: tuple[int, ...]
    """Joints (from 0) that move neither tip nor wrist at any pose, such as a last axis along the tool."""
    tip: float
    """Smallest singular value of the tip's Jacobian over its largest; 0 at a singular pose."""
    both: float
    """The fifth singular value of A over its largest: 0 where the shaft cannot be placed and turned freely."""


def freedoms(robot: RobotModel, q: ArrayLike) -> Freedoms:
    """Count the freedoms at q (n,) [rad, m]."""
    state = robot.state(q)
    idle = tuple(int(j) for j in np.flatnonzero(~robot.moves.any(axis=0)))
    tip, both = (np.linalg.svd(J, compute_uv=False) for J in (state.J_tip, state.A))
    rank = int(np.sum(both > RANK_TOLERANCE * both[0]))
    five = float(both[4] / both[0]) if len(both) > 4 else 0.0
    return Freedoms(rank, robot.n - rank - len(idle), idle, float(tip[-1] / tip[0]), five)


def limit_shares(robot: RobotModel, q: Array) -> Array:
    """Distance of each joint to its nearer limit over half of its range, (n,): 1 in the middle, 0 at a limit."""
    half = 0.5 * (robot.q_max - robot.q_min)
    nearest: Array = np.minimum(q - robot.q_min, robot.q_max - q) / half
    return nearest
