"""The swivel of the elbow: one angle for the one freedom that tip and wrist leave to an arm.

It is the angle of the elbow about the line from the shoulder to the wrist centre, counted from the plane through
that line and a fixed direction (Kreutz-Delgado, Long and Seraji 1992). It depends on the pose alone, and
continuously, so that poses of different times and runs can be compared.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from moc_opt.arrays import Array
from moc_opt.robots.chain import link_frames
from moc_opt.robots.inverse_kinematics import nearest_pose
from moc_opt.robots.model import RobotModel

NO_LIMIT_RAD = 20.0
REACHED_M = 1e-9


class Elbow:
    """The swivel angle of an arm: second joint, elbow and wrist centre span the plane that turns."""

    def __init__(self, robot: RobotModel, wrists: Array) -> None:
        """Choose elbow and reference direction for the wrist centres (k, 3) [m] that will occur."""
        self._chain = robot.chain
        origins, _ = link_frames(robot.chain, robot.data.q_home[None])
        # Second of the joints that turn: a rail carries the shoulder.
        self._shoulder = min(int(np.argmin(robot.chain.prismatic)) + 1, robot.n - 1)
        shoulder, wrist = origins[0, self._shoulder], robot.state(robot.data.q_home).wrist
        away = np.linalg.norm(np.cross(origins[0] - shoulder, _unit(wrist - shoulder)), axis=1)
        self.joint = self._shoulder + int(np.argmax(away[self._shoulder :]))
        # The direction that the shoulder-wrist line stays farthest from: upwards, unless the arm does.
        lines = _unit(wrists - shoulder)
        sideways = np.sqrt(1.0 - lines**2).min(axis=0)
        axis = 2 if sideways[2] > 0.3 else int(np.argmax(sideways))
        self.reference = np.eye(3)[axis]  #: (3,) unit vector towards which the elbow lies at swivel zero

    def swivel(self, q: Array) -> Array:
        """Return the swivels (k,) [rad] in (-pi, pi], of poses (k, n)."""
        origins, rotations = link_frames(self._chain, q)
        shoulder, elbow = origins[:, self._shoulder], origins[:, self.joint]
        wrist = origins[:, -1] + rotations[:, -1] @ self._chain.offsets[1]
        line, out = _unit(wrist - shoulder), elbow - shoulder
        side = np.cross(line, self.reference)
        return np.asarray(np.arctan2((out * side).sum(axis=1), (out * np.cross(side, line)).sum(axis=1)))


def reach(robot: RobotModel, q: Array, tip: Array, wrist: Array) -> Array | None:
    """Return a pose near q with that tip and wrist, whatever the limits, by Newton's method; None: it finds none."""
    anywhere = np.full(robot.n, np.inf)
    pose, miss = nearest_pose(robot, q, np.array([tip, wrist]), -anywhere, anywhere, 30)
    return pose if miss < REACHED_M else None


def without_limits(robot: RobotModel) -> RobotModel:
    """Return the same arm, its revolute joints free to turn."""
    slides, data = robot.chain.prismatic, robot.data
    low, high = np.where(slides, data.q_min, -NO_LIMIT_RAD), np.where(slides, data.q_max, NO_LIMIT_RAD)
    return RobotModel(replace(data, q_min=low, q_max=high))


def wrapped(angles: Array) -> Array:
    """Return the same angles in [-pi, pi)."""
    return np.asarray(np.mod(angles + np.pi, 2.0 * np.pi) - np.pi)


def nearest_turns(robot: RobotModel, q: Array) -> Array:
    """Return the same poses, every revolute joint whole turns nearer to the middle of its range."""
    turns = np.round((q - 0.5 * (robot.q_min + robot.q_max)) / (2.0 * np.pi))
    return q - 2.0 * np.pi * np.where(robot.chain.prismatic, 0.0, turns)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
