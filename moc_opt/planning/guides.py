"""Make the guides of a run. A guide gives level 3 (null space) its desired joint velocity, from a planned course."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from moc_opt.arrays import Array
from moc_opt.control.controller import Guide
from moc_opt.control.settings import ControlSettings
from moc_opt.errors import ScenarioError, TaskError, TraceError, is_number, shown
from moc_opt.planning.course import Course, Limits, Margin, Targets, between, make_course, margin_at
from moc_opt.planning.follow import CATCH_UP, NO_COURSE, NODES, Follower, Planner
from moc_opt.planning.plan import make_plan
from moc_opt.planning.pose_map import map_of
from moc_opt.planning.program import SETTLED_S, SMOOTH_LOSS, Program, refine
from moc_opt.planning.search import WHOLE_CELL, Value, Way, keeping_shaft
from moc_opt.robots.model import RobotModel
from moc_opt.trace.trace import Trace

COURSE_SHARE = 0.25  #: Courses try to keep this share of ``[control] shaft_margin``.
V_PERIOD_S = 0.1  #: Time step of the pose map.
TARGETS_PER_TIME = 20  #: Targets per time step of the map.
HALF_CELL = 0.5
"""First value tried for `Value`'s ``cell``, by which steps may exceed their limits. With 0, courses near singular poses
would be lost."""
SPEEDS = (1.0, 0.7, 0.4)
"""Factors on ``[control] course_speed_fraction``, tried in this order until a course is smooth and can brake."""
HURRY, WORTH_IT = 1.12, 0.01
"""The speed factor `HURRY` is tried before `SPEEDS` if it raises mean mu by more than the share `WORTH_IT`."""
FASTEST = 0.97  #: Largest speed share that `HURRY` gives. A larger ``course_speed_fraction`` stays as it is.
BRAKE_SHARE = 0.9  #: Limit on the braking of courses made before the run, as a share of `Following.brake`.
SMOOTHNESS = {"planned": 1e-4, "receding": 5e-4}
"""Weight of the squared acceleration [s^4/rad^2] of courses made before the run (planned) or during it (receding)."""
MOST_OFF_M = 1e-3  #: Distance of tip or wrist from its target, above which a course file is refused.
MOST_OFF_RAD = 1e-6  #: Tolerance of a course file's first pose, and of its excess over joint limits.
ROUNDING = 1e-6  #: Tolerance for a course file's first time [s], duration (relative) and speeds (share of the limits).
PLAN_IT = "plan it for this scenario: moc-opt plan SCENARIO --out FILE"


@dataclass(frozen=True)
class Following:
    """A run whose third level follows a course."""

    robot: RobotModel
    q_start: Array  #: (n,) [rad]
    settings: ControlSettings
    targets: Callable[..., Targets]  #: takes the wanted time between targets [s], and a factor on their number
    brake: float  #: safety filter's deceleration before a joint limit [rad/s^2]
    period_s: float  #: control period

    def stuck(self, part: float) -> ScenarioError:
        """Return the error for a path without a course at speeds up to ``part`` times ``course_speed_fraction``."""
        limits = Limits(speed_share=part * self.settings.course_speed_fraction)
        stuck = make_plan(self.robot, self.q_start, self.targets(), limits, refined=False).blocked
        where = "" if stuck is None else f"{1e3 * stuck.arc_length_m:.1f} mm along the path, {stuck.reason}"
        return ScenarioError(
            f"[control] third_level = {self.settings.third_level!r}: from this start, no course reaches the end of the "
            f"path: {where}; see `moc-opt plan`, or use third_level = 'local'"
        )


class Ways:
    """A coarse pose map of a path, and the best course on it for each speed."""

    def __init__(self, run: Following) -> None:
        self.run, settings = run, run.settings
        self.fine = run.targets(period_s=V_PERIOD_S, finer=TARGETS_PER_TIME)
        whole = map_of(run.robot, run.q_start, self.fine[::TARGETS_PER_TIME])
        self.shaft = COURSE_SHARE * settings.shaft_margin
        self._map = keeping_shaft(whole, Limits(shaft=self.shaft))
        #: Mean over time of the largest feasible mu on the map [m^3].
        self.usual = float(np.where(whole.feasible(), whole.mu, 0.0).max(axis=(1, 2)).mean())
        self._known: dict[float, tuple[Value, Limits, Way]] = {}

    @property
    def speeds(self) -> tuple[float, ...]:
        """The speed factors to try, in this order."""
        q, mu = self.run.q_start, float(self.run.robot.state(self.run.q_start).mu)
        usual, fast = (self.at(part)[0].of(q, mu) for part in (1.0, HURRY))
        return (HURRY, *SPEEDS) if fast > (1.0 + WORTH_IT) * usual else SPEEDS

    def at(self, part: float) -> tuple[Value, Limits, Way]:
        """Return value function, limits and best coarse course at ``part`` times ``course_speed_fraction``.

        Raise a ScenarioError if there is no course.
        """
        if part not in self._known:
            run, settings = self.run, self.run.settings
            margin = margin_of(run.robot, settings.course_margin_rad, settings.limit_margin_m)
            share = part * settings.course_speed_fraction
            share = share if part <= 1.0 else max(min(share, FASTEST), settings.course_speed_fraction)
            price = SMOOTHNESS["receding"] / SETTLED_S**2 * self.usual
            margins = margin_at(run.robot, run.q_start, margin), 0.0
            for cell, kept in itertools.product((HALF_CELL, WHOLE_CELL), margins):
                limits = Limits(kept, share, shaft=self.shaft)
                value = Value(self._map, limits, cell=cell, price=price)
                way = value.way(run.q_start)
                if way is not None:
                    self._known[part] = value, limits, way
                    break
            else:
                raise run.stuck(part)
        return self._known[part]


def guides(run: Following) -> Callable[[], Guide] | None:
    """Plan the run once, and return a function that makes a guide for each controller.

    With ``third_level = "local"``, return None.

    Raises:
        ControlError: the settings do not allow a course.
        ScenarioError: the path cannot be executed from the start.
        TaskError: no smooth course was found at the start.
    """
    settings, period = run.settings, run.period_s
    if settings.third_level == "local":
        return None
    settings.check_guided()
    if settings.third_level == "receding":
        make = replanned(Ways(run))
        return lambda: Follower(period, planner=make(), q_start=run.q_start)
    ways = Ways(run)
    course = followed_course(run, ways)
    try:
        rescue = replanned(ways)
    except (ScenarioError, TaskError):  # the course can still be followed without a planner
        return lambda: Follower(period, course=course)
    return lambda: Follower(period, course=course, planner=rescue())


def replanned(ways: Ways) -> Callable[[], Planner]:
    """Return a function that makes a planner with a receding horizon."""
    run, settings, smooth = ways.run, ways.run.settings, SMOOTHNESS["receding"]
    # The last two attempts have no braking constraint, and the last attempt has no shaft margin either.
    ladder = [(part, run.brake, True) for part in ways.speeds]
    for part, brake, kept in [*ladder, (SPEEDS[-1], np.inf, True), (SPEEDS[-1], np.inf, False)]:
        value, limits, _ = ways.at(part)
        held = replace(limits, speed_share=CATCH_UP * limits.speed_share, shaft=limits.shaft if kept else 0.0)
        program = Program(
            run.robot, NODES, V_PERIOD_S, held, mu=ways.usual, smoothness=smooth, brake=brake, horizon=True
        )

        def make(value: Value = value, program: Program = program) -> Planner:
            return Planner(
                value, copy(program), ways.fine, horizon_s=settings.horizon_s, rate_per_s=settings.replan_per_s
            )

        if make().plan(run.q_start, 0.0, None) is not None:
            return make
    raise TaskError(NO_COURSE)


def followed_course(run: Following, ways: Ways | None = None) -> Course:
    """Find a smooth course from the run's start.

    Raises:
        ScenarioError: no course reaches the end of the path, or the course file is refused.
        TaskError: no smooth course was found.
    """
    robot, targets, brake, smooth = run.robot, run.targets(), BRAKE_SHARE * run.brake, SMOOTHNESS["planned"]
    if run.settings.course:
        course, limits = load_course(run.settings, robot, run.q_start, targets)
        for rule in (brake, np.inf):
            found = refine(robot, targets, course, limits, smoothness=smooth, brake=rule)
            if found is not course:
                return found
        return course  # no smooth course with nearly the same mu was found
    ways, other = ways or Ways(run), []
    for part, rule in [*((part, brake) for part in ways.speeds), (SPEEDS[-1], np.inf)]:
        _, limits, way = ways.at(part)
        course = make_course(robot, targets, between(targets.t_s, way.t_s, way.q_rad), limits)
        found = refine(robot, targets, course, limits, smoothness=smooth, brake=rule)
        if found.kept:
            other.append(found)
            if found.mu_mean > (1.0 - SMOOTH_LOSS) * course.mu_mean:
                return found
    if not other:
        raise TaskError(NO_COURSE)
    return max(other, key=lambda course: course.mu_mean)


def load_course(
    settings: ControlSettings, robot: RobotModel, q_start: Array, targets: Targets
) -> tuple[Course, Limits]:
    """Read the file of ``[control] course``; return its course at the targets, and limits for `refine`.

    Raises:
        ScenarioError: the file cannot be read, or the third level cannot follow its course.
    """

    def refused(why: str, cure: str = PLAN_IT) -> ScenarioError:
        return ScenarioError(f"[control] course = {shown(settings.course)}: {why}; {cure}")

    try:
        trace = Trace.load(settings.course)
    except TraceError as error:
        raise refused(f"it is no course file ({error})") from error
    t, q = (trace.columns.get(name, np.empty(0)) for name in ("t_s", "q_rad"))
    if why := _no_course(trace, t, q, robot):
        raise refused(why)
    off, cure = float(np.abs(q[0] - q_start).max()), PLAN_IT
    if off > MOST_OFF_RAD:
        if trace.meta.get("from_start") is False:
            cure = f"begin the run there: [start] q_rad = {[round(angle, 9) for angle in q[0].tolist()]}"
        raise refused(f"it begins {off:.3g} rad from the start of the run", cure)
    poses, end_s = between(targets.t_s, t, q), float(targets.t_s[-1])
    if abs(t[0]) > ROUNDING or abs(t[-1] - end_s) > ROUNDING * end_s:
        raise refused(f"it goes from {t[0]:.4g} to {t[-1]:.4g} s, the run from 0 to {end_s:.4g}")
    tips, wrists = robot.tool_along(poses)
    away = np.maximum(np.linalg.norm(tips - targets.tip, axis=1), np.linalg.norm(wrists - targets.wrist, axis=1))
    k = int(np.argmax(away))
    if away[k] > MOST_OFF_M:
        raise refused(f"tip or wrist is {1e3 * away[k]:.3g} mm from its target at t = {targets.t_s[k]:.3g} s")
    shares = speed_shares(robot, poses, targets.period_s)
    if (fast := too_fast_to_follow(settings, robot, shares)) is not None:
        raise refused(*fast)
    beyond = np.maximum(poses - robot.q_max, robot.q_min - poses).max(axis=0)
    j = int(np.argmax(beyond))
    if beyond[j] > MOST_OFF_RAD:
        raise refused(f"{robot.data.joint_names[j]} goes {beyond[j]:.3g} rad beyond its limit")
    within = {"margin_rad": 0.0, "margin_m": 0.0, "speed_share": 1.0, "shaft_margin": 0.0}
    within |= trace.meta.get("within", {})
    margin = margin_of(
        robot, max(settings.course_margin_rad, within["margin_rad"]), max(settings.limit_margin_m, within["margin_m"])
    )
    allowed, fastest = settings.course_speed_fraction, float(shares.max())
    limits = Limits(
        # With a larger margin than the file's course keeps, there might be no smooth course.
        margin_at(robot, poses, margin), max(fastest, min(allowed, within["speed_share"])),
        max(COURSE_SHARE * settings.shaft_margin, within["shaft_margin"]),
    )  # fmt: skip
    return make_course(robot, targets, poses, Limits(speed_share=allowed)), limits


def _no_course(trace: Trace, t: Array, q: Array, robot: RobotModel) -> str:
    if trace.meta.get("kind") != "course":
        return "the file holds no course"
    if q.shape != (len(t), robot.n) or len(t) < 2 or not t.dtype == q.dtype == np.float64:
        return f"t_s has shape {t.shape} and q_rad {q.shape}, not floats (k,) and (k, {robot.n}) with k > 1"
    if not (np.isfinite(q).all() and (np.diff(t) > 0.0).all()):
        return "its times t_s do not rise, or a pose is not finite"
    if trace.meta.get("robot", robot.data.name) != robot.data.name:
        return f"it is a course of robot {shown(trace.meta['robot'])}, but the run has {robot.data.name!r}"
    return ""


def speed_shares(robot: RobotModel, poses: Array, period_s: float) -> Array:
    """Return (largest speed) / (speed limit) of each joint, (n,), along poses (k,n)."""
    fastest: Array = np.abs(np.diff(poses, axis=0)).max(axis=0) / (period_s * robot.v_max)
    return fastest


def too_fast_to_follow(settings: ControlSettings, robot: RobotModel, shares: Array) -> tuple[str, str] | None:
    """Return (message, cure) if one of the `speed_shares` (n,) is too large for the third level, else None."""
    allowed = settings.course_speed_fraction
    shares = np.where(robot.moves.any(axis=0), shares, 0.0)
    j = int(np.argmax(shares))
    if shares[j] <= allowed + ROUNDING:
        return None
    said = f"{robot.data.joint_names[j]} moves at {shares[j]:.3f} of its speed limit; the third level follows up to "
    return f"{said}[control] course_speed_fraction = {allowed:g}", f"plan it with --speed-share {allowed:g}"


def margin_of(robot: RobotModel, margin_rad: float, margin_m: float) -> Margin:
    """Return ``margin_rad`` or, if a joint slides, the margins of all joints (n,). A negative one raises TaskError."""
    for name, value in (("margin_rad", margin_rad), ("margin_m", margin_m)):
        if not (is_number(value) and 0.0 <= value < np.inf):
            raise TaskError(f"{name} = {value!r}: give zero or more, and less than half of every joint's range")
    slides = robot.chain.prismatic
    return np.where(slides, margin_m, margin_rad) if slides.any() else margin_rad
