"""Whether the third level of a scenario can follow the course that was planned for it, and what is in its way."""

from __future__ import annotations

import numpy as np

from moc_opt.errors import ControlError
from moc_opt.planning.plan import Plan
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.guided import followed_share

ROUNDING = 1e-6


def following_warnings(scenario: Scenario, plan: Plan) -> list[str]:
    """Say what keeps the scenario's third level from following the plan's course, each with its cure.

    Args:
        scenario: its [control] is asked.
        plan: of it.
    """
    settings, course = scenario.control, plan.course
    if settings.law != "moc":
        return [f"law = {settings.law!r} has no third level: nothing follows the course; take law = 'moc'"]
    found = []
    try:
        settings.check_guided()
    except ControlError as error:
        found.append(f"the course cannot be followed: {error}")
    if settings.backend == "c":
        found.append("backend = 'c' knows no course: take backend = 'python' to follow it")
    if course is None or len(course.t_s) < 2:
        return found
    robot = scenario.robot.arm()
    moving = np.asarray(robot.moves.any(axis=0))
    fastest = np.abs(np.diff(course.q_rad, axis=0)).max(axis=0) / plan.targets.period_s
    shares = np.where(moving, fastest / robot.v_max, 0.0)
    j, allowed = int(np.argmax(shares)), followed_share(settings)
    if shares[j] > allowed + ROUNDING:
        found.append(
            f"the course turns {robot.data.joint_names[j]} at {shares[j]:.2f} of its speed limit, and the third level "
            f"follows up to {allowed:.2f} (speed_fraction = {settings.speed_fraction:g}, a fifth for the feedback): "
            f"plan with --speed-share {allowed:.2f}, as third_level = 'planned' does"
        )
    margins = settings.limit_margins(robot.chain.prismatic)
    room = np.minimum(course.q_rad - robot.q_min, robot.q_max - course.q_rad).min(axis=0)
    short = np.where(moving, margins - room, -1.0)
    j = int(np.argmax(short))
    if short[j] > ROUNDING:
        found.append(
            f"the course comes to {room[j]:.3f} of the limit of {robot.data.joint_names[j]}; the third level's box "
            f"closes at {margins[j]:g}: plan with --margin {margins[j]:g}, or lower limit_margin_rad"
        )
    return found
