"""Arms with a spherical shoulder and wrist, found from their joint axes, and their poses in closed form.

Joints 1 to 3 meet in the shoulder S, joints 3 to 5 in the elbow E, joints 5 to 7 in the wrist N, neighbouring
axes are at right angles, and the tool lies on axis 7. With tip and wrist given, the elbow turns on a circle about the
line S N by the arm angle (Kreutz-Delgado, Long and Seraji 1992), and the signs of joints 2, 4 and 6 (shoulder, elbow,
wrist) give eight poses for each place of the elbow. A change of sign turns a joint axis round and leaves the line it
lies on: all eight have the same J_T J_T^T, hence the same manipulability. Joint 7 moves neither tip nor wrist: idle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moc_opt.model.frames import link_frames
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array

EXACT_M = 1e-7
"""Axes that pass each other nearer than this meet [m]."""
BRANCHES = 8
"""Bit 0, 1, 2 of a branch's number: joint 2, 4, 6 is negative in the normal form."""


class Spherical(NamedTuple):
    """The normal form R = R_0 Rz(t1) Ry(t2) Rz(t3) Ry(t4) Rz(t5) Ry(t6) Rz(t7), t = q + offset, of such an arm."""

    base: Array
    """R_0 (3,3), columns: the axes of the normal form at the shoulder, in the world"""
    shoulder: Array
    """(3,) [m]"""
    upper: float
    """Shoulder to elbow along axis 3 [m]; negative where the axis points the other way."""
    fore: float
    """Elbow to wrist along axis 5 [m], likewise."""
    tool: float
    """Wrist to tip along axis 7 [m], likewise."""
    offset: Array
    """(6,) [rad]"""
    middle: Array
    """(6,) of the joint ranges [rad]"""
    half: Array
    """(6,) half the joint ranges [rad]"""


def spherical(robot: RobotModel) -> Spherical | None:
    """Find the normal form of an arm from its joint axes at q = 0; None where it has none, whatever its name.

    An arm with a joint range above a whole turn has none either: there a pose would not be one pose.
    """
    chain = robot.chain
    if robot.n != 7 or chain.prismatic.any():
        return None
    origins, rotations = (frames[0] for frames in link_frames(chain, np.zeros((1, 7))))
    axes = np.einsum("jab,jb->ja", rotations, chain.axes)
    if np.abs((axes[:-1] * axes[1:]).sum(axis=1)).max() > EXACT_M:
        return None
    tip, wrist = (origins[6] + rotations[6] @ offset for offset in chain.offsets)
    shoulder, elbow, center = (_meeting(origins, axes, i) for i in (0, 2, 4))
    through = [(shoulder, 1), (shoulder, 2), (elbow, 3), (elbow, 4), (center, 5), (center, 6)]
    off = [_from_line(point, origins[j], axes[j]) for point, j in through]
    off += [float(np.linalg.norm(wrist - center)), _from_line(tip, origins[6], axes[6])]
    half = 0.5 * (robot.q_max - robot.q_min)[:6]
    upper, fore = float((elbow - shoulder) @ axes[2]), float((center - elbow) @ axes[4])
    if max(off) > EXACT_M or min(abs(upper), abs(fore)) < EXACT_M or half.max() > np.pi:
        return None
    base = np.column_stack([np.cross(axes[1], axes[0]), axes[1], axes[0]])
    offset, turned = np.zeros(6), np.array(base)
    for j in range(1, 6):  # the angle at which the normal form has axis j + 1 where the arm has it at q = 0
        x, y, z = turned.T @ axes[j + 1]
        offset[j] = np.arctan2(x, z) if j % 2 else np.arctan2(-x, y)
        turned = turned @ _turn(1 if j % 2 else 2, offset[j])
    middle = 0.5 * (robot.q_max + robot.q_min)[:6]
    return Spherical(base, shoulder, upper, fore, float((tip - center) @ axes[6]), offset, middle=middle, half=half)


def branch_of(arm: Spherical, q: Array) -> int:
    """Return the branch of a pose (7,) [rad]."""
    angles = np.sin((q[:6] + arm.offset)[[1, 3, 5]])
    return int(sum(1 << bit for bit, sine in enumerate(angles) if sine < 0.0))


def _meeting(origins: Array, axes: Array, j: int) -> Array:
    """Return the point of axis j nearest to axis j + 1, which is at a right angle to it."""
    point: Array = origins[j] + axes[j] * ((origins[j + 1] - origins[j]) @ axes[j])
    return point


def _from_line(point: Array, on: Array, along: Array) -> float:
    return float(np.linalg.norm(np.cross(point - on, along)))


def _turn(axis: int, angle: float) -> Array:
    """Return the rotation about y (1) or z (2)."""
    c, s = np.cos(angle), np.sin(angle)
    if axis == 1:
        return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
