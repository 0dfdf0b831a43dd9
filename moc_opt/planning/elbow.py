"""The elbow's swivel angle (Kreutz-Delgado, Long and Seraji 1992), and the distance to the local maximum of mu."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.arrays import Array
from moc_opt.planning.self_motion import SelfMotion, curve_through, parabola_peak
from moc_opt.robots.model import RobotModel, link_frames

NEAR_RAD = 0.1  #: Below this distance to the local maximum of mu, the elbow counts as arrived.
STILL_RAD_PER_S = 0.05  #: Below this rate of change of that distance, the elbow counts as resting.
SAMPLES_PER_S = 25.0  #: Scans of the self-motion per second of a run.
STEP_RAD = 0.1  #: Spacing of the samples of a self-motion.
WINDOW_S = 0.1  #: Time over which the rate of change is averaged.


class Elbow:
    """Measures the swivel angle of an arm."""

    def __init__(self, robot: RobotModel, wrists: Array) -> None:
        """Choose elbow joint and reference direction for the wrist centres (k, 3) [m]."""
        self._robot = robot
        origins, _ = link_frames(robot, robot.data.q_home[None])
        # The shoulder is the joint after the first joint that turns.
        self._shoulder = min(int(np.argmin(robot.chain.prismatic)) + 1, robot.n - 1)
        shoulder, wrist = origins[0, self._shoulder], robot.state(robot.data.q_home).wrist
        away = np.linalg.norm(np.cross(origins[0] - shoulder, _unit(wrist - shoulder)), axis=1)
        self.joint = self._shoulder + int(np.argmax(away[self._shoulder :]))
        # The reference points up, unless the line from shoulder to wrist is nearly vertical.
        sideways = np.sqrt(1.0 - _unit(wrists - shoulder) ** 2).min(axis=0)
        axis = 2 if sideways[2] > 0.3 else int(np.argmax(sideways))
        self.reference = np.eye(3)[axis]  #: (3,) unit vector towards the elbow at swivel zero

    def swivel(self, q: Array) -> Array:
        """Return the swivels (k,) [rad], in (-pi, pi], of poses (k, n)."""
        origins, rotations = link_frames(self._robot, q)
        shoulder, elbow = origins[:, self._shoulder], origins[:, self.joint]
        wrist = origins[:, -1] + rotations[:, -1] @ self._robot.chain.offsets[1]
        line, out = _unit(wrist - shoulder), elbow - shoulder
        side = np.cross(line, self.reference)
        return np.asarray(np.arctan2((out * side).sum(axis=1), (out * np.cross(side, line)).sum(axis=1)))


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def wrapped(angles: Array) -> Array:
    """Wrap angles [rad] into [-pi, pi)."""
    return np.asarray(angles - 2.0 * np.pi * np.floor(angles / (2.0 * np.pi) + 0.5))


def distance_to_go(robot: RobotModel, q: ArrayLike) -> Array:
    """Return the distance (k,) [rad] along the self-motion from each pose (k, n) to the local maximum of mu.

    It is NaN at a singular pose.
    """
    poses = np.clip(np.asarray(q, dtype=np.float64), robot.q_min, robot.q_max)
    curves = (curve_through(robot, pose, STEP_RAD) for pose in poses)
    return np.array([np.nan if curve is None else _uphill(curve) for curve in curves])


def _uphill(curve: SelfMotion) -> float:
    s, mu, i = curve.s, np.pad(curve.mu, 1, constant_values=-np.inf), 1 + int(np.argmin(np.abs(curve.s)))
    side = 1 if mu[i + 1] >= mu[i - 1] else -1
    while mu[i + side] > mu[i]:
        i += side
    inside = 1 < i < len(s)  # else the maximum is at a joint limit
    return abs(float(s[i - 1]) + (parabola_peak(s[i - 2 : i + 1], mu[i - 1 : i + 2])[0] if inside else 0.0))


def in_transient(robot: RobotModel, t_s: ArrayLike, q_rad: ArrayLike) -> NDArray[np.bool_]:
    """Return for each time t_s (N,) whether the elbow moves and is away from the local maximum of mu.

    ``q_rad`` (N, n) are the true joint positions at these times.
    """
    t, q = np.asarray(t_s, dtype=np.float64), np.asarray(q_rad, dtype=np.float64)
    count = max(2, int(np.ceil((t[-1] - t[0]) * SAMPLES_PER_S)) + 1)
    ticks = np.unique(np.linspace(0, len(t) - 1, min(count, len(t))).round().astype(int))
    distance = distance_to_go(robot, q[ticks])
    known = np.isfinite(distance)
    if known.sum() < 2:
        return np.zeros(len(t), dtype=np.bool_)
    at, distance = t[ticks][known], distance[known]
    ahead, behind = np.minimum(t + 0.5 * WINDOW_S, t[-1]), np.maximum(t - 0.5 * WINDOW_S, t[0])
    speed = np.abs(np.interp(ahead, at, distance) - np.interp(behind, at, distance)) / (ahead - behind)
    return np.asarray((speed > STILL_RAD_PER_S) & (np.interp(t, at, distance) > NEAR_RAD))
