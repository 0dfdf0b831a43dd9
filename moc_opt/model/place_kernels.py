"""Forward kinematics, compiled: where joints, points of the last link and the tool are."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit


class ToolPlace(NamedTuple):
    """Where an arm carries its tool, as `tool_pose` takes it."""

    joints: Array
    """(n,16) as in `Chain.joints`"""
    mount: Array
    """(3,3) rows: the tool's axes in the last joint's frame"""
    tip: Array
    """(3,) the tip in that frame [m]"""


@njit(cache=True)
def point_in_world(rotation_t: Array, origin: Array, local: Array, out: Array) -> None:
    """Compute out = origin + R local; the rotation comes transposed, as pinocchio stores it by columns."""
    for i in range(3):
        out[i] = origin[i] + rotation_t[0, i] * local[0] + rotation_t[1, i] * local[1] + rotation_t[2, i] * local[2]


@njit(cache=True)
def place_joints(joints: Array, q: Array, places: Array) -> None:
    """Write every joint's frame in the world: forward kinematics.

    Args:
        joints: (n,16) as in `Chain.joints`.
        q: (n,).
        places: (n,12) written: the rotation by columns, then the origin.
    """
    for j in range(q.shape[0]):
        for i in range(3):  # as it stands at q_j = 0
            if j == 0:
                x, y, z = (1.0 if i == 0 else 0.0), (1.0 if i == 1 else 0.0), (1.0 if i == 2 else 0.0)
                before = 0.0
            else:
                x, y, z = places[j - 1, i], places[j - 1, 3 + i], places[j - 1, 6 + i]
                before = places[j - 1, 9 + i]
            for c in range(3):
                places[j, 3 * c + i] = x * joints[j, c] + y * joints[j, 3 + c] + z * joints[j, 6 + c]
            places[j, 9 + i] = before + x * joints[j, 9] + y * joints[j, 10] + z * joints[j, 11]
        a, b, d = joints[j, 12], joints[j, 13], joints[j, 14]
        ax = places[j, 0] * a + places[j, 3] * b + places[j, 6] * d
        ay = places[j, 1] * a + places[j, 4] * b + places[j, 7] * d
        az = places[j, 2] * a + places[j, 5] * b + places[j, 8] * d
        if joints[j, 15] > 0.0:
            places[j, 9] += ax * q[j]
            places[j, 10] += ay * q[j]
            places[j, 11] += az * q[j]
            continue
        cos, sin = math.cos(q[j]), math.sin(q[j])
        for c in range(3):  # Rodrigues' formula on each column of the rotation
            x, y, z = places[j, 3 * c], places[j, 3 * c + 1], places[j, 3 * c + 2]
            along = (1.0 - cos) * (ax * x + ay * y + az * z)
            places[j, 3 * c] = cos * x + sin * (ay * z - az * y) + along * ax
            places[j, 3 * c + 1] = cos * y + sin * (az * x - ax * z) + along * ay
            places[j, 3 * c + 2] = cos * z + sin * (ax * y - ay * x) + along * az


@njit(cache=True)
def spatial_axes(joints: Array, places: Array, axes: Array) -> None:
    """Write the spatial axes (n,6) of `kinematics_kernels` from the frames (n,12) that `place_joints` wrote."""
    for j in range(places.shape[0]):
        place, joint = places[j], joints[j]
        for i in range(3):  # the joint's axis in the world
            axes[j, i] = place[i] * joint[12] + place[3 + i] * joint[13] + place[6 + i] * joint[14]
            axes[j, 3 + i] = 0.0
        if joint[15] == 0.0:
            ax, ay, az = axes[j, 0], axes[j, 1], axes[j, 2]
            # Linear velocity of the world origin for a turn about an axis through the joint's.
            axes[j, 0] = place[10] * az - place[11] * ay
            axes[j, 1] = place[11] * ax - place[9] * az
            axes[j, 2] = place[9] * ay - place[10] * ax
            axes[j, 3], axes[j, 4], axes[j, 5] = ax, ay, az


@njit(cache=True)
def tool_pose(joints: Array, q: Array, mount: Array, tip: Array, pose: Array) -> None:
    """Write the tool's axes and tip, (4,3) rows x, y, z, X in world axes.

    Args:
        joints, q: as in `place_joints`.
        mount: (3,3) rows: the tool's axes in that frame.
        tip: (3,) the tip in that frame [m].
        pose: (4,3) written.
    """
    n = q.shape[0]
    places = np.empty((n, 12))
    place_joints(joints, q, places)
    place = places[n - 1]
    rotation_t = place[:9].reshape((3, 3))
    for k in range(3):
        for i in range(3):
            pose[k, i] = (
                rotation_t[0, i] * mount[k, 0] + rotation_t[1, i] * mount[k, 1] + rotation_t[2, i] * mount[k, 2]
            )
    point_in_world(rotation_t, place[9:], tip, pose[3])


@njit(cache=True, nogil=True)
def points_along(joints: Array, poses: Array, offsets: Array, points: Array) -> None:
    """Write where points of the last link are at many poses.

    Args:
        joints: as in `place_joints`.
        poses: (k,n).
        offsets: (m,3) points in the last joint's frame [m].
        points: (m,k,3) written, world axes [m].
    """
    n = poses.shape[1]
    places = np.empty((n, 12))
    for k in range(poses.shape[0]):
        place_joints(joints, poses[k], places)
        for i in range(offsets.shape[0]):
            point_in_world(places[n - 1, :9].reshape((3, 3)), places[n - 1, 9:], offsets[i], points[i, k])
