"""Where the tool begins, which way it points, and which point of its shaft is used as wrist."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from moc_opt.commissioning.vendor import rpy_of
from moc_opt.errors import RobotError
from moc_opt.numerics.arrays import Array

_SAME = 1e-6


class Shaft(NamedTuple):
    """In the frame of the last link."""

    wrist: Array
    """(3,) [m]"""
    mount: Array
    """(3,) [m]; the link's own origin, put onto the last axis where it is on it but for rounding"""
    rpy: tuple[float, float, float]
    """Turns z of the link into the tool's direction [rad]."""
    behind_m: float
    """From wrist point to mount [m]."""
    note: str


def find_shaft(text: str, last_link: str, *, wrist_m: float | None = None) -> Shaft:
    """Lay the tool along the last turning axis, away from the arm, from the last link's origin.

    The wrist point is the point of the shaft nearest to the axis before it: where they cross on a spherical wrist.
    Where the last joint slides, the tool runs along z of the last link and the wrist point is its origin.

    Args:
        text: a clean URDF.
        last_link: the link that carries the tool.
        wrist_m: distance from wrist point to mount along the shaft [m], in place of the one found.

    Raises:
        RobotError: ``wrist_m`` is negative.
    """
    if wrist_m is not None and not 0.0 <= wrist_m < 10.0:
        raise RobotError(f"--wrist {wrist_m:g}: give the distance from wrist point to mount, 0 to 10 m")
    model = pin.buildModelFromXML(text)
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    pin.updateFramePlacements(model, data)
    place = data.oMf[model.getFrameId(last_link, pin.FrameType.BODY)]
    origin = place.translation.copy()
    lines = [_line(data, j) for j in range(1, model.njoints)]
    turning = [line for line in lines if line is not None]
    if lines[-1] is None or not turning:
        direction, foot = place.rotation[:, 2], origin
        note = "the last joint slides: the tool runs along z of the last link"
    else:
        (point, axis), before = turning[-1], turning[:-1]
        crossing = next((line for line in reversed(before) if np.linalg.norm(np.cross(line[1], axis)) > 1e-3), None)
        foot = origin if crossing is None else _foot(point, axis, *crossing)
        ahead = float(axis @ (origin - foot))
        if abs(ahead) < 1e-4:  # the flange stands on the crossing: z of the link decides
            along = float(axis @ place.rotation[:, 2])
            ahead = along if abs(along) > 0.5 else 1.0
        note = "the tool runs along the last axis"
        on_axis = point + (origin - point) @ axis * axis
        if np.linalg.norm(origin - on_axis) < _SAME:
            origin = on_axis
        else:
            note = "the last link is off the last axis: the tool runs parallel to it, and no joint is idle"
        direction = np.sign(ahead) * axis
        foot = origin + (foot - origin) @ direction * direction
    behind = float((origin - foot) @ direction)
    if wrist_m is not None:
        behind = wrist_m
    elif behind < _SAME:
        behind, note = 0.0, f"{note}; the wrist point is the mount"
    else:
        note = f"{note}; the wrist point, {behind:.4g} m behind the mount, is the nearest to the axis before it"
    down = place.rotation.T @ direction
    mount = _tidy(place.rotation.T @ (origin - place.translation))
    return Shaft(_tidy(mount - behind * down), mount, _towards(down), behind, note)


def _tidy(point: Array) -> Array:
    """Return zeros in the place of rounding errors."""
    return np.where(np.abs(point) < 1e-15, 0.0, point)


def _line(data: pin.Data, j: int) -> tuple[Array, Array] | None:
    """Return a point on joint j's axis and its direction, in the world; None where it slides."""
    axis = data.J.reshape(6, -1)[3:, j - 1].copy()  # of one joint pinocchio gives a vector
    return None if np.linalg.norm(axis) < 0.5 else (data.oMi[j].translation.copy(), axis)


def _foot(point: Array, axis: Array, other: Array, direction: Array) -> Array:
    """Return the point of the first line that is nearest to the second one; they are not parallel."""
    b, gap = float(axis @ direction), other - point
    s = (gap @ axis - b * (gap @ direction)) / (1.0 - b * b)
    nearest: Array = point + s * axis
    return nearest


def _towards(direction: Array) -> tuple[float, float, float]:
    """Return roll, pitch, yaw of a rotation whose third column is ``direction``, the one that turns least."""
    if np.hypot(direction[0], direction[1]) < 1e-14:  # a tilt of 1e-9 rad would wake an idle joint
        return (0.0, 0.0, 0.0) if direction[2] > 0.0 else (float(np.pi), 0.0, 0.0)
    z = np.array([0.0, 0.0, 1.0])
    axis = np.cross(z, direction)
    angle = float(np.arctan2(np.linalg.norm(axis), direction[2]))
    return rpy_of(pin.AngleAxis(angle, axis / np.linalg.norm(axis)).toRotationMatrix())
