"""A rigid pose of one frame in another, for the places of cameras, boards and phantoms."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from moc_opt.errors import TaskError
from moc_opt.numerics.arrays import Array, read_only
from moc_opt.tasks.checks import Vector, direction3, vector3

_ORTHONORMAL = 1e-6


@dataclass(frozen=True, eq=False)
class Pose:
    """x_outer = rotation x_inner + translation.

    `a_in_b` is a good name for one: it takes points of frame a into frame b. Chains read from right to left:
    board_in_base = camera_in_base @ board_in_camera.

    Args:
        rotation: (3, 3), its columns are the inner axes in the outer frame.
        translation: (3,), the inner origin in the outer frame [m].

    Raises:
        TaskError: a shape is wrong, an entry is not finite, or the rotation is none (to 1e-6).
    """

    rotation: ArrayLike = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    translation: ArrayLike = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        turn = np.array(self.rotation, dtype=np.float64)
        if turn.shape != (3, 3) or not np.isfinite(turn).all():
            raise TaskError(f"rotation = {turn.tolist()!r:.200}: give (3, 3) finite numbers")
        if np.abs(turn @ turn.T - np.eye(3)).max() > _ORTHONORMAL or np.linalg.det(turn) < 0.0:
            raise TaskError(
                f"rotation = {turn.tolist()!r:.200} is none: its columns must be unit vectors, "
                "perpendicular, and right-handed"
            )
        object.__setattr__(self, "rotation", read_only(turn))
        object.__setattr__(self, "translation", vector3("translation", self.translation))

    @property
    def R(self) -> Array:
        """The rotation (3, 3)."""
        return np.asarray(self.rotation)

    @property
    def t(self) -> Vector:
        """The translation (3,) [m]."""
        return np.asarray(self.translation)

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
        return Pose(_orthonormal(self.R @ other.R), self.apply(other.t))

    def distance(self, other: Pose) -> tuple[float, float]:
        """Return how far apart two poses are: between the origins [m], and the angle of the turn between [rad]."""
        way = self.t - other.t
        return math.sqrt(float(way @ way)), float(np.linalg.norm(rotation_vector(self.R.T @ other.R)))

    def towards(self, other: Pose, share: float) -> Pose:
        """Return the pose at a share in [0, 1] of the way to another: straight, at a constant rate of turn."""
        turn = rotation_from(share * rotation_vector(self.R.T @ other.R))
        return Pose(_orthonormal(self.R @ turn), self.t + share * (other.t - self.t))


def looking_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike) -> Pose:
    """Return the pose of a camera in the frame that its arguments are given in: x right, y down, z forward.

    Args:
        eye: where it is, (3,) [m].
        target: point in the middle of its picture, (3,) [m].
        up: direction upwards in the picture, (3,), any length, not along the view.

    Raises:
        TaskError: eye and target coincide, or `up` is along the view.
    """
    at = vector3("eye", eye)
    forward = direction3("target - eye", vector3("target", target) - at)
    right = np.cross(forward, direction3("up", up))
    if math.sqrt(float(right @ right)) < 1e-6:
        raise TaskError(f"up = {up!r} is along the view: choose another direction for the picture's top")
    right = direction3("right", right)
    return Pose(np.stack([right, np.cross(forward, right), forward], axis=1), at)


def rotation_from(vector: ArrayLike) -> Array:
    """Return the rotation (3, 3) about `vector` (3,) by its length [rad]."""
    return np.asarray(pin.exp3(np.array(vector, dtype=np.float64)))


def rotation_vector(rotation: ArrayLike) -> Vector:
    """Return axis times angle (3,) [rad] of a rotation (3, 3), the angle in [0, pi]."""
    return np.asarray(pin.log3(np.array(rotation, dtype=np.float64)))


def _orthonormal(rotation: Array) -> Array:
    """Return the nearest rotation: a tracker multiplies poses for hours, and rounding adds up."""
    left, _, right = np.linalg.svd(rotation)
    return np.asarray(left @ right)
