"""Where every joint's frame is, for many poses at once."""

from __future__ import annotations

import numpy as np

from moc_opt.model.symbolic import Chain
from moc_opt.numerics.arrays import Array


def link_frames(chain: Chain, q: Array) -> tuple[Array, Array]:
    """Compute the forward kinematics of many poses at once.

    Args:
        q: (k, n) [rad], of prismatic joints [m].

    Returns:
        Origins (k, n, 3) [m] and rotations (k, n, 3, 3), world from joint frame, after each joint's motion.
    """
    count, n = q.shape
    origins, rotations = np.empty((count, n, 3)), np.empty((count, n, 3, 3))
    place, turn = np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1))
    for j in range(n):
        place = place + turn @ chain.origins[j]
        turn = turn @ chain.rotations[j]
        if chain.prismatic[j]:
            place = place + (turn @ chain.axes[j]) * q[:, j, None]
        else:
            turn = turn @ _turns(chain.axes[j], q[:, j])
        origins[:, j], rotations[:, j] = place, turn
    return origins, rotations


def _turns(axis: Array, angles: Array) -> Array:
    """Return (k, 3, 3) Rodrigues' rotations about one unit axis."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    turned: Array = np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)
    return turned
