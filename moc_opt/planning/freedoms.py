"""How many freedoms tip and shaft leave an arm, and which of them change anything."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.arrays import Array
from moc_opt.errors import RobotError
from moc_opt.robots.model import RobotModel

HELD = 1e-6
"""A singular value below this share of the largest holds nothing. Coarser than the rule of ``qp.residuals``, which
decides for one tick: here random poses are asked how many freedoms an arm is built with."""


class Freedoms(NamedTuple):
    """The freedoms of n joints when tip and wrist are held; rank + real + idle = n."""

    rank: int  #: Of A: 5 where the arm can place and turn the shaft.
    real: int  #: Motions that move links while tip and wrist stay.
    idle: tuple[int, ...]
    """Joints (from 0) that move neither tip nor wrist at any pose, such as a last axis along the tool."""
    tip: float  #: Smallest singular value of the tip's Jacobian over its largest; 0 at a singular pose.
    both: float
    """The fifth singular value of A over its largest: 0 where the shaft cannot be placed and turned freely."""

    def refusal(self, robot: RobotModel) -> str:
        """Say that the third level has nothing to choose, with the count."""
        idle = ", ".join(robot.data.joint_names[j] for j in self.idle)
        return (
            f"robot {robot.data.name!r}: no freedom is left for the third level: of {robot.n} joints the tool's tip "
            f"and shaft take {self.rank}, {len(self.idle)} turn nothing but the tool{f' ({idle})' if idle else ''}; "
            "control.law = 'dcac' needs none, the third level an arm with one joint more, or a tool off the last axis"
        )


def require_freedom(robot: RobotModel) -> None:
    """Refuse an arm that tip and shaft leave no motion.

    Raises:
        RobotError: with the count of joints and of what takes them.
    """
    found = best_freedoms(robot)
    if found.real < 1:
        raise RobotError(found.refusal(robot))


def best_freedoms(robot: RobotModel, poses: int = 8) -> Freedoms:
    """Count the freedoms at seeded poses of the range; those of the highest rank are what the arm is built for."""
    rng = np.random.default_rng(0)
    drawn = rng.uniform(robot.q_min, robot.q_max, (poses, robot.n))
    return max((freedoms(robot, q) for q in drawn), key=lambda found: (found.rank, found.both))


def freedoms(robot: RobotModel, q: ArrayLike) -> Freedoms:
    """Count the freedoms at q (n,) [rad, m]."""
    state = robot.state(q)
    idle = tuple(int(j) for j in np.flatnonzero(~robot.moves.any(axis=0)))
    tip, both = (np.linalg.svd(J, compute_uv=False) for J in (state.J_tip, state.A))
    rank = int(np.sum(both > HELD * both[0]))
    five = float(both[4] / both[0]) if len(both) > 4 else 0.0
    return Freedoms(rank, robot.n - rank - len(idle), idle, float(tip[-1] / tip[0]), five)


def limit_shares(robot: RobotModel, q: Array) -> Array:
    """Return each joint's distance to its nearer limit over half of its range, (n,): 1 in the middle, 0 at a limit."""
    half = 0.5 * (robot.q_max - robot.q_min)
    nearest: Array = np.minimum(q - robot.q_min, robot.q_max - q) / half
    return nearest
