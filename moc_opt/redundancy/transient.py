"""When the elbow is on its way: the ticks at which it moves towards its optimum, told from the poses afterwards.

At each sample the self-motion through the pose is scanned and the maximum of mu uphill of the pose is found: the
place to which a gradient leads. The arc length in joint space from the pose to it (idle joints left out) is the
elbow's distance to go. While the elbow follows the optimum that the path carries along, that distance stands
still, however fast both move. So the elbow is in its transient while it is neither there (the distance is above a
tolerance) nor at rest relative to its optimum (the distance changes faster than a tolerance).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import RobotError
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.redundancy.self_motion import SelfMotion, parabola_peak, self_motion

Flags = NDArray[np.bool_]

SAMPLES_PER_S = 25.0
WINDOW_S = 0.1
NEAR_RAD = 0.1
STILL_RAD_PER_S = 0.05


def uphill(curve: SelfMotion) -> tuple[float, float]:
    """Return the arc length [rad] from the scan's pose (s = 0) to the local maximum of mu uphill of it, and mu there.

    The maximum is refined by a parabola between the samples; at a joint limit it is the last sample.
    """
    s, mu = curve.s, curve.mu
    i = int(np.argmin(np.abs(s)))
    back, ahead = (mu[i - 1] if i > 0 else -np.inf), (mu[i + 1] if i + 1 < len(mu) else -np.inf)
    side = 1 if ahead >= back else -1
    while 0 <= i + side < len(mu) and mu[i + side] > mu[i]:
        i += side
    if not 0 < i < len(mu) - 1:
        return abs(float(s[i])), float(mu[i])
    step, height = parabola_peak(s[i - 1 : i + 2], mu[i - 1 : i + 2])
    return abs(float(s[i]) + step), float(mu[i] + height)


def distance_to_go(robot: RobotModel, q: ArrayLike, step: float = 0.1) -> tuple[Array, Array]:
    """Return the distance to go (k,) [rad] and the mu that waits there (k,) [m^3], for poses q (k, n) [rad].

    NaN where a pose is singular: no single curve leads through it. Poses beyond a joint limit by the
    encoder's or the plant's softness are taken at the limit.
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
    robot: RobotModel,
    t_s: ArrayLike,
    q_rad: ArrayLike,
    *,
    samples_per_s: float = SAMPLES_PER_S,
    window_s: float = WINDOW_S,
    near_rad: float = NEAR_RAD,
    still_rad_per_s: float = STILL_RAD_PER_S,
) -> Flags:
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
        RobotError: no ticks, or a setting that is not positive.
    """
    t, q = np.asarray(t_s, dtype=np.float64), np.asarray(q_rad, dtype=np.float64)
    if not min(samples_per_s, window_s, near_rad, still_rad_per_s) > 0.0:
        raise RobotError(
            f"samples_per_s = {samples_per_s}, window_s = {window_s}, near_rad = {near_rad}, "
            f"still_rad_per_s = {still_rad_per_s}: all must be positive"
        )
    if len(t) == 0 or q.shape != (len(t), robot.n):
        raise RobotError(
            f"t_s has {len(t)} ticks, q_rad shape {q.shape}: give (N,) and (N, {robot.n}), N > 0"
        )
    count = max(2, int(np.ceil((t[-1] - t[0]) * samples_per_s)) + 1)
    ticks = np.unique(np.linspace(0, len(t) - 1, min(count, len(t))).round().astype(int))
    distance, _ = distance_to_go(robot, q[ticks])
    known = np.isfinite(distance)
    if known.sum() < 2:
        return np.zeros(len(t), dtype=np.bool_)
    at, distance = t[ticks][known], distance[known]
    ahead, behind = np.minimum(t + 0.5 * window_s, t[-1]), np.maximum(t - 0.5 * window_s, t[0])
    speed = np.abs(np.interp(ahead, at, distance) - np.interp(behind, at, distance)) / (ahead - behind)
    flags: Flags = (speed > still_rad_per_s) & (np.interp(t, at, distance) > near_rad)
    return flags
