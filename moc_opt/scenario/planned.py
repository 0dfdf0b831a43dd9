"""Plan a scenario's course before its run, and write it to a file."""

from __future__ import annotations

import numbers
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from moc_opt.errors import ControlError, ScenarioError, named, shown
from moc_opt.planning.course import Limits, Targets, lay_targets
from moc_opt.planning.guides import COURSE_SHARE, margin_of, speed_shares, too_fast_to_follow
from moc_opt.planning.plan import Plan, make_plan
from moc_opt.planning.pose_map import SWIVELS
from moc_opt.robots.model import RobotModel
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.layout import Layout, described, lay_out
from moc_opt.trace.trace import Trace

PERIOD_S, MOST_TIMES = 0.025, 1000  # time between two points of a plan [s]; largest number of points


def plan(
    scenario: Scenario | str | os.PathLike[str], *, times: int | None = None, swivels: int = SWIVELS,
    margin_rad: float = 0.0, margin_m: float = 0.0, speed_share: float = 1.0, shaft_margin: float = 0.0,
    refined: bool = True,
) -> Plan:  # fmt: skip
    """Plan a scenario's course, and find out whether the arm can execute the path.

    Args:
        scenario: a scenario, or the path of its file.
        times: number of points on the path. None: one per `PERIOD_S`, but at most `MOST_TIMES`.
        swivels: number of samples per turn of the elbow.
        margin_rad, margin_m: required distance of revolute joints [rad] and prismatic joints [m] from their limits.
        speed_share: usable share of the joints' speed limits, above 0 and at most 1.
        shaft_margin: soft lower bound on (wrist's manipulability at a fixed tip) / (distance from wrist to tip)^2.
        refined: whether a nonlinear program improves the course.

    Raises:
        MocOptError: the scenario's start, path or trocar is not usable, or an argument is out of range.
    """
    scenario = Scenario.load(scenario)
    if times is not None and (not isinstance(times, numbers.Integral) or not 2 <= times <= 100_000):
        raise ScenarioError(f"times = {shown(times)}: give 2 to 100000 points of the path")
    robot = scenario.robot.arm()
    layout = lay_out(scenario, robot, checked=False)
    limits = Limits(margin_of(robot, margin_rad, margin_m), speed_share, shaft_margin)
    with named(f"{scenario.task.in_words}:"):
        targets = targets_of(robot, layout, times)
    return make_plan(robot, layout.q, targets, limits, swivels=swivels, refined=refined)


def targets_of(
    robot: RobotModel, layout: Layout, times: int | None = None, *, period_s: float = PERIOD_S, finer: int = 1
) -> Targets:
    """Return ``times`` targets of tip and wrist, evenly spaced in time over the run.

    If ``times`` is None, there is one per ``period_s`` / ``finer`` [s], but at most `MOST_TIMES` * ``finer``.
    """
    spaces = int(np.clip(np.ceil(layout.duration_s / period_s), 1, MOST_TIMES - 1))
    span, length = robot.state(layout.q).tool_span, robot.data.tool_length
    count = times or finer * spaces + 1
    return lay_targets(layout.reference, layout.registered, span, layout.duration_s, count, length)


def followable_plan(
    scenario: Scenario, margin_rad: float | None = None, speed_share: float | None = None,
    margin_m: float | None = None, followed: bool | None = None,
) -> tuple[Plan, dict[str, float]]:
    """Plan a course within limits, and return the plan and the limits.

    ``followed`` says whether level 3 follows the course (None: as in [control]). If it follows, a missing speed share
    comes from [control], otherwise it is 1. If it follows and both margins are missing, the margins of [control] are
    tried first, then margins of 0 if no course from the start keeps those. In all other cases, a missing margin is 0.
    """
    settings = scenario.control
    follows = settings.follows if followed is None else followed
    margins = [(margin_rad or 0.0, margin_m or 0.0)]
    if follows and margin_rad is None and margin_m is None:
        slides = scenario.robot.arm().chain.prismatic.any()
        margins.insert(0, (settings.course_margin_rad, settings.limit_margin_m if slides else 0.0))
    if speed_share is None:
        speed_share = settings.course_speed_fraction if follows else 1.0
    shaft = COURSE_SHARE * settings.shaft_margin if follows else 0.0
    for turning, sliding in margins:
        within = {"margin_rad": turning, "margin_m": sliding, "speed_share": speed_share, "shaft_margin": shaft}
        found = plan(scenario, **within)  # type: ignore[arg-type]
        if found.executable:
            break
    return found, within


def following_warnings(scenario: Scenario, found: Plan) -> list[str]:
    """Return the reasons why level 3 cannot follow the plan's course."""
    settings, course, said = scenario.control, found.course, list[str]()
    if settings.law != "moc":
        return [f"law = {settings.law!r} has no third level: nothing follows the course; use law = 'moc'"]
    try:
        settings.check_guided()
    except ControlError as error:
        said.append(f"the course cannot be followed: {error}")
    if course is None or len(course.t_s) < 2:
        return said
    robot = scenario.robot.arm()
    fast = too_fast_to_follow(settings, robot, speed_shares(robot, course.q_rad, found.targets.period_s))
    return said if fast is None else [*said, "; ".join(fast)]


def save_course(found: Plan, scenario: Scenario, to: str | os.PathLike[str], within: Mapping[str, float]) -> Path:
    """Write the plan's course as a Parquet file for ``[control] course``.

    Columns: t_s (k,) [s], q_rad (k,n), mu (k,) [m^3], swivel_rad (k,), tip_m, tip_ref_m and wrist_m (k,3).
    ``within`` has the plan's limits, under the names of the arguments of `plan`.

    Raises:
        ScenarioError: no course reaches the end of the path.
        TraceError: the file cannot be written.
    """
    course = found.course
    if course is None:
        raise ScenarioError("no course reaches the end of the path: no file is written; change the [task]")
    robot = scenario.robot.arm()
    tips, wrists = robot.tool_along(course.q_rad)
    columns = {
        "t_s": course.t_s, "q_rad": course.q_rad, "mu": course.mu, "swivel_rad": found.swivel_rad,
        "tip_m": tips, "tip_ref_m": found.targets.tip, "wrist_m": wrists,
    }  # fmt: skip
    meta = {
        "kind": "course", "from_start": found.executable, "violation": course.violation,
        "certified": course.certified, **described(scenario, robot), "within": dict(within),
    }  # fmt: skip
    Trace(columns, meta).save(to)
    return Path(to)
