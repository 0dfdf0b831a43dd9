"""Where and why a path cannot be executed from its start: the first point that no course reaches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.planning.course import faster
from moc_opt.planning.pose_map import Margin, PoseMap
from moc_opt.planning.search import Search
from moc_opt.planning.search_kernels import nearest_share
from moc_opt.planning.targets import Targets


@dataclass(frozen=True)
class Blocked:
    """The first point of the path that no course reaches from the start.

    Example:
        >>> blocked = mo.plan(mo.Scenario(duration_s=4.0), times=20, speed_share=0.01, refined=False).blocked
        >>> blocked.t_s > 0.0, "times its speed limit" in blocked.reason
        (True, True)
    """

    t_s: float
    """When the run would be there [s]."""
    arc_length_m: float
    """Way of the tip up to it [m]."""
    tip_m: tuple[float, float, float]
    """Place of the tip there [m]."""
    reason: str
    """The obstacle in words, with the joint's name where it is one joint's."""


def blocked(
    robot: RobotModel, found: PoseMap, answer: Search, q_start: Array, step: Array, margin: Margin, proven: bool
) -> Blocked:
    """Name the first point that the search did not reach, and the obstacle.

    Args:
        robot: the arm.
        found: the map that was searched.
        answer: of the search.
        q_start: (n,) the start [rad].
        step: (n,) most that a joint turns in one period [rad].
        margin: from the joint limits that was asked for.
        proven: the bound excludes every course; else the reason says that it does not.
    """
    if answer.q_rad is not None:
        return _too_sudden(robot, found.targets, answer.q_rad)
    k, targets = answer.reached, found.targets
    at = float(targets.t_s[k]), float(targets.arc_length_m[k]), tuple(targets.tip[k].tolist())
    feasible, names = found.feasible(margin), robot.data.joint_names
    if not np.isfinite(found.mu[k]).any():
        return Blocked(*at, "out of reach: no pose has tip and wrist there, whatever the joint limits")
    if not feasible[k].any():
        j = _nearest_limit(robot, found, k, np.isfinite(found.room_rad[k]))
        return Blocked(*at, f"no pose there is within the joint limits: {names[j]} is beyond its own")
    before = q_start[None, None] if k == 1 else found.poses(k - 1)
    if k == 1:
        before = np.tile(before, (found.mu.shape[1], 1, 1))
    here = np.ones(before.shape[:2], dtype=np.bool_) if k == 1 else answer.last
    q = found.poses(k)
    known = np.isfinite(found.mu[k])
    share, _ = nearest_share(before, here, q, known, step)
    wanted, fast = nearest_share(before, here, q, feasible[k], step)
    if share <= 1.0 < wanted:  # the poses next to those reached exist, and are beyond a limit
        j = _nearest_limit(robot, found, k, known & _within(before, here, q, step))
        told = f"{names[j]} runs into its limit; only other swivels or branches have poses within the limits"
        return Blocked(*at, told)
    if not np.isfinite(wanted):
        return Blocked(*at, "no pose of the branch is within the joint limits there")
    doubt = "" if proven else " between the poses of the map; the bound excludes no other way"
    return Blocked(*at, f"{names[fast]} would have to turn at {wanted:.3g} times its speed limit{doubt}")


def _too_sudden(robot: RobotModel, targets: Targets, q: Array) -> Blocked:
    """Return where the best course without a limit on accelerations needs the largest; with the limit there is none."""
    gained = faster(q) / targets.period_s**2
    k, j = (int(i) for i in np.unravel_index(int(np.argmax(gained)), gained.shape))
    return Blocked(
        float(targets.t_s[k]), float(targets.arc_length_m[k]), tuple(targets.tip[k].tolist()),
        f"no course keeps the acceleration limit; the one without takes {robot.data.joint_names[j]} to "
        f"{gained[k, j]:.3g} rad/s^2 there",
    )  # fmt: skip


def _within(before: Array, here: NDArray[np.bool_], q: Array, step: Array) -> NDArray[np.bool_]:
    """Return (b,m) poses that the joints get to in one period, limits aside."""
    near = np.zeros(q.shape[:2], dtype=np.bool_)
    for b in range(len(q)):
        for pose in before[b][here[b]]:
            near[b] |= (np.abs(q[b] - pose) <= step).all(axis=1)
    return near


def _nearest_limit(robot: RobotModel, found: PoseMap, k: int, among: NDArray[np.bool_]) -> int:
    """Return the joint that is farthest beyond its limit at the pose which is least beyond."""
    room = np.where(among, found.room_rad[k], -np.inf)
    q = found.poses(k)[np.unravel_index(int(np.argmax(room)), room.shape)]
    moving = np.asarray(robot.moves.any(axis=0))
    beyond = np.where(moving, np.maximum(q - robot.q_max, robot.q_min - q), -np.inf)
    return int(np.argmax(beyond))
