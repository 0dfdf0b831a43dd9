"""The elbow's swivel: its angle, its distance to the maximum of mu that a climb reaches, and when it moves.

The swivel is the angle of the elbow about the line from the shoulder to the wrist centre, counted from the plane
through that line and a fixed direction (Kreutz-Delgado, Long and Seraji 1992).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.arrays import Array
from moc_opt.planning.self_motion import SelfMotion, curve_through, parabola_peak
from moc_opt.robots.model import RobotModel, link_frames

NEAR_RAD = 0.1  #: An elbow this near to its optimum has arrived; on the LWR4+, mu is then within 0.5 % of the best.
STILL_RAD_PER_S = 0.05  #: An elbow is at rest if its distance to the optimum changes more slowly; moving: 0.3 to 0.8.
SAMPLES_PER_S = 25.0  #: How often the self-motion is scanned along a run.
STEP_RAD = 0.1  #: Spacing of the samples of a self-motion.
WINDOW_S = 0.1  #: The elbow's speed is the mean rate, over this time, at which its distance to the optimum changes.


class Elbow:
    """The swivel angle of an arm: the angle of the plane through second joint (shoulder), elbow, wrist centre."""

    def __init__(self, robot: RobotModel, wrists: Array) -> None:
        """Choose elbow and reference direction for the wrist centres (k, 3) [m] that will occur."""
        self._robot = robot
        origins, _ = link_frames(robot, robot.data.q_home[None])
        # The second joint that turns: sliding joints before it (a rail) carry the shoulder.
        self._shoulder = min(int(np.argmin(robot.chain.prismatic)) + 1, robot.n - 1)
        shoulder, wrist = origins[0, self._shoulder], robot.state(robot.data.q_home).wrist
        away = np.linalg.norm(np.cross(origins[0] - shoulder, _unit(wrist - shoulder)), axis=1)
        self.joint = self._shoulder + int(np.argmax(away[self._shoulder :]))
        # The reference must not lie along the shoulder-wrist line: it points up, unless that line is nearly vertical.
        sideways = np.sqrt(1.0 - _unit(wrists - shoulder) ** 2).min(axis=0)
        axis = 2 if sideways[2] > 0.3 else int(np.argmax(sideways))
        self.reference = np.eye(3)[axis]  #: (3,) unit vector towards which the elbow lies at swivel zero

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
    """Return the same angles [rad] in [-pi, pi)."""
    return np.asarray(angles - 2.0 * np.pi * np.floor(angles / (2.0 * np.pi) + 0.5))


def distance_to_go(robot: RobotModel, q: ArrayLike) -> Array:
    """Return the distance to go (k,) [rad] at poses q (k, n) [rad].

    It is the arc length, of the joints that move tip or wrist, to the maximum of mu that a climb reaches. A parabola
    refines the maximum between samples. It is NaN where a pose is singular, as no single curve leads through that pose.
    A pose beyond a limit is first moved to the limit.
    """
    poses = np.clip(np.asarray(q, dtype=np.float64), robot.q_min, robot.q_max)
    curves = (curve_through(robot, pose, STEP_RAD) for pose in poses)
    return np.array([np.nan if curve is None else _uphill(curve) for curve in curves])


def _uphill(curve: SelfMotion) -> float:
    s, mu, i = curve.s, np.pad(curve.mu, 1, constant_values=-np.inf), 1 + int(np.argmin(np.abs(curve.s)))
    side = 1 if mu[i + 1] >= mu[i - 1] else -1
    while mu[i + side] > mu[i]:
        i += side
    inside = 1 < i < len(s)  # at a joint limit the maximum is the last sample
    return abs(float(s[i - 1]) + (parabola_peak(s[i - 2 : i + 1], mu[i - 1 : i + 2])[0] if inside else 0.0))


def in_transient(robot: RobotModel, t_s: ArrayLike, q_rad: ArrayLike) -> NDArray[np.bool_]:
    """Detect the ticks (N,) at which the elbow is still moving: neither at its optimum, nor at rest.

    An elbow that keeps up with its optimum does not count, however fast both move along the path: its distance to go
    is constant.

    Args:
        t_s, q_rad: (N,) time of each tick [s], (N, n) true joint positions [rad].
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
