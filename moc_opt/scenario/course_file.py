"""A course as a file: what ``moc-opt plan --out`` writes, and ``[control] course`` follows."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import ControlError, ScenarioError, TraceError, shown
from moc_opt.planning.course import (
    OBJECTIVES,
    Course,
    Limits,
    Objective,
    Targets,
    between,
    make_course,
    margin_at,
)
from moc_opt.planning.plan import Plan
from moc_opt.robots.model import RobotModel
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.layout import described
from moc_opt.scenario.planned import COURSE_SHARE, margin_of
from moc_opt.trace.trace import Trace

MOST_OFF_M = 1e-3
"""So far tip or wrist may be off the run's targets; the program that makes a course smooth puts them there."""
LIMITS = {"margin_rad": 0.0, "margin_m": 0.0, "speed_share": 1.0, "acceleration": np.inf, "shaft_margin": 0.0}
"""What a course was planned for, and what stands for it in a file that does not say."""
MOST_OFF_RAD = 1e-6
"""So far the first pose may be from the run's start, a joint beyond a limit, and an idle joint from its start."""
ROUNDING = 1e-6
"""Of the first time [s]; of the last one, as a share of the run's, and of a speed, as a share of its limit."""
PLAN_IT = "plan it for this scenario: moc-opt plan SCENARIO --out FILE"


def save_course(
    found: Plan, scenario: Scenario, to: str | os.PathLike[str], within: Mapping[str, float] | None = None
) -> Path:
    """Write the plan's course as a Parquet file that `Trace.load` reads.

    Columns: t_s (k,) [s], q_rad (k,n), mu (k,) [m^3], swivel_rad (k,), tip_m, tip_ref_m and wrist_m (k,3).

    Args:
        found: the plan.
        scenario: that was planned.
        to: the file.
        within: limits that it was planned for, by the names of `LIMITS`, where there are any.

    Raises:
        ScenarioError: there is none, neither from the start nor from elsewhere.
        TraceError: the file cannot be written.
    """
    course = found.course
    if course is None:
        raise ScenarioError("no course goes all the way from any swivel: there is nothing to write; change the [task]")
    robot = scenario.robot.arm()
    tips, wrists = robot.tool_along(course.q_rad)
    columns = {
        "t_s": course.t_s, "q_rad": course.q_rad, "mu": course.mu, "swivel_rad": found.swivel_rad,
        "tip_m": tips, "tip_ref_m": found.targets.tip, "wrist_m": wrists,
    }  # fmt: skip
    meta = {
        "kind": "course", "objective": found.objective, "from_start": found.executable, "violation": course.violation,
        "certified": course.certified, **described(scenario, robot),
        "within": {name: value for name, value in (within or {}).items() if np.isfinite(value)},
    }  # fmt: skip
    path = Path(to)
    Trace(columns, meta).save(path)
    return path


def load_course(
    scenario: Scenario, robot: RobotModel, q_start: Array, targets: Targets
) -> tuple[Course, Limits, Objective]:
    """Read the file of ``[control] course``: a course at the times of the targets, its limits and objective.

    Args:
        scenario: names the file, and what a course may do.
        robot: the run's.
        q_start: (n,) start of the run [rad].
        targets: of the run; poses between the file's times are interpolated.

    Raises:
        ScenarioError: the file cannot be read, is no course of this run, or one that its third level cannot follow;
            says which of robot, start, duration, path, limits and speeds differs, and by how much.
    """
    settings = scenario.control
    try:
        trace = Trace.load(settings.course)
        t, q = (trace.columns.get(name, np.empty(0)) for name in ("t_s", "q_rad"))
        why = _no_course(trace, t, q, robot)
        if not why:
            poses = between(targets.t_s, t, q)
            why = _of_another_run(trace, t, q, poses, robot, q_start, targets)
    except TraceError as error:
        why = f"no file of a course ({error}); {PLAN_IT}"
    allowed = settings.course_speed_fraction
    if not why:
        shares = speed_shares(robot, poses, targets.period_s)
        j = int(np.argmax(shares))
        if not shares[j] <= allowed + ROUNDING:
            why = (
                f"{robot.data.joint_names[j]} moves at {shares[j]:.3f} of its speed limit, the third level follows up "
                f"to course_speed_fraction = {allowed:g}; plan it with --speed-share {allowed:g}"
            )
    within = {} if why else trace.meta.get("within", {})
    told: dict[str, Any] = {
        name: within.get(name, usual) if isinstance(within, Mapping) else None for name, usual in LIMITS.items()
    }
    for name, value in told.items():
        if not isinstance(value, int | float) or not value >= 0.0:
            why = f"meta['within'] has no usable {name}: {shown(value)}; {PLAN_IT}"
    if why:
        raise ScenarioError(f"[control] course = {shown(settings.course)}: {why}")
    margin = margin_of(
        robot, max(settings.course_margin_rad, told["margin_rad"]), max(settings.limit_margin_m, told["margin_m"])
    )
    limits = Limits(
        # A smoother course begins at this one: it is asked for no margin that this one has not.
        margin_at(robot, poses, margin), max(float(shares.max()), min(allowed, told["speed_share"])),
        told["acceleration"], max(COURSE_SHARE * settings.shaft_margin, told["shaft_margin"]),
    )  # fmt: skip
    objective: Objective = next((one for one in OBJECTIVES if one == trace.meta.get("objective")), "mean")
    return make_course(robot, targets, poses, Limits(speed_share=allowed)), limits, objective


def _no_course(trace: Trace, t: Array, q: Array, robot: RobotModel) -> str:
    """Say why a file holds no course of the robot; empty where it does."""
    why = ""
    if trace.meta.get("kind") != "course":
        why = "the file holds no course"
    elif q.shape != (len(t), robot.n) or len(t) < 2 or not t.dtype == q.dtype == np.float64:
        wanted = f"a course of {robot.n} joints (k,) and (k, {robot.n})"
        why = f"t_s has shape {t.shape} and q_rad {q.shape}, {wanted}"
    elif not (np.isfinite(q).all() and (np.diff(t) > 0.0).all()):
        why = "its times t_s do not rise, or a pose is not finite"
    elif trace.meta.get("robot", robot.data.name) != robot.data.name:
        why = f"a course of robot {shown(trace.meta['robot'])}, this run's is {robot.data.name!r}"
    return f"{why}; {PLAN_IT}" if why else ""


def _of_another_run(
    trace: Trace, t: Array, q: Array, poses: Array, robot: RobotModel, q_start: Array, targets: Targets
) -> str:
    """Say why it is no course of this run: its ends, path and shaft, joint limits; empty where it is one."""
    names, end_s, off = robot.data.joint_names, float(targets.t_s[-1]), np.abs(q[0] - q_start)
    tips, wrists = robot.tool_along(poses)
    away = np.maximum(np.linalg.norm(tips - targets.tip, axis=1), np.linalg.norm(wrists - targets.wrist, axis=1))
    beyond = np.maximum(poses - robot.q_max, robot.q_min - poses).max(axis=0)
    idle = np.where(robot.moves.any(axis=0), 0.0, np.abs(poses - q_start).max(axis=0))
    j, cure, why = int(np.argmax(off)), PLAN_IT, ""
    if off[j] > MOST_OFF_RAD and trace.meta.get("from_start") is False:
        why = f"no course begins at this start, {names[j]} of the file {off[j]:.3g} rad from it"
        cure = f"begin there: [start] q_rad = {[round(angle, 9) for angle in q[0].tolist()]}"
    elif off[j] > MOST_OFF_RAD:
        why = f"{names[j]} begins {off[j]:.3g} rad from the start of the run"
    elif abs(t[0]) > ROUNDING or abs(t[-1] - end_s) > ROUNDING * end_s:
        why = f"it goes from {t[0]:.4g} to {t[-1]:.4g} s, the run from 0 to {end_s:.4g}"
    elif not away.max() <= MOST_OFF_M:
        k = int(np.argmax(away))
        why = f"tip or wrist is {1e3 * away[k]:.3g} mm off path and shaft at t = {targets.t_s[k]:.3g} s"
    elif beyond.max() > MOST_OFF_RAD:
        why = f"{names[int(np.argmax(beyond))]} goes {beyond.max():.3g} rad beyond its limit"
    elif idle.max() > MOST_OFF_RAD:
        why = f"{names[int(np.argmax(idle))]} moves neither tip nor wrist and turns by {idle.max():.3g} rad"
    return f"{why}; {cure}" if why else ""


def speed_shares(robot: RobotModel, poses: Array, period_s: float) -> Array:
    """Return (n,) the largest speed of each joint along poses (k,n), as a share of its limit."""
    fastest: Array = np.abs(np.diff(poses, axis=0)).max(axis=0) / (period_s * robot.v_max)
    return fastest


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
