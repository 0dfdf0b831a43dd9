"""The guides of ``[control] third_level``, which replace the climb of mu in the third level."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy

import numpy as np

from moc_opt.control.guide import Guide
from moc_opt.errors import ScenarioError, TaskError
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.planning.course import Course, margin_at
from moc_opt.planning.follow import Follower
from moc_opt.planning.horizon import Horizon
from moc_opt.planning.plan import Plan, make_plan, map_of
from moc_opt.planning.pose_map import Margin
from moc_opt.planning.receding import CATCH_UP, NODES, Receding
from moc_opt.planning.refine import SETTLED_S, refine
from moc_opt.planning.shaft import COURSE_SHARE, keeping_shaft
from moc_opt.planning.targets import Targets
from moc_opt.planning.to_go import ToGo
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.course_file import Given, load_course
from moc_opt.scenario.layout import Layout
from moc_opt.scenario.planned import margin_of, targets_of

V_PERIOD_S = 0.1
"""Between the times of the map under a receding horizon: so long that the way from pose to pose of the map is small
beside what a joint turns in it."""
TARGETS_PER_TIME = 20
"""Targets between two times of that map: the horizon interpolates between them."""
SPEEDS = (1.0, 0.7, 0.4)
"""Of a course's speed, one after the other where no faster one is smooth and brakes off in time; the last one need not
brake where no course does."""
BRAKE_SHARE = 0.9
"""Of the deceleration that the safety filter's wall allows, a course that is made before the run uses this much."""
SMOOTHNESS = {"planned": 1e-4, "receding": 5e-4}
"""Weight of a course's acceleration [s^4/rad^2], see `moc_opt.planning.refine`; it lowers tip and RCM errors."""


def guides(scenario: Scenario, robot: RobotModel, layout: Layout) -> Callable[[], Guide] | None:
    """Compute once what ``[control] third_level`` needs, and return what makes a guide of it for each controller.

    Both keep to `course_speed_fraction` of the joint speeds, to `course_margin_rad` from the joint limits, or to no
    margin where the path cannot be executed with it, and to `COURSE_SHARE` of `shaft_margin` where there is a way.

    Returns:
        None: the third level climbs where it is.

    Raises:
        ControlError: the third level cannot follow under these settings.
        ScenarioError: the path cannot be executed from the start; says where and why.
    """
    settings = scenario.control
    if settings.third_level == "local":
        return None
    settings.check_guided()
    if settings.third_level == "receding":
        return replanned(scenario, robot, layout)
    course, period = followed_course(scenario, robot, layout), scenario.plant.period_s
    try:
        rescue = replanned(scenario, robot, layout)
    except (ScenarioError, TaskError):  # its coarser map has no way where the course has one
        return lambda: Follower(course, period)
    return lambda: Follower(course, period, rescue=rescue())


def replanned(scenario: Scenario, robot: RobotModel, layout: Layout) -> Callable[[], Receding]:
    """Compute the map and V of a receding horizon, and return what makes one of them.

    Raises:
        ScenarioError: the map has no way from the start to the end.
        TaskError: no smooth course was found at the start.
    """
    settings, period = scenario.control, scenario.plant.period_s
    fine = targets_of(robot, layout, period_s=V_PERIOD_S, finer=TARGETS_PER_TIME)
    each = slice(None, None, TARGETS_PER_TIME)
    path = Targets(fine.t_s[each], fine.tip[each], fine.wrist[each], fine.arc_length_m[each])
    smooth, found = SMOOTHNESS["receding"], map_of(robot, layout.q, path)
    shaft = COURSE_SHARE * settings.shaft_margin
    lowered = keeping_shaft(found, robot, shaft)

    def made(share: float, brake: float, held: float) -> Callable[[], Receding]:
        for margin in _margins(scenario, robot, layout.q):
            usual = float(np.nanmean(found.highest(margin)))
            to_go = ToGo(lowered, share * robot.v_max * path.period_s, margin, smooth / SETTLED_S**2 * usual)
            if to_go.way(layout.q, 0.0, len(path) - 1) is not None:
                break
        else:
            raise _stuck(scenario, make_plan(robot, layout.q, path, speed_share=share, refined=False))
        horizon = Horizon(
            robot, NODES, mu=usual, margin=margin, speed=CATCH_UP * share * robot.v_max, smoothness=smooth, brake=brake,
            shaft_margin=held,
        )  # fmt: skip
        return lambda: Receding(  # one program, of which each controller makes a solver of its own
            to_go, copy(horizon), robot, fine, layout.q, period, horizon_s=settings.horizon_s,
            rate_per_s=settings.replan_per_s,
        )  # fmt: skip

    ladder = [(part, scenario.guard.wall_brake_rad_per_s2, shaft) for part in SPEEDS]
    # Without braking in time, and at last with V alone to hold the course from losing the shaft.
    ladder += [(SPEEDS[-1], np.inf, shaft), (SPEEDS[-1], np.inf, 0.0)]
    for part, brake, held in ladder:
        make = made(part * settings.course_speed_fraction, brake, held)
        try:
            ready = [make()]
        except TaskError as error:
            failed = error
        else:
            return lambda: ready.pop() if ready else make()
    raise failed


def followed_course(scenario: Scenario, robot: RobotModel, layout: Layout) -> Course:
    """Return the best course in mean mu from the start of this run that the third level can follow, made smooth.

    Raises:
        ScenarioError: no course goes all the way, or the file of ``[control] course`` is refused.
    """
    settings, targets = scenario.control, targets_of(robot, layout)
    brake, fastest = BRAKE_SHARE * scenario.guard.wall_brake_rad_per_s2, settings.course_speed_fraction
    shaft = COURSE_SHARE * settings.shaft_margin
    if settings.course:  # as it is where smoothness would cost too much
        given = load_course(scenario, robot, layout.q, targets)
        shaft = max(shaft, given.shaft_margin)
        return _made_smooth(robot, targets, given, shaft, (brake, np.inf)) or given.course
    known = map_of(robot, layout.q, targets)
    for margin in _margins(scenario, robot, layout.q):
        for part in SPEEDS:
            share, rules = part * fastest, (brake,) if part > SPEEDS[-1] else (brake, np.inf)
            found = make_plan(
                robot, layout.q, targets, margin=margin, speed_share=share, shaft_margin=shaft, elsewhere=False,
                known=known,
            )  # fmt: skip
            if found.from_start is None:
                break
            given = Given(found.from_start, "mean", margin, share, acceleration=np.inf)
            smooth = _made_smooth(robot, targets, given, shaft, rules)
            if smooth is not None or np.inf in rules:
                return found.from_start if smooth is None else smooth
    raise _stuck(scenario, found)


def _made_smooth(
    robot: RobotModel, targets: Targets, given: Given, shaft: float, rules: tuple[float, ...]
) -> Course | None:
    """Return a course made smooth within its limits, under the first rule of braking that allows it; None: none does.

    Args:
        given: the course, and its limits.
        shaft: margin from losing the shaft.
        rules: decelerations before joint limits [rad/s^2]; inf: none is asked for.
    """
    for rule in rules:
        found = refine(
            robot, targets, given.course, given.objective, margin=given.margin, speed_share=given.speed_share,
            acceleration=given.acceleration, smoothness=SMOOTHNESS["planned"], brake=rule, shaft_margin=shaft,
        )  # fmt: skip
        if found is not given.course:
            return found
    return None


def _margins(scenario: Scenario, robot: RobotModel, start: Array) -> tuple[Margin, Margin]:
    """Return what a course keeps from the joint limits where it can, and where it cannot."""
    settings = scenario.control
    margin = margin_of(robot, settings.course_margin_rad, settings.limit_margin_m)
    return margin_at(robot, start, margin), 0.0


def _stuck(scenario: Scenario, found: Plan) -> ScenarioError:
    stuck = found.blocked
    where = "" if stuck is None else f"{1e3 * stuck.arc_length_m:.1f} mm along the path {stuck.reason}"
    return ScenarioError(
        f"[control] third_level = {scenario.control.third_level!r}: no course goes all the way from this start: "
        f"{where}; see `moc-opt plan`, or take third_level = 'local'"
    )
