"""The ticks at which the elbow is moving towards its optimum, found from the poses afterwards.

At each sample the self-motion through the pose is scanned, up to the maximum of mu uphill of the pose: the place to
which a gradient leads. The arc length in joint space to it (idle joints left out) is the elbow's distance to go. While
the elbow follows the optimum that the path carries along, that distance stands still, however fast both move. So the
elbow is in its transient while it is neither there nor at rest relative to its optimum.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.arrays import Array
from moc_opt.errors import RobotError
from moc_opt.planning.self_motion import SelfMotion, parabola_peak, self_motion
from moc_opt.robots.model import RobotModel


def uphill(curve: SelfMotion) -> tuple[float, float]:
    """Return the arc length [rad] from the scan's pose (s = 0) to the local maximum of mu uphill of it, and mu there.

    The maximum is refined by a parabola between the samples; at a joint limit it is the last sample.
    """
    s, mu, i = curve.s, np.pad(curve.mu, 1, constant_values=-np.inf), 1 + int(np.argmin(np.abs(curve.s)))
    side = 1 if mu[i + 1] >= mu[i - 1] else -1
    while mu[i + side] > mu[i]:
        i += side
    if not 1 < i < len(s):
        return abs(float(s[i - 1])), float(mu[i])
    step, height = parabola_peak(s[i - 2 : i + 1], mu[i - 1 : i + 2])
    return abs(float(s[i - 1]) + step), float(mu[i] + height)


def distance_to_go(robot: RobotModel, q: ArrayLike, step: float = 0.1) -> tuple[Array, Array]:
    """Return the distance to go (k,) [rad] and the mu that waits there (k,) [m^3], for poses q (k, n) [rad].

    NaN where a pose is singular: no single curve leads through it. A pose beyond a limit is taken at the limit.
    """
    poses = np.clip(np.asarray(q, dtype=np.float64), robot.q_min, robot.q_max)
    found = np.full((2, len(poses)), np.nan)
    for k, pose in enumerate(poses):
        try:
            found[:, k] = uphill(self_motion(robot, pose, step))
        except RobotError:
            continue  # stays NaN, as documented
    return found[0], found[1]


def in_transient(
    robot: RobotModel, t_s: ArrayLike, q_rad: ArrayLike, *, samples_per_s: float = 25.0, window_s: float = 0.1,
    near_rad: float = 0.1, still_rad_per_s: float = 0.05,
) -> NDArray[np.bool_]:  # fmt: skip
    """Return (N,) flags: the elbow is away from its moving optimum, and moves relative to it.

    Args:
        t_s: (N,) time of each tick [s].
        q_rad: (N, n) true joint positions [rad].
        samples_per_s: how often the self-motion is scanned [1/s].
        window_s: the speed is the change of the distance to go over this time [s].
        near_rad: nearer to its optimum than this it has arrived [rad]. Near a maximum that costs less than
            half a percent of mu on the LWR4+.
        still_rad_per_s: an elbow that moves slower than this relative to its optimum is stuck or held, not
            in a transient [rad/s]. On its way it does 0.3 to 0.8 rad/s.

    Raises:
        RobotError: no ticks, or poses of another arm.
    """
    t, q = np.asarray(t_s, dtype=np.float64), np.asarray(q_rad, dtype=np.float64)
    if len(t) == 0 or q.shape != (len(t), robot.n):
        raise RobotError(f"t_s has {len(t)} ticks, q_rad shape {q.shape}: give (N,) and (N, {robot.n}), N > 0")
    count = max(2, int(np.ceil((t[-1] - t[0]) * samples_per_s)) + 1)
    ticks = np.unique(np.linspace(0, len(t) - 1, min(count, len(t))).round().astype(int))
    distance, _ = distance_to_go(robot, q[ticks])
    known = np.isfinite(distance)
    if known.sum() < 2:
        return np.zeros(len(t), dtype=np.bool_)
    at, distance = t[ticks][known], distance[known]
    ahead, behind = np.minimum(t + 0.5 * window_s, t[-1]), np.maximum(t - 0.5 * window_s, t[0])
    speed = np.abs(np.interp(ahead, at, distance) - np.interp(behind, at, distance)) / (ahead - behind)
    return np.asarray((speed > still_rad_per_s) & (np.interp(t, at, distance) > near_rad))
