"""The plan of a path before a run: whether it can be executed, from where, how well, and the course itself."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from moc_opt.errors import TaskError, is_number
from moc_opt.inputs.notebook import table_html
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.planning.blocked import Blocked, blocked
from moc_opt.planning.candidates import usable_courses
from moc_opt.planning.climb import climb
from moc_opt.planning.course import OBJECTIVES, Course, Objective, make_course, margin_at
from moc_opt.planning.pose_map import SWIVELS, Margin, PoseMap, check_swivels, spherical_map
from moc_opt.planning.search import Search, search
from moc_opt.planning.shaft import keeping_shaft, largest, lowered
from moc_opt.planning.spherical import spherical
from moc_opt.planning.targets import Targets
from moc_opt.planning.traced import STEP_RAD, traced_map
from moc_opt.redundancy.arm_angle import Elbow


@dataclass(frozen=True, eq=False)
class Plan:
    """A path planned from one start; k times, n joints.

    Example:
        >>> plan = mo.plan(mo.Scenario(duration_s=1.0), times=20, refined=False)
        >>> plan.executable, plan.course.q_rad.shape, plan.climbed_whole
        (True, (20, 7), True)
        >>> bool(plan.from_start.mu_mean <= plan.best.mu_mean <= plan.bound)
        True
    """

    objective: Objective
    """Objective of the best courses: "mean" mu, "worst" mu, or the mean of "log" mu."""
    targets: Targets
    """Targets of tip and wrist on the path, (k,3) each [m], at (k,) times [s]."""
    from_start: Course | None
    """The best course from the start; None: the path cannot be executed from there."""
    best: Course | None
    """The best over all swivels and branches at the start of the path; None: from nowhere."""
    climbed: Course
    """The course of a local climb; shorter than the path if the climb ends at a limit."""
    bound_from_start: float
    """No course from the start that the map resolves is better, in the objective's unit; NaN where one was found that
    is: it passes so near a singular pose that mu changes within a step of the map."""
    bound: float
    """The same of every course, from any start."""
    blocked: Blocked | None
    """Where and why the path cannot be executed from the start; None: it can."""
    start_swivel_rad: float
    """Of the elbow at the start [rad]; see `moc_opt.redundancy.arm_angle`."""
    best_swivel_rad: float
    """The start swivel proposed: that of ``best``; NaN: there is none."""
    swivel_rad: Array
    """(k,) of ``course`` [rad]; empty where there is none"""
    map_s: float
    """Time for the map [s]."""
    search_s: float
    """Time for the courses by dynamic programming, without their bounds [s]."""
    bound_s: float
    """Time for their bounds [s]."""
    refine_s: float
    """Time for refining them [s]."""

    def __repr__(self) -> str:
        return f"Plan({', '.join(f'{name}: {value}' for name, value in self._shown().items())})"

    def _repr_html_(self) -> str:
        """Show itself in a notebook."""
        return table_html("Plan", self._shown())

    def _shown(self) -> dict[str, str]:
        """Answer in words what a plan is made for; `moc_opt.report.plan_table` has all of it."""
        found = {"executable": "yes"}
        if self.blocked is not None:
            found = {"executable": "no", "blocked": f"at t = {self.blocked.t_s:.3f} s, {self.blocked.reason}"}
        for name, course in (("from the start", self.from_start), ("best", self.best), ("local climb", self.climbed)):
            if course is not None and len(course.mu):
                part = "" if len(course.mu) == len(self.targets) else f", to t = {course.t_s[-1]:.3f} s only"
                found[f"mean mu {name}"] = f"{course.mu_mean:.4g} m^3{part}"
        if np.isfinite(self.best_swivel_rad):
            found["swivel at the start"] = f"{self.start_swivel_rad:.3f} rad, best {self.best_swivel_rad:.3f} rad"
        return {**found, "objective": self.objective}

    @property
    def executable(self) -> bool:
        """Whether the whole path can be executed from the start, in joint limits and speeds, shaft in the trocar."""
        return self.from_start is not None

    @property
    def course(self) -> Course | None:
        """The course to follow: from the start, or the best where there is none from there."""
        return self.from_start if self.from_start is not None else self.best

    @property
    def climbed_whole(self) -> bool:
        """Whether the local climb gets to the end of the path."""
        return len(self.climbed.mu) == len(self.targets)


def make_plan(
    robot: RobotModel,
    q_start: Array,
    targets: Targets,
    objective: Objective = "mean",
    *,
    swivels: int = SWIVELS,
    margin: Margin = 0.0,
    speed_share: float = 1.0,
    acceleration: float = np.inf,
    shaft_margin: float = 0.0,
    refined: bool = True,
    elsewhere: bool = True,
    known: PoseMap | None = None,
) -> Plan:
    """Plan a path from one start.

    Args:
        robot: the arm.
        q_start: (n,) with tip and wrist at the first target [rad].
        targets: of tip and wrist at k evenly spaced times, (k,3) each [m].
        objective: "mean", "worst" or "log".
        swivels: samples of one turn; of an arm without a closed form see `map_of`.
        margin: that every joint keeps from its limits, one number or (n,) [rad], [m] where a joint slides; a start
            that is nearer to one lowers it, see `margin_at`.
        speed_share: of the joints' speed limits that a course may use, above 0 to 1.
        acceleration: most of any joint, from rest [rad/s^2]; the refinement keeps it, the grid ignores it.
        shaft_margin: a share of the squared lever, below which no course goes where the path and the start leave it
            another way (`shaft.keeping_shaft`); bounds are of courses that keep it, NaN where the one found does not.
        refined: whether courses are improved beyond the grid, and looked for where only the grid has none.
        elsewhere: whether other starts are planned, too; else ``best`` is the course from the start, without a bound.
        known: `map_of` these targets and this start, if it was made before.

    Raises:
        TaskError: an argument is out of range, or the start is not at the first target.
        RobotError: fewer than 8 swivels, or more than `pose_map.MOST_SWIVELS`.
    """
    check_limits(robot, objective, margin, speed_share, shaft_margin)
    tips, wrists = robot.tool_along(np.asarray(q_start, dtype=np.float64)[None])
    off = max(np.abs(tips[0] - targets.tip[0]).max(), np.abs(wrists[0] - targets.wrist[0]).max())
    if off > 1e-6:
        raise TaskError(f"q_start: tip or wrist is {1e3 * off:.3g} mm from the path's first point: begin it there")
    if not is_number(acceleration) or not acceleration > 0.0:
        raise TaskError(f"acceleration = {acceleration!r}: give a limit above 0")
    if np.isfinite(acceleration) and not refined:
        raise TaskError(f"acceleration = {acceleration!r}: the grid alone knows no such limit; give refined = True")
    margin = margin_at(robot, q_start, margin)
    began = time.perf_counter()
    whole = map_of(robot, q_start, targets, swivels) if known is None else known
    found, most = keeping_shaft(whole, robot, shaft_margin, objective), largest(whole)
    mapped = time.perf_counter()
    step = speed_share * robot.v_max * targets.period_s
    start = (np.array(q_start, dtype=np.float64), float(robot.state(q_start).mu))
    starts = (start, None) if elsewhere else (start,)
    answers = [search(found, step, objective, start=begin, margin=margin) for begin in starts]
    searched = time.perf_counter()
    bounds = [
        search(found, step, objective, start=begin, margin=margin, generous=True) for begin in starts
    ]
    bounded = time.perf_counter()

    def worth(course: Course) -> tuple[float, float]:
        judged = lowered(course, robot, shaft_margin, most, objective)
        return judged.value(objective), judged.mu_mean

    courses = [
        max(
            usable_courses(
                robot, whole, [answer, bound] if refined else [answer], begin, objective, margin=margin,
                speed_share=speed_share, acceleration=acceleration, shaft_margin=shaft_margin, refined=refined,
            ), key=worth, default=None,
        ) for answer, bound, begin in zip(answers, bounds, starts, strict=True)
    ]  # fmt: skip
    took = mapped - began, searched - mapped, bounded - searched, time.perf_counter() - bounded
    mine, best = courses[0], courses[-1]
    if mine is not None and (best is None or worth(mine) > worth(best)):
        best = mine  # the given start is one of all starts
    elbow = Elbow(robot, targets.wrist)
    shown = mine if mine is not None else best
    return Plan(
        objective, targets, mine, best,
        make_course(robot, targets, climb(found, step, start[0], margin), margin, speed_share),
        _bound(bounds[0], mine, objective),
        bound=_bound(bounds[1], best, objective) if elsewhere else np.nan,
        blocked=None if mine is not None else blocked(
            robot, found, answers[0], start[0], step, margin, proven=bounds[0].q_rad is None
        ),
        start_swivel_rad=float(elbow.swivel(start[0][None])[0]),
        best_swivel_rad=np.nan if best is None else float(elbow.swivel(best.q_rad[:1])[0]),
        swivel_rad=np.empty(0) if shown is None else np.unwrap(elbow.swivel(shown.q_rad)),
        map_s=took[0], search_s=took[1], bound_s=took[2], refine_s=took[3],
    )  # fmt: skip


def _bound(found: Search, course: Course | None, objective: Objective) -> float:
    """Return the map's bound on a course; NaN without a course, and where the course shows that it is none."""
    return np.nan if course is None or course.value(objective) > found.value else found.value


def map_of(robot: RobotModel, q_start: Array, targets: Targets, swivels: int = SWIVELS) -> PoseMap:
    """Make the map in closed form if the arm has one, else by continuation; idle joints stay as at the start.

    More than `SWIVELS` samples of a turn make the samples along the curves of a continuation denser, too.
    """
    arm = spherical(robot)
    if arm is None:
        check_swivels(swivels)
        return traced_map(robot, targets, q_start, step_rad=STEP_RAD * min(1.0, SWIVELS / swivels))
    return spherical_map(robot, arm, targets, swivels=swivels, start=np.asarray(q_start, dtype=np.float64))


def check_limits(
    robot: RobotModel, objective: Objective, margin: Margin, speed_share: float, shaft_margin: float
) -> None:
    """Check the limits of a plan; arguments as of `make_plan`.

    Raises:
        TaskError: one is out of range.
    """
    if not isinstance(objective, str) or objective not in OBJECTIVES:
        raise TaskError(f"objective = {objective!r}: choose one of {', '.join(map(repr, OBJECTIVES))}")
    if not is_number(speed_share) or not 0.0 < speed_share <= 1.0:
        raise TaskError(f"speed_share = {speed_share!r}: give a share above 0 up to 1")
    one = is_number(margin) or (isinstance(margin, np.ndarray) and margin.shape == (robot.n,))
    if not one or not ((np.asarray(margin) >= 0.0) & (2.0 * np.asarray(margin) < robot.q_max - robot.q_min)).all():
        name = "margin_rad" if is_number(margin) else "margin_rad and margin_m, joint by joint,"
        raise TaskError(f"{name} = {margin!r}: give zero or more, and less than half of every joint's range")
    if not is_number(shaft_margin) or not 0.0 <= shaft_margin <= 1.0:
        raise TaskError(f"shaft_margin = {shaft_margin!r}: give a share of the squared lever from 0 to 1")
