"""Whether the third level of a scenario can follow the course planned for it, and the reason if not."""

from __future__ import annotations

from typing import TypedDict

import numpy as np

from moc_opt.errors import ControlError
from moc_opt.planning.course import Objective
from moc_opt.planning.plan import Plan
from moc_opt.planning.shaft import COURSE_SHARE
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.course_file import ROUNDING, speed_shares
from moc_opt.scenario.planned import plan


class Within(TypedDict):
    """The limits of a plan, as arguments of `moc_opt.scenario.planned.plan`."""

    margin_rad: float
    margin_m: float
    speed_share: float
    shaft_margin: float


def followable_plan(
    scenario: Scenario, margin_rad: float | None, speed_share: float | None, *, objective: Objective,
    acceleration: float, margin_m: float | None = None, followed: bool | None = None,
) -> tuple[Plan, Within]:  # fmt: skip
    """Plan within what a third level keeps to that follows a course, or within the arm's own limits.

    Args:
        scenario: of the run.
        margin_rad, margin_m, speed_share: in place of these, where given; a margin alone leaves the other at zero.
        objective, acceleration: as of `moc_opt.scenario.planned.plan`.
        followed: whether the course is to be followed; None: if the scenario's third level follows one.

    Raises:
        MocOptError: as of `moc_opt.scenario.planned.plan`.
    """
    settings = scenario.control
    follows = settings.follows if followed is None else followed
    if speed_share is None:
        speed_share = settings.course_speed_fraction if follows else 1.0
    shaft = COURSE_SHARE * settings.shaft_margin if follows else 0.0
    # The two margins that `guided` tries, too.
    slides = scenario.robot.arm().chain.prismatic.any()
    margins = [(settings.course_margin_rad, settings.limit_margin_m if slides else 0.0)] if follows else []
    given = margin_rad is not None or margin_m is not None
    for turning, sliding in [(margin_rad or 0.0, margin_m or 0.0)] if given else [*margins, (0.0, 0.0)]:
        within: Within = {
            "margin_rad": turning, "margin_m": sliding, "speed_share": speed_share, "shaft_margin": shaft
        }  # fmt: skip
        found = plan(scenario, objective=objective, acceleration=acceleration, **within)
        if found.executable:
            break
    return found, within


def following_warnings(scenario: Scenario, found: Plan) -> list[str]:
    """Say what keeps the scenario's third level from following a plan's course, each with its cure.

    Args:
        scenario: its [control] is asked.
        found: its plan.
    """
    settings, course = scenario.control, found.course
    if settings.law != "moc":
        return [f"law = {settings.law!r} has no third level: nothing follows the course; take law = 'moc'"]
    said = []
    try:
        settings.check_guided()
    except ControlError as error:
        said.append(f"the course cannot be followed: {error}")
    if settings.backend == "c":
        said.append("backend = 'c' knows no course: take backend = 'python' to follow it")
    if course is None or len(course.t_s) < 2:
        return said
    robot = scenario.robot.arm()
    moving = np.asarray(robot.moves.any(axis=0))
    shares = np.where(moving, speed_shares(robot, course.q_rad, found.targets.period_s), 0.0)
    j, allowed = int(np.argmax(shares)), settings.course_speed_fraction
    if shares[j] > allowed + ROUNDING:
        said.append(
            f"the course moves {robot.data.joint_names[j]} at {shares[j]:.2f} of its speed limit; the third level "
            f"follows up to [control] course_speed_fraction = {allowed:g}: plan with --speed-share {allowed:g}"
        )
    margins = np.where(robot.chain.prismatic, settings.limit_margin_m, settings.course_margin_rad)
    room = np.minimum(course.q_rad - robot.q_min, robot.q_max - course.q_rad).min(axis=0)
    short = np.where(moving, margins - room, -1.0)
    j = int(np.argmax(short))
    turns = "rad", "course_margin_rad", "--margin"
    unit, key, option = ("m", "limit_margin_m", "--margin-m") if robot.chain.prismatic[j] else turns
    if short[j] > ROUNDING:
        said.append(
            f"the course takes {robot.data.joint_names[j]} to within {room[j]:.3f} {unit} of its limit; the third "
            f"level keeps {margins[j]:g} {unit}: plan with {option} {margins[j]:g}, or lower {key}"
        )
    return said
