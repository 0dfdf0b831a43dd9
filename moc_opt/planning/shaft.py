"""What a course keeps from losing the shaft: the margin of ``[control] shaft_margin``, as the local climb has it.

With the tip held, the wrist is moved across the shaft by mu_shaft (`model.manipulability_kernels`). Where its share of
the squared lever is small the joints have to turn fast to keep the shaft in the trocar, and what they lag of it is RCM
error. On the map a pose below the margin m is worth less, so that a course goes there only where the path, or the
start, leaves it no other way, and then as little as can be:

    mu - WORTH mu_max (1 - share/m)^2,        share < m
    log mu - WORTH (1 - share/m)^2            where the mean of log mu is the objective
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from moc_opt.model.kinematics_kernels import point_jacobian
from moc_opt.model.manipulability_kernels import shaft_manipulability
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.planning.course import Course, Objective
from moc_opt.planning.pose_map import PoseMap
from moc_opt.redundancy.continuation import Constraint, forward

COURSE_SHARE = 0.25
"""Of ``[control] shaft_margin``: there the push of the local climb begins; a course, which looks ahead, goes down to a
quarter of it."""
WORTH = 10.0
"""A pose at which the shaft is lost is worth less by so many times the map's largest mu; its log mu by this number."""


def keeping_shaft(
    found: PoseMap, robot: RobotModel, shaft_margin: float, objective: Objective = "mean"
) -> PoseMap:
    """Return the map with mu lowered where the shaft's share is below the margin, for a search alone.

    Args:
        found: every pose at every time of the path.
        robot: its model.
        shaft_margin: m, a share of the squared lever, 0 to 1; 0 leaves the map as it is.
        objective: of the search.
    """
    if shaft_margin <= 0.0:
        return found
    # Every branch of a swivel has the same columns of A up to their signs.
    share = np.array([shaft_shares(robot, found.poses(k)[0]) for k in range(len(found.targets))])[:, None]
    return replace(found, mu=_less(found.mu, share, shaft_margin, largest(found), objective))


def lowered(
    course: Course, robot: RobotModel, shaft_margin: float, largest_mu: float, objective: Objective = "mean"
) -> Course:
    """Return the course with mu lowered as on its map, to compare courses by what the search compares.

    Args:
        course: of the robot.
        robot: its model.
        shaft_margin, objective: as of `keeping_shaft`.
        largest_mu: `largest` of the map before it was lowered, or of the course that a program begins at [m^3].
    """
    if shaft_margin <= 0.0:
        return course
    share = shaft_shares(robot, course.q_rad)
    return replace(course, mu=_less(course.mu, share, shaft_margin, largest_mu, objective))


def largest(found: PoseMap) -> float:
    """Return the largest mu of a map [m^3]; 0 where it has no pose."""
    return float(np.nanmax(found.mu, initial=0.0))


def _less(mu: Array, share: Array, shaft_margin: float, largest_mu: float, objective: Objective) -> Array:
    with np.errstate(invalid="ignore"):
        price = WORTH * np.maximum(1.0 - share / shaft_margin, 0.0) ** 2
    less: Array = mu * np.exp(-price) if objective == "log" else mu - largest_mu * price
    return less


def shaft_shares(robot: RobotModel, poses: Array) -> Array:
    """Compute mu_shaft over the squared distance from wrist to tip, (k,), at the poses (k,n) [rad]; NaN stays NaN."""
    chain, rows = robot.chain, np.ascontiguousarray(poses)
    active = np.flatnonzero(robot.moves.any(axis=0)).astype(np.int64)
    arm = Constraint(
        chain.joints, chain.offsets, robot.moves, robot.q_min, robot.q_max, active=active, target=np.zeros((2, 3))
    )
    shares = np.empty(len(rows))
    _fill_shares(arm, rows, shares)
    return shares


@njit(cache=True)
def _fill_shares(arm: Constraint, poses: Array, shares: Array) -> None:
    n = poses.shape[1]
    axes, points, A, u, slope = np.empty((n, 6)), np.empty((2, 3)), np.empty((6, n)), np.empty(3), np.empty(n)
    for k in range(poses.shape[0]):
        if np.isnan(poses[k, 0]):
            shares[k] = np.nan
            continue
        forward(arm, poses[k], axes, points)
        point_jacobian(axes, points[0], arm.moves[0], A[0:3])
        point_jacobian(axes, points[1], arm.moves[1], A[3:6])
        square = 0.0
        for i in range(3):
            u[i] = points[0, i] - points[1, i]
            square += u[i] * u[i]
        for i in range(3):
            u[i] /= np.sqrt(square)
        shares[k] = shaft_manipulability(axes, A, u, slope) / square
