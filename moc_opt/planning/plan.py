"""Plan a path before a run: whether it can be executed, and along which course (joint motion)."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.errors import TaskError, is_number
from moc_opt.planning.course import Course, Limits, Targets, make_course, margin_at, worth
from moc_opt.planning.elbow import Elbow
from moc_opt.planning.pose_map import SWIVELS, PoseMap, map_of
from moc_opt.planning.program import refine
from moc_opt.planning.search import WHOLE_CELL, Value, keeping_shaft, reached
from moc_opt.robots.model import RobotModel

ROOM = 0.01  #: If mean mu is below its bound by more than this fraction, another course is tried.


@dataclass(frozen=True, eq=False)
class Blocked:
    """The first point of the path that no course reaches from the start."""

    t_s: float
    arc_length_m: float  #: Length of the tip's path up to this point.
    tip_m: tuple[float, float, float]
    reason: str


@dataclass(frozen=True, eq=False)
class Plan:
    """The plan of a path from one start; k times, n joints."""

    targets: Targets
    from_start: Course | None  #: Best course from the start, or None.
    best: Course | None  #: Best course from any start pose, or None.
    climbed: Course  #: Local climb: each step goes up in mu as far as the speed limits allow. It may end early.
    bound_from_start: float
    """Estimated upper bound of mean mu from the start [m^3]; NaN if ``from_start`` is None or has a larger mean mu."""
    bound: float  #: The same bound for ``best``, over all starts [m^3].
    blocked: Blocked | None  #: Where and why the path cannot be executed from the start, or None.
    start_swivel_rad: float
    best_swivel_rad: float  #: Swivel at the start of ``best``.
    swivel_rad: Array  #: (k,) swivel along ``course``.
    took_s: Mapping[str, float]  #: Times of the steps "map", "search", "bound" and "refine".

    def __repr__(self) -> str:
        stuck = self.blocked
        shown = ["executable: yes" if stuck is None else f"blocked: at t = {stuck.t_s:.3f} s, {stuck.reason}"]
        for name, course in (("from the start", self.from_start), ("best", self.best), ("local climb", self.climbed)):
            if course is not None:
                part = "" if len(course.mu) == len(self.targets) else f", to t = {course.t_s[-1]:.3f} s only"
                shown.append(f"mean mu {name}: {course.mu_mean:.4g} m^3{part}")
        return f"Plan({', '.join(shown)})"

    @property
    def executable(self) -> bool:
        """Whether the whole path can be executed from the start."""
        return self.from_start is not None

    @property
    def course(self) -> Course | None:
        """``from_start`` or, if it is None, ``best``."""
        return self.from_start if self.from_start is not None else self.best

    @property
    def climbed_whole(self) -> bool:
        """Whether the local climb reaches the end of the path."""
        return len(self.climbed.mu) == len(self.targets)


def make_plan(
    robot: RobotModel, q_start: Array, targets: Targets, limits: Limits | None = None, *, swivels: int = SWIVELS,
    refined: bool = True,
) -> Plan:  # fmt: skip
    """Find the best course from the given start, and the best course from any start.

    Args:
        q_start: (n,) pose with tip and wrist at the first target [rad].
        targets: positions of tip and wrist along the path.
        limits: by default the joints' own limits and speeds, without margin.
        swivels: number of swivels on the map, 8 to `pose_map.MOST_SWIVELS`.
        refined: whether the nonlinear program improves the courses of the search.

    Raises:
        TaskError: an argument is out of range, or the start is not at the first target.
        RobotError: the number of swivels is out of range.
    """
    limits, start = limits or Limits(), np.array(q_start, dtype=np.float64)
    check_limits(robot, limits)
    tips, wrists = robot.tool_along(start[None])
    off = max(np.abs(tips[0] - targets.tip[0]).max(), np.abs(wrists[0] - targets.wrist[0]).max())
    if off > 1e-6:
        raise TaskError(f"q_start: tip or wrist is {1e3 * off:.3g} mm from its first target: begin the path at the tip")
    limits = replace(limits, margin=margin_at(robot, start, limits.margin))
    took, began = dict[str, float](), time.perf_counter()

    def done(part: str) -> None:
        took[part] = time.perf_counter() - began - sum(took.values())

    whole = map_of(robot, start, targets, swivels)
    found, top = keeping_shaft(whole, limits), float(np.nanmax(whole.mu, initial=0.0))
    done("map")
    value = Value(found, limits)
    grid = [best_course(value, begin) for begin in (start, None)]
    done("search")
    relaxed = Value(found, limits, cell=WHOLE_CELL)
    bounds = [relaxed.of(start, float(robot.state(start).mu)), relaxed.best()[0]]
    done("bound")

    def better(one: Course | None, other: Course | None) -> Course | None:
        both = [course for course in (one, other) if course is not None]
        return max(both, key=lambda course: worth(robot, course, limits, top), default=None)

    courses: list[Course | None] = []
    for q, begin, bound in zip(grid, (start, None), bounds, strict=True):
        course = None if q is None else make_course(robot, targets, q, limits)
        if course is not None and refined:
            course = refine(robot, targets, course, limits)
        if refined and (course is None or course.mu_mean < (1.0 - ROOM) * bound):
            q = best_course(relaxed, begin)  # unlike `value`, `relaxed` allows courses between the map's poses
            if q is not None:
                other = refine(robot, targets, make_course(robot, targets, q, limits), limits)
                course = better(course, other if other.kept else None)
        courses.append(course)
    mine, best = courses[0], better(courses[1], courses[0])  # the given start is also a start pose
    done("refine")
    elbow, shown = Elbow(robot, targets.wrist), mine if mine is not None else best
    mine_most, most = (
        np.nan if course is None or course.mu_mean > bound else bound
        for course, bound in zip((mine, best), bounds, strict=True)
    )
    climbed = make_course(robot, targets, climb(found, start, limits), limits)
    return Plan(
        targets, mine, best, climbed, mine_most, most,
        blocked=None if mine is not None else _blocked(found, start, limits, bounds[0]),
        start_swivel_rad=float(elbow.swivel(start[None])[0]),
        best_swivel_rad=np.nan if best is None else float(elbow.swivel(best.q_rad[:1])[0]),
        swivel_rad=np.empty(0) if shown is None else np.unwrap(elbow.swivel(shown.q_rad)),
        took_s=took,
    )  # fmt: skip


def check_limits(robot: RobotModel, limits: Limits) -> None:
    """Raise a TaskError if a limit is out of range."""
    for name, value, least, most, words in (
        ("speed_share", limits.speed_share, 1e-300, 1.0, "a share above 0 and up to 1"),
        ("shaft_margin", limits.shaft, 0.0, 1.0, "a number from 0 to 1"),
    ):
        if not is_number(value) or not least <= value <= most:
            raise TaskError(f"{name} = {value!r}: give {words}")
    sizes = np.asarray(limits.margin)
    known = is_number(limits.margin) or (sizes.dtype == np.float64 and sizes.shape == (robot.n,))
    if not known or not ((sizes >= 0.0) & (2.0 * sizes < robot.q_max - robot.q_min)).all():
        raise TaskError(
            f"margin_rad or margin_m = {limits.margin!r}: give zero or more, and less than half of every joint's range"
        )


def best_course(value: Value, start: Array | None) -> Array | None:
    """Return the best course (k,n) on the map from ``start`` (n,), or from any pose if ``start`` is None."""
    start = value.best()[1] if start is None else start
    way = None if start is None else value.way(start)
    return None if way is None else way.q_rad


def climb(found: PoseMap, start: Array, limits: Limits) -> Array:
    """Return the poses (k,n) of the local climb from ``start`` (n,) over the map.

    They stop before the path's end if no pose at the next time is within reach.
    """
    step, feasible = limits.speed_share * found.robot.v_max * found.targets.period_s, found.feasible(limits.margin)
    poses = [np.array(start)]
    for k in range(1, len(found.targets)):
        q = found.q_rad[k]
        share = np.where(feasible[k], (np.abs(q - poses[-1]) / step).max(axis=2), np.inf)
        b, j = (int(i) for i in np.unravel_index(int(np.argmin(share)), share.shape))
        if not share[b, j] <= 1.0:
            break
        poses.append(q[b, _uphill(found.mu[k, b], share[b] <= 1.0, j)[0]])
    return np.array(poses)


class Top(NamedTuple):
    """The pose at which a climb of mu ends."""

    mu: float  #: [m^3]
    q_rad: Array  #: (n,)
    at_limit: bool  #: Whether mu would rise further beyond a joint limit.


def top_of(found: PoseMap, q: Array) -> Top | None:
    """Climb mu at the map's last time from the feasible pose nearest to q (n,)."""
    poses, may = found.q_rad[-1], found.feasible()[-1]
    if not may.any():
        return None
    away = np.where(may, np.abs(poses - q).sum(axis=2), np.inf)
    b, j = (int(i) for i in np.unravel_index(int(np.argmin(away)), away.shape))
    mu = found.mu[-1, b]
    top, side = _uphill(mu, may[b], j)
    return Top(float(mu[top]), poses[b, top], bool(mu[(top + side) % len(mu)] > mu[top]))


def _uphill(mu: Array, within: NDArray[np.bool_], j: int) -> tuple[int, int]:
    height = np.where(within, mu, -np.inf)
    side = 1 if height[(j + 1) % len(mu)] >= height[j - 1] else -1
    while height[(j + side) % len(mu)] > mu[j]:
        j = (j + side) % len(mu)
    return j, side


def _blocked(found: PoseMap, start: Array, limits: Limits, bound: float) -> Blocked:
    robot, targets, names = found.robot, found.targets, found.robot.data.joint_names

    def nearest_limit(among: NDArray[np.bool_]) -> str:
        q = found.q_rad[k][among]
        beyond = np.where(
            robot.moves.any(axis=0), np.maximum(q - robot.q_max, robot.q_min - q) + limits.margin, -np.inf
        )
        return names[int(np.argmax(beyond[int(np.argmin(beyond.max(axis=1)))]))]

    each = reached(found, start, limits)
    k = min(len(each) + 1, len(targets) - 1)
    known, feasible = np.isfinite(found.mu[k]), found.feasible(limits.margin)[k]
    if not known.any():
        reason = "out of reach: no pose has tip and wrist there, even without joint limits"
    elif not feasible.any():
        reason = f"no pose there is within the joint limits: {nearest_limit(known)} is beyond its limit"
    else:
        step = limits.speed_share * robot.v_max * targets.period_s
        near, least = np.zeros(known.shape, dtype=np.bool_), np.full(robot.n, np.inf)
        for pose in found.q_rad[k - 1][each[-1]] if each else start[None]:
            shares = np.abs(found.q_rad[k] - pose) / step
            near |= known & (shares.max(axis=-1) <= 1.0)
            least = min(least, shares[feasible][int(np.argmin(shares[feasible].max(axis=1)))], key=np.max)
        doubt = " between poses of the map; on a finer map there may be a course" if np.isfinite(bound) else ""
        fast = names[int(np.argmax(least))]
        reason = f"{fast} would have to turn at {least.max():.3g} times its speed limit{doubt}"
        if near.any() and least.max() > 1.0:  # poses within reach are beyond a limit
            name = nearest_limit(near)
            reason = f"{name} runs into its limit; only other swivels or branches have poses within the limits"
    x, y, z = targets.tip[k].tolist()
    return Blocked(float(targets.t_s[k]), float(targets.arc_length_m[k]), (x, y, z), reason)
