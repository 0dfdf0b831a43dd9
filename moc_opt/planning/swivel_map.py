"""The map of mu over time and swivel, and the trajectories of runs on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array, read_only
from moc_opt.errors import ReportError, RobotError
from moc_opt.planning.elbow import Elbow, wrapped
from moc_opt.planning.pose_map import nearest_turns, reach, without_limits
from moc_opt.planning.self_motion import SelfMotion, curve_through, parabola_peak
from moc_opt.robots.chain import desired_wrist
from moc_opt.robots.model import RobotModel
from moc_opt.trace.trace import Trace

UNREACHABLE, FEASIBLE = -1, 0
TRAJECTORY_POINTS = 500  #: Largest number of times of a `Trajectory`.
STEP_RAD = 0.05  #: Spacing of the samples of a self-motion.
SAME_PATH_M = 1e-6  #: Largest difference between tip references of the same path.
OTHER_BRANCH_RAD = 0.5  #: `Trajectory.gap_rad` above which the run is on another branch.
NEEDED = ("t_s", "q_rad", "tip_m", "tip_ref_m")
NEAR = 0.02  #: mu counts as optimal if it is below the best mu by at most this fraction.
END = 0.2  #: The end of a run is this last fraction of its time.
CLOSE_RAD = np.radians(12.0)  #: A run is at a local maximum of mu, or at an edge, if its swivel is this close.
STILL_RAD_PER_S = np.radians(1.0)  #: Speed of the swivel below which a run counts as at rest.


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Swivel and mu of a run, sampled at c times; arrays (c,)."""

    t_s: Array
    swivel_rad: Array  #: Swivel in the map's range. It may jump by a turn.
    mu: Array  #: mu of the run's poses [m^3].
    gap_rad: float
    """Median over time of max_j |q_j - q_map,j|, where q_map is the map's pose at the run's time and swivel."""


@dataclass(frozen=True, eq=False, repr=False)
class SwivelMap:
    """mu over time and swivel: k times, m swivels, n joints."""

    t_s: Array  #: (k,)
    swivel_rad: Array  #: (m,) evenly over one turn
    mu: Array  #: (k, m) [m^3], also beyond joint limits; NaN if there is no pose
    q_rad: Array  #: (k, m, n)
    limit: NDArray[np.int64]
    """(k, m) `FEASIBLE`, `UNREACHABLE`, or the joint (counted from 1) that is farthest beyond a limit"""
    best_swivel_rad: Array  #: (k,) swivel of `best_mu`
    best_mu: Array  #: (k,) largest feasible mu [m^3]; NaN if no pose is feasible
    trajectories: Mapping[str, Trajectory]
    held: tuple[str, ...] = ()  #: names of joints that are held still to leave a single freedom

    def __repr__(self) -> str:
        return f"SwivelMap({len(self.t_s)} times, {len(self.swivel_rad)} swivels, runs: {', '.join(self.trajectories)})"


def manipulability_map(
    robot: RobotModel, traces: Mapping[str, Trace], *, times: int = 100, swivels: int = 180
) -> SwivelMap:
    """Scan the self-motion at evenly spaced times of the path that all runs in ``traces`` share.

    Raises:
        ReportError: no runs, too few times or swivels, runs of different paths, or an unusable trace.
        RobotError: several poses of a self-motion have the same swivel angle.
    """
    if not traces or times < 2 or swivels < 8:
        raise ReportError(f"{len(traces)} runs, {times} times, {swivels} swivels: give at least 1, 2 and 8")
    for name, trace in traces.items():
        check_showable(name, trace, robot)
    guide = max(traces.values(), key=len)
    ticks = np.linspace(0, len(guide) - 1, times).round().astype(int)
    tips, wrists = _targets(robot, traces, guide, ticks)
    elbow, free = Elbow(robot, wrists), without_limits(robot)
    swivel = -np.pi + 2.0 * np.pi * np.arange(swivels) / swivels
    q = np.full((times, swivels, robot.n), np.nan)
    held: set[int] = set()
    for k, tick in enumerate(ticks):
        pose = reach(robot, guide.q_rad[tick], tips[k], wrists[k])
        curve = None if pose is None else curve_through(free, pose, STEP_RAD)
        if curve is not None:
            held.update(curve.held)
            q[k] = nearest_turns(robot, _poses_at(curve, elbow, swivel))
    mu, limit = _judged(robot, q)
    turn = _cut(limit == FEASIBLE)
    swivel, q, mu, limit = swivel + 2.0 * np.pi * turn / swivels, *(np.roll(a, -turn, axis=1) for a in (q, mu, limit))
    if swivel.mean() >= np.pi:  # keep the middle of the map between -180 and 180 degrees
        swivel -= 2.0 * np.pi
    best = np.array([_best(swivel, *column) for column in zip(mu, limit, strict=True)]).T
    lines = {name: _trajectory(robot, elbow, run, guide.t_s[ticks], swivel, q) for name, run in traces.items()}
    for array in (swivel, q, mu, limit, best):
        read_only(array)
    names = tuple(robot.data.joint_names[j] for j in sorted(held) if robot.moves[:, j].any())
    return SwivelMap(guide.t_s[ticks], swivel, mu, q, limit, best[0], best[1], MappingProxyType(lines), names)


def _poses_at(curve: SelfMotion, elbow: Elbow, swivels: Array) -> Array:
    angles = np.unwrap(elbow.swivel(curve.q))
    steps = np.diff(angles)
    sign = 1.0 if len(steps) and steps[0] > 0.0 else -1.0
    if not np.all(sign * steps > 0.0):
        raise RobotError(
            "the elbow's swivel angle both rises and falls along the self-motion, so it does not tell the poses apart: "
            "the map is for arms whose shoulder, elbow and wrist form a triangle"
        )
    along = (curve.s - curve.s[0]) / max(curve.s[-1] - curve.s[0], 1e-300)
    turned = angles[0] + sign * np.mod(sign * (swivels - angles[0]), 2.0 * np.pi)
    known = sign * (angles[-1] - turned) >= 0.0
    found = np.full((len(swivels), curve.q.shape[1]), np.nan)
    aims = turned[known]
    for _ in range(3):  # correct the error of linear interpolation
        found[known] = curve.at(np.interp(sign * aims, sign * angles, along))
        aims = aims + wrapped(turned[known] - elbow.swivel(found[known]))
    return found


def _targets(
    robot: RobotModel, traces: Mapping[str, Trace], guide: Trace, ticks: NDArray[np.int64]
) -> tuple[Array, Array]:
    column = "trocar_registered_m" if "trocar_registered_m" in guide.columns else "trocar_m"
    for name, trace in traces.items():
        if trace.meta.get("kind") == "course":
            raise ReportError(f"{name!r} is a course, not a run: `moc-opt run SCENARIO --course FILE` follows it")
        if column not in trace.columns:
            raise ReportError(f"run {name!r} has no column {column!r}: give a trace that `run` returned")
        shared = ticks[ticks < len(trace)]
        apart = np.abs(trace.tip_ref_m[shared] - guide.tip_ref_m[shared]).max()
        if apart > SAME_PATH_M:
            raise ReportError(f"run {name!r} follows another path than the longest run ({apart:.3g} m apart)")
    # `reach` needs a distance from tip to wrist that is exact within 1e-9 m, but a trace may hold 4-byte floats.
    tips, trocars = (np.asarray(guide.columns[name][ticks], dtype=np.float64) for name in ("tip_ref_m", column))
    span = robot.state(robot.data.q_home).tool_span
    return tips, desired_wrist(tips, 0.0, trocars, 0.0, span)[0]


def _judged(robot: RobotModel, q: Array) -> tuple[Array, NDArray[np.int64]]:
    known = np.isfinite(q).all(axis=-1)
    mu, limit = np.full(known.shape, np.nan), np.full(known.shape, UNREACHABLE, dtype=np.int64)
    mu[known] = robot.mu_along(q[known])
    beyond = np.maximum(q[known] - robot.q_max, robot.q_min - q[known])
    limit[known] = np.where(beyond.max(axis=1) > 1e-9, 1 + beyond.argmax(axis=1), FEASIBLE)
    return mu, limit


def _best(swivel: Array, mu: Array, limit: NDArray[np.int64]) -> tuple[float, float]:
    feasible = np.where(limit == FEASIBLE, mu, -np.inf)
    j, width = int(np.argmax(feasible)), swivel[1] - swivel[0]
    if not np.isfinite(feasible[j]):
        return np.nan, np.nan
    around = feasible[[j - 1, j, (j + 1) % len(mu)]]
    step, height = parabola_peak(width * np.array([-1.0, 0.0, 1.0]), around)
    return float(_onto(swivel[j] + step, swivel)), float(feasible[j] + height)


def _cut(feasible: NDArray[np.bool_]) -> int:
    # Cut the circle of swivels at the swivel that is farthest from feasible poses.
    allowed, count = np.flatnonzero(feasible.any(axis=0)), feasible.shape[1]
    apart = np.abs(np.arange(count)[:, None] - allowed)
    return int(np.argmax(np.minimum(apart, count - apart).min(axis=1, initial=count)))


def _onto(angles: Array, swivel: Array) -> Array:
    low = swivel[0] - 0.5 * (swivel[1] - swivel[0])
    turned: Array = low + np.mod(angles - low, 2.0 * np.pi)
    return turned


def _trajectory(robot: RobotModel, elbow: Elbow, trace: Trace, times: Array, swivel: Array, q: Array) -> Trajectory:
    ticks = np.unique(np.linspace(0, len(trace) - 1, min(len(trace), TRAJECTORY_POINTS)).round().astype(int))
    poses = trace.q_rad[ticks]
    angles = _onto(elbow.swivel(poses), swivel)
    columns = np.abs(times[None] - trace.t_s[ticks][:, None]).argmin(axis=1)
    rows = np.abs(swivel[None] - angles[:, None]).argmin(axis=1)
    moving = robot.moves.any(axis=0) & ~robot.chain.prismatic
    gaps = np.abs(wrapped(q[columns, rows] - poses)[:, moving]).max(axis=1)
    gap = float(np.median(gaps[np.isfinite(gaps)])) if np.isfinite(gaps).any() else float("nan")
    return Trajectory(trace.t_s[ticks], angles, robot.mu_along(poses), gap)


def check_showable(name: str, trace: Trace, robot: RobotModel) -> None:
    """Raise a ReportError if a run is empty, incomplete, not finite, or of another arm."""
    missing = [column for column in NEEDED if column not in trace.columns]
    if missing or not len(trace):
        what = f"lacks the columns {', '.join(missing)}" if missing else "has no ticks"
        raise ReportError(f"run {name!r} {what}: give a trace that `run` returned")
    joints = trace.q_rad.shape[1]
    if joints != robot.n:
        raise ReportError(f"run {name!r} has {joints} joints, but robot {robot.data.name!r} has {robot.n}")
    wild = [column for column in NEEDED if not np.isfinite(trace.columns[column]).all()]
    if wild:
        raise ReportError(f"run {name!r} is not finite in {wild[0]!r}: keep its finite ticks with `select`")


class End(StrEnum):
    """How a trajectory ends."""

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
    near: float  #: Share of the time at which mu is optimal within `NEAR`; NaN if unknown.
    mu_share: float  #: (Mean mu) / (mean of the best mu at the same times).
    travel_rad: float  #: Change of the swivel from start to end.
    from_s: float  #: Time from which mu stays optimal; NaN if it is not optimal at the end.
    end: End
    joint: int  #: Joint (counted from 1) whose limit keeps mu from rising, or 0.
    at_edge: float  #: Share of the time at or beside an infeasible sample of the map.


def read_trajectory(found: SwivelMap, name: str) -> Reading:
    """Analyse the trajectory of the run ``name``."""
    run, known = found.trajectories[name], np.isfinite(found.best_mu)
    travel, nan = float(np.unwrap(run.swivel_rad)[-1] - run.swivel_rad[0]), np.nan
    if not known.any() or run.gap_rad > OTHER_BRANCH_RAD:
        end = End.OTHER_BRANCH if known.any() else End.UNKNOWN
        return Reading(name, nan, nan, travel, nan, end, 0, nan)
    best = np.interp(run.t_s, found.t_s[known], found.best_mu[known])
    near = run.mu >= (1.0 - NEAR) * best
    late = run.t_s >= run.t_s[-1] - END * (run.t_s[-1] - run.t_s[0])
    since, end, joint = nan, End.OPTIMUM, 0
    if np.median(run.mu[late] / best[late]) >= 1.0 - NEAR:
        off = np.append(-1, np.flatnonzero(~near))[-1]
        since = float(run.t_s[min(off + 1, len(near) - 1)])
    else:
        end, joint = _what_holds(found, run, late)
    columns = np.abs(found.t_s[None] - run.t_s[:, None]).argmin(axis=1)
    rows = np.abs(wrapped(found.swivel_rad[None] - run.swivel_rad[:, None])).argmin(axis=1)
    beside = found.limit[columns[:, None], (rows[:, None] + [-1, 0, 1]) % len(found.swivel_rad)]
    edge = float((beside != FEASIBLE).any(axis=1).mean())
    return Reading(name, float(near.mean()), float(run.mu.mean() / best.mean()), travel, since, end, joint, edge)


def _what_holds(found: SwivelMap, run: Trajectory, late: NDArray[np.bool_]) -> tuple[End, int]:
    known = np.flatnonzero(np.isfinite(found.best_mu))
    # the last column with a feasible pose before the run's end
    column = int(max(known[found.t_s[known] <= run.t_s[-1] + 1e-9], default=known[0]))
    mu, limit, count = found.mu[column], found.limit[column], found.mu.shape[1]
    away = wrapped(found.swivel_rad - run.swivel_rad[-1])
    row = int(np.argmin(np.abs(away)))
    rise = np.nan_to_num(mu[[row - 1, (row + 1) % count]] - mu[row], nan=-np.inf)
    side = 0 if rise.max() <= 0.0 else 1 if rise[1] > rise[0] else -1
    stop = row
    while side and limit[(stop + side) % count] == FEASIBLE and mu[(stop + side) % count] > mu[stop]:
        stop = (stop + side) % count
    beyond = int(limit[(stop + side) % count]) if side else FEASIBLE
    if abs(float(away[stop])) <= CLOSE_RAD + 0.5 * float(found.swivel_rad[1] - found.swivel_rad[0]):
        if beyond != FEASIBLE:
            return End.FEASIBLE_EDGE, max(beyond, 0)
        if mu[stop] < (1.0 - NEAR) * found.best_mu[column]:
            return End.LOCAL_MAXIMUM, 0
    t, swivel = run.t_s[late], np.unwrap(run.swivel_rad[late])
    speed = (swivel[-1] - swivel[0]) / max(t[-1] - t[0], 1e-9)
    if abs(speed) < STILL_RAD_PER_S:
        return End.STILL, 0
    return (End.RISING if speed * side > 0.0 else End.FALLING), 0
