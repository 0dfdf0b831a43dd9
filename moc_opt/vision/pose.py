"""A rigid pose of one frame in another, for the places of cameras, boards and phantoms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from moc_opt.arrays import Array, read_only
from moc_opt.errors import TaskError
from moc_opt.tasks.checks import vector3


@dataclass(frozen=True, eq=False)
class Pose:
    """x_outer = R x_inner + t.

    Chains read from right to left: board_in_base = camera_in_base @ board_in_camera.

    Args:
        R: (3, 3) rotation, its columns are the inner axes in the outer frame.
        t: (3,) the inner origin in the outer frame [m].

    Raises:
        TaskError: a shape is wrong, an entry is not finite, or R is no rotation (to 1e-6).
    """

    R: Array
    t: Array

    def __init__(self, R: ArrayLike = np.eye(3), t: ArrayLike = (0.0, 0.0, 0.0)) -> None:  # noqa: B008
        turn = np.array(R, dtype=np.float64)
        if turn.shape != (3, 3) or not np.abs(turn @ turn.T - np.eye(3)).max() < 1e-6 or np.linalg.det(turn) < 0.0:
            raise TaskError(f"R = {turn.tolist()!r:.200} is no rotation: give perpendicular, right-handed unit columns")
        object.__setattr__(self, "R", read_only(turn))
        object.__setattr__(self, "t", vector3("t", t))

    def apply(self, points: ArrayLike) -> Array:
        """Express points (3,) or (k, 3) [m] of the inner frame in the outer one."""
        return np.asarray(np.asarray(points, dtype=np.float64) @ self.R.T + self.t)

    def turn(self, vectors: ArrayLike) -> Array:
        """Express directions (3,) or (k, 3) of the inner frame in the outer one: turned, not moved."""
        return np.asarray(np.asarray(vectors, dtype=np.float64) @ self.R.T)

    def inverse(self) -> Pose:
        """Return the outer frame seen from the inner one."""
        return Pose(self.R.T, -self.R.T @ self.t)

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.R @ other.R, self.apply(other.t))

    def distance(self, other: Pose) -> tuple[float, float]:
        """Return how far apart two poses are: between the origins [m], and the angle of the turn between [rad]."""
        return float(np.linalg.norm(self.t - other.t)), float(np.linalg.norm(rotation_vector(self.R.T @ other.R)))

    def towards(self, other: Pose, share: float) -> Pose:
        """Return the pose at a share in [0, 1] of the way to another: straight, at a constant rate of turn."""
        turn = rotation_from(share * rotation_vector(self.R.T @ other.R))
        return Pose(self.R @ turn, self.t + share * (other.t - self.t))


def rotation_from(vector: ArrayLike) -> Array:
    """Return the rotation (3, 3) about `vector` (3,) by its length [rad]."""
    return np.asarray(pin.exp3(np.array(vector, dtype=np.float64)))


def rotation_vector(rotation: ArrayLike) -> Array:
    """Return axis times angle (3,) [rad] of a rotation (3, 3), the angle in [0, pi]."""
    return np.asarray(pin.log3(np.array(rotation, dtype=np.float64)))
