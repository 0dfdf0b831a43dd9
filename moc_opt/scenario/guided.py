"""The guides of ``[control] third_level``, which replace the climb of mu in the third level."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from functools import partial

import numpy as np

from moc_opt.arrays import Array
from moc_opt.control.guide import Guide
from moc_opt.control.settings import ControlSettings
from moc_opt.errors import ScenarioError, TaskError
from moc_opt.planning.course import Course, Limits, Targets, make_course, margin_at
from moc_opt.planning.follow import CATCH_UP, NODES, Follower, Planner
from moc_opt.planning.plan import best_course, make_plan
from moc_opt.planning.pose_map import PoseMap, map_of
from moc_opt.planning.program import SETTLED_S, Program, refine
from moc_opt.planning.search import WHOLE_CELL, Value, keeping_shaft
from moc_opt.robots.model import RobotModel
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.course_file import load_course
from moc_opt.scenario.layout import Layout
from moc_opt.scenario.planned import COURSE_SHARE, margin_of, targets_of

V_PERIOD_S = 0.1
"""Between the times of the map under a receding horizon: so long that the way from pose to pose of the map is small
beside what a joint turns in it."""
TARGETS_PER_TIME = 20
"""Targets between two times of that map: the horizon interpolates between them."""
QUARTER = 0.5
"""Of half a cell, what a pose of that map stands for."""
SPEEDS = (1.0, 0.7, 0.4)
"""Of a course's speed, one after the other where no faster one is smooth and brakes off in time; the last one need not
brake where no course does."""
BRAKE_SHARE = 0.9
"""Of the deceleration that the safety filter's wall allows, a course that is made before the run uses this much."""
SMOOTHNESS = {"planned": 1e-4, "receding": 5e-4}
"""Weight of a course's acceleration [s^4/rad^2], see `moc_opt.planning.program`; it lowers tip and RCM errors."""


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
    settings, period = scenario.control, scenario.plant.period_s
    if settings.third_level == "local":
        return None
    settings.check_guided()
    if settings.third_level == "receding":
        make = replanned(scenario, robot, layout)
        return lambda: Follower(period, planner=make(), q_start=layout.q)
    course = followed_course(scenario, robot, layout)
    try:
        rescue = replanned(scenario, robot, layout)
    except (ScenarioError, TaskError):  # its coarser map has no way where the course has one
        return lambda: Follower(period, course=course)
    return lambda: Follower(period, course=course, planner=rescue())


def replanned(scenario: Scenario, robot: RobotModel, layout: Layout) -> Callable[[], Planner]:
    """Compute the map and V of a receding horizon, and return what makes a planner on it.

    Raises:
        ScenarioError: the map has no way from the start to the end.
        TaskError: no smooth course was found at the start.
    """
    settings, smooth = scenario.control, SMOOTHNESS["receding"]
    fine = targets_of(robot, layout, period_s=V_PERIOD_S, finer=TARGETS_PER_TIME)
    whole = map_of(robot, layout.q, fine[::TARGETS_PER_TIME])
    lowered, usual = _keeping(scenario, whole), float(np.where(whole.feasible(), whole.mu, 0.0).max(axis=(1, 2)).mean())
    # The last ones without braking in time, and with V alone to hold the course from losing the shaft.
    ladder = [(part, scenario.guard.wall_brake_rad_per_s2, True) for part in SPEEDS]
    for part, brake, kept in [*ladder, (SPEEDS[-1], np.inf, True), (SPEEDS[-1], np.inf, False)]:
        for limits in _limits(scenario, robot, layout.q, part):
            value = Value(lowered, limits, cell=QUARTER, price=smooth / SETTLED_S**2 * usual)
            if value.way(layout.q) is not None:
                break
        else:
            raise _stuck(scenario, robot, layout, part)
        held = replace(limits, speed_share=CATCH_UP * limits.speed_share, shaft=limits.shaft if kept else 0.0)
        program = Program(
            robot, NODES, V_PERIOD_S, held, mu=usual, smoothness=smooth, brake=brake, horizon=True
        )
        # Each controller makes a solver of its own.
        make = partial(_planner, value, program, fine, settings)
        if make().plan(layout.q, 0.0, None) is not None:
            return make
    raise TaskError("q_start: no course goes to the end of the path from there within joint speeds and limits")


def _planner(value: Value, program: Program, fine: Targets, settings: ControlSettings) -> Planner:
    return Planner(value, copy(program), fine, horizon_s=settings.horizon_s, rate_per_s=settings.replan_per_s)


def followed_course(scenario: Scenario, robot: RobotModel, layout: Layout) -> Course:
    """Return the best course in mean mu from the start of this run that the third level can follow, made smooth.

    Raises:
        ScenarioError: no course goes all the way, or the file of ``[control] course`` is refused.
    """
    targets, brake = targets_of(robot, layout), BRAKE_SHARE * scenario.guard.wall_brake_rad_per_s2
    smooth = SMOOTHNESS["planned"]
    if scenario.control.course:
        course, limits, objective = load_course(scenario, robot, layout.q, targets)
        for rule in (brake, np.inf):
            found = refine(robot, targets, course, limits, objective, smoothness=smooth, brake=rule)
            if found is not course:
                return found
        return course  # as it is, where smoothness would cost too much
    lowered = _keeping(scenario, map_of(robot, layout.q, targets))
    for part in SPEEDS:
        for limits in _limits(scenario, robot, layout.q, part):
            # In whole cells where the grid's steps are just too coarse: the program puts the poses right.
            each = (best_course(Value(lowered, limits, cell=cell), limits, layout.q) for cell in (0.0, WHOLE_CELL))
            q = next((q for q in each if q is not None), None)
            if q is not None:
                break
        else:
            raise _stuck(scenario, robot, layout, part)
        course = make_course(robot, targets, q, limits)
        for rule in (brake,) if part > SPEEDS[-1] else (brake, np.inf):
            found = refine(robot, targets, course, limits, smoothness=smooth, brake=rule)
            if found is not course:
                return found
    if not course.kept:
        raise _stuck(scenario, robot, layout, part)
    return course


def _keeping(scenario: Scenario, found: PoseMap) -> PoseMap:
    return keeping_shaft(found, Limits(shaft=COURSE_SHARE * scenario.control.shaft_margin))


def _limits(scenario: Scenario, robot: RobotModel, start: Array, part: float) -> tuple[Limits, Limits]:
    """Return what a course keeps where it can, and where it cannot keep the margin from the joint limits."""
    settings = scenario.control
    margin = margin_at(robot, start, margin_of(robot, settings.course_margin_rad, settings.limit_margin_m))
    share, shaft = part * settings.course_speed_fraction, COURSE_SHARE * settings.shaft_margin
    return Limits(margin, share, shaft=shaft), Limits(0.0, share, shaft=shaft)


def _stuck(scenario: Scenario, robot: RobotModel, layout: Layout, part: float) -> ScenarioError:
    limits = Limits(speed_share=part * scenario.control.course_speed_fraction)
    stuck = make_plan(robot, layout.q, targets_of(robot, layout), limits, refined=False).blocked
    where = "" if stuck is None else f"{1e3 * stuck.arc_length_m:.1f} mm along the path {stuck.reason}"
    return ScenarioError(
        f"[control] third_level = {scenario.control.third_level!r}: no course goes all the way from this start: "
        f"{where}; see `moc-opt plan`, or take third_level = 'local'"
    )
