"""The swivel of the elbow: one angle for the one freedom that tip and wrist leave to an arm.

It is the angle of the elbow about the line from the shoulder to the wrist centre, counted from the plane through
that line and a fixed direction (Kreutz-Delgado, Long and Seraji 1992). It depends on the pose alone, and
continuously, so that poses of different times and runs can be compared.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from moc_opt.errors import RobotError
from moc_opt.model.frames import link_frames
from moc_opt.model.inverse_kinematics import nearest_pose
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.redundancy.self_motion import SelfMotion

NO_LIMIT_RAD = 20.0
REACHED_M = 1e-9


class Elbow:
    """The swivel angle of an arm: second joint, elbow and wrist centre span the plane that turns."""

    def __init__(self, robot: RobotModel, wrists: Array) -> None:
        """Choose elbow and reference direction.

        Args:
            wrists: (k, 3) the wrist centres that will occur [m].
        """
        self._chain = robot.chain
        origins, _ = link_frames(robot.chain, robot.data.q_home[None])
        # Second of the joints that turn: a rail carries the shoulder.
        self._shoulder = min(int(np.argmin(robot.chain.prismatic)) + 1, robot.n - 1)
        shoulder, wrist = origins[0, self._shoulder], robot.state(robot.data.q_home).wrist
        away = np.linalg.norm(np.cross(origins[0] - shoulder, unit(wrist - shoulder)), axis=1)
        self.joint = self._shoulder + int(np.argmax(away[self._shoulder :]))
        # The direction that the shoulder-wrist line stays farthest from: upwards, unless the arm does.
        lines = unit(wrists - shoulder)
        sideways = np.sqrt(1.0 - lines**2).min(axis=0)
        axis = 2 if sideways[2] > 0.3 else int(np.argmax(sideways))
        self._reference = np.eye(3)[axis]

    @property
    def reference(self) -> Array:
        """(3,) unit vector towards which the elbow lies at swivel zero."""
        return self._reference

    def swivel(self, q: Array) -> Array:
        """Return the swivels (k,) [rad] in (-pi, pi], of poses (k, n)."""
        origins, rotations = link_frames(self._chain, q)
        shoulder, elbow = origins[:, self._shoulder], origins[:, self.joint]
        wrist = origins[:, -1] + rotations[:, -1] @ self._chain.offsets[1]
        line = unit(wrist - shoulder)
        side = np.cross(line, self._reference)
        out = elbow - shoulder
        angles: Array = np.arctan2((out * side).sum(axis=1), (out * np.cross(side, line)).sum(axis=1))
        return angles

    def direction(self, q: Array) -> Array:
        """Return the unit vector (3,) along which the elbow at q (n,) moves as its swivel grows, all else at rest."""
        origins, rotations = link_frames(self._chain, q[None])
        shoulder, elbow = origins[0, self._shoulder], origins[0, self.joint]
        wrist = origins[0, -1] + rotations[0, -1] @ self._chain.offsets[1]
        return unit(np.cross(wrist - shoulder, elbow - shoulder))


class SwivelCurve:
    """One self-motion, addressed by swivel.

    Raises:
        RobotError: the swivel does not grow or fall steadily along it.
    """

    def __init__(self, curve: SelfMotion, elbow: Elbow) -> None:
        self._curve, self._elbow = curve, elbow
        self._angles = np.unwrap(elbow.swivel(curve.q))
        steps = np.diff(self._angles)
        if not (np.all(steps > 0.0) or np.all(steps < 0.0)):
            raise RobotError(
                "the arm's elbow goes to and fro on its self-motion, so no swivel angle tells its poses apart: "
                "the map is for arms whose shoulder, elbow and wrist form a triangle"
            )
        self._sign = 1.0 if len(steps) and steps[0] > 0.0 else -1.0
        self._along = (curve.s - curve.s[0]) / max(curve.s[-1] - curve.s[0], 1e-300)

    def poses(self, swivels: Array) -> Array:
        """Return the poses (m, n) at swivels (m,); NaN where the curve has none."""
        start = self._angles[0]
        turned = start + self._sign * np.mod(self._sign * (swivels - start), 2.0 * np.pi)
        known = self._sign * (self._angles[-1] - turned) >= 0.0
        found = np.full((len(swivels), self._curve.q.shape[1]), np.nan)
        desired, aim = turned[known], turned[known]
        poses = found[known]
        for _ in range(3):  # the spline between samples is straight: correct by the remaining error
            fractions = np.interp(self._sign * np.asarray(aim), self._sign * self._angles, self._along)
            poses = np.array([self._curve.at(float(f)) for f in fractions]).reshape(poses.shape)
            missed = desired - self._elbow.swivel(poses)
            aim = aim + np.mod(missed + np.pi, 2.0 * np.pi) - np.pi
        found[known] = poses
        return found


def reach(robot: RobotModel, q: Array, tip: Array, wrist: Array) -> Array | None:
    """Return a pose near q with that tip and wrist, whatever the limits, by Newton's method; None: it finds none."""
    anywhere = np.full(robot.n, np.inf)
    pose, miss = nearest_pose(robot, q, np.array([tip, wrist]), -anywhere, anywhere, 30)
    return pose if miss < REACHED_M else None


def without_limits(robot: RobotModel) -> RobotModel:
    """Return the same arm, its revolute joints free to turn."""
    slides, data = robot.chain.prismatic, robot.data
    low, high = (
        np.where(slides, limit, turn)
        for limit, turn in ((data.q_min, -NO_LIMIT_RAD), (data.q_max, NO_LIMIT_RAD))
    )
    return RobotModel(replace(data, q_min=low, q_max=high))


def nearest_turns(robot: RobotModel, q: Array) -> Array:
    """Return the same poses, every revolute joint whole turns nearer to the middle of its range."""
    turns = np.round((q - 0.5 * (robot.q_min + robot.q_max)) / (2.0 * np.pi))
    return q - 2.0 * np.pi * np.where(robot.chain.prismatic, 0.0, turns)


def unit(vectors: Array) -> Array:
    """Return vectors (..., 3) at length one."""
    lengths: Array = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / lengths
