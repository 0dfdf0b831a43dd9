"""The trajectories on a manipulability map: how long each is at the optimum, and what keeps it from there.

Where a trajectory ends off the optimum, the map is climbed from there at the time of the end: upwards in mu, swivel by
swivel, poses beyond a joint limit included. A climb that stops close by, at a local maximum or at the edge of the
feasible poses, is what holds the run; where the way up is open, only the run itself can tell why it is not there: a
controller without third level, or the box of the third level, which closes before the joint limits that the map shows.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.planning.arm_angle import wrapped
from moc_opt.planning.swivel_map import FEASIBLE, OTHER_BRANCH_RAD, SwivelMap, Trajectory

NEAR = 0.02  #: A trajectory is at the optimum where its mu is at most this fraction below the best.
END = 0.2  #: The last part of a trajectory, as a fraction of its time, which gives its end.
CLOSE_RAD = np.radians(12.0)
"""Nearer to a local maximum or the edge of the feasible poses than this, a trajectory is held by it."""
STILL_RAD_PER_S = np.radians(1.0)
ALIKE_RAD = np.radians(3.0)


class End(StrEnum):
    """Where a trajectory is in the end."""

    OPTIMUM = "at the optimum"
    LOCAL_MAXIMUM = "at a local maximum"
    FEASIBLE_EDGE = "at the edge of the feasible poses"
    STILL = "at rest, though mu rises to one side"
    RISING = "mu still rises"
    FALLING = "mu falls"
    OTHER_BRANCH = "on another branch"
    UNKNOWN = "nothing to compare with"


@dataclass(frozen=True)
class Reading:
    """The analysis of one trajectory."""

    name: str
    near: float  #: Share of the time in which it is at the optimum; NaN where no pose of the map is allowed.
    mu_share: float  #: Mean mu over the mean of the best mu at the same times.
    travel_rad: float  #: How far the elbow has turned in the end; positive upwards on the map.
    from_s: float  #: From when on it stays at the optimum [s]; NaN where it is not there in the end.
    end: End
    joint: int  #: The joint (from 1) whose limit it stands before; 0 where that is the arm's reach, or nothing.
    at_edge: float
    """Share of the time in which its pose is infeasible, or no farther from such a pose than a row of the map."""
    limits: tuple[int, ...]  #: Whose limits these are, joints from 1.


def read_trajectory(found: SwivelMap, name: str) -> Reading:
    """Return what the trajectory of one run, by its name on the map, amounts to."""
    trajectory, known = found.trajectories[name], np.isfinite(found.best_mu)
    travel = float(np.unwrap(trajectory.swivel_rad)[-1] - trajectory.swivel_rad[0])
    nan = float("nan")
    if not known.any() or trajectory.gap_rad > OTHER_BRANCH_RAD:
        end = End.OTHER_BRANCH if known.any() else End.UNKNOWN
        return Reading(name, nan, nan, travel, from_s=nan, end=end, joint=0, at_edge=nan, limits=())
    at_edge, limits = _at_edge(found, trajectory)
    best = np.interp(trajectory.t_s, found.t_s[known], found.best_mu[known])
    near = trajectory.mu >= (1.0 - NEAR) * best
    late = trajectory.t_s >= trajectory.t_s[-1] - END * (trajectory.t_s[-1] - trajectory.t_s[0])
    share = float(trajectory.mu.mean() / best.mean())
    since, end, joint = nan, End.OPTIMUM, 0
    if np.median(trajectory.mu[late] / best[late]) >= 1.0 - NEAR:
        off = np.flatnonzero(~near)
        since = float(trajectory.t_s[min(off[-1] + 1, len(near) - 1)] if len(off) else trajectory.t_s[0])
    else:
        end, joint = _what_holds(found, trajectory, late)
    return Reading(
        name, float(near.mean()), share, travel, from_s=since, end=end, joint=joint, at_edge=at_edge, limits=limits
    )


def alike(found: SwivelMap, within_rad: float = ALIKE_RAD) -> dict[str, list[str]]:
    """Return the trajectories that cannot be told apart on the map: first of each kind -> the others, in their order.

    Args:
        within_rad: two trajectories are alike where their swivels never lie farther apart at the same time.
    """
    kinds: dict[str, list[str]] = {}
    for name, trajectory in found.trajectories.items():
        alike = (first for first in kinds if _apart(found.trajectories[first], trajectory) <= within_rad)
        kinds.setdefault(next(alike, name), []).append(name)
    return {first: names[1:] for first, names in kinds.items()}


def _apart(one: Trajectory, two: Trajectory) -> float:
    longer = abs(one.t_s[-1] - two.t_s[-1]) > 0.02 * (one.t_s[-1] - one.t_s[0])
    folded = (one.gap_rad > OTHER_BRANCH_RAD) != (two.gap_rad > OTHER_BRANCH_RAD)
    if longer or folded:
        return float("inf")
    there = np.interp(one.t_s, two.t_s, np.unwrap(two.swivel_rad))
    return float(np.abs(wrapped(there - one.swivel_rad)).max())


def _at_edge(found: SwivelMap, trajectory: Trajectory) -> tuple[float, tuple[int, ...]]:
    columns = np.abs(found.t_s[None] - trajectory.t_s[:, None]).argmin(axis=1)
    rows = np.abs(wrapped(found.swivel_rad[None] - trajectory.swivel_rad[:, None])).argmin(axis=1)
    beside = found.limit[columns[:, None], (rows[:, None] + [-1, 0, 1]) % len(found.swivel_rad)]
    joints = np.unique(beside[beside > FEASIBLE])
    return float((beside != FEASIBLE).any(axis=1).mean()), tuple(int(joint) for joint in joints)


def _what_holds(found: SwivelMap, trajectory: Trajectory, late: NDArray[np.bool_]) -> tuple[End, int]:
    # The last column until the end in which any pose is allowed; the first such column where none is.
    known = np.flatnonzero(np.isfinite(found.best_mu))
    column = int(max(known[found.t_s[known] <= trajectory.t_s[-1] + 1e-9], default=known[0]))
    mu, limit, best = found.mu[column], found.limit[column], found.best_mu[column]
    count, step = len(mu), float(found.swivel_rad[1] - found.swivel_rad[0])
    away = wrapped(found.swivel_rad - trajectory.swivel_rad[-1])
    row = int(np.argmin(np.abs(away)))
    side = _uphill(mu, row)
    stop = row
    for _ in range(count):
        following = (stop + side) % count
        if side == 0 or limit[following] != FEASIBLE or mu[following] <= mu[stop]:
            break
        stop = following
    blocked = side != 0 and limit[(stop + side) % count] != FEASIBLE
    close = abs(float(away[stop])) <= CLOSE_RAD + 0.5 * step
    if close and blocked:
        return End.FEASIBLE_EDGE, max(int(limit[(stop + side) % count]), 0)
    if close and mu[stop] < (1.0 - NEAR) * best:
        return End.LOCAL_MAXIMUM, 0
    t, swivel = trajectory.t_s[late], np.unwrap(trajectory.swivel_rad[late])
    speed = (swivel[-1] - swivel[0]) / max(t[-1] - t[0], 1e-9)
    if abs(speed) < STILL_RAD_PER_S:
        return End.STILL, 0
    return (End.RISING if speed * side > 0.0 else End.FALLING), 0


def _uphill(mu: Array, row: int) -> int:
    beside = np.array([mu[row - 1], mu[(row + 1) % len(mu)]])
    rise = np.where(np.isfinite(beside), beside - mu[row], -np.inf)
    if not (rise > 0.0).any():
        return 0
    return 1 if rise[1] > rise[0] else -1
