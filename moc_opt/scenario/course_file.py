"""A course as a file: what ``moc-opt plan --out`` writes, and ``[control] course`` follows."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from moc_opt.errors import ScenarioError, TraceError, shown
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.planning.course import OBJECTIVES, Course, Objective, make_course, margin_at
from moc_opt.planning.plan import Plan
from moc_opt.planning.pose_map import Margin
from moc_opt.planning.targets import Targets
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.layout import described
from moc_opt.scenario.planned import margin_of
from moc_opt.trace.trace import Trace

MOST_OFF_M = 1e-3
"""So far tip or wrist may be off the run's targets; the program that makes a course smooth puts them there."""
LIMITS = {"margin_rad": 0.0, "margin_m": 0.0, "speed_share": 1.0, "acceleration": np.inf, "shaft_margin": 0.0}
"""What a course was planned for, and what stands for it in a file that does not say."""
MOST_OFF_RAD = 1e-6
"""So far the first pose may be from the run's start, a joint beyond a limit, and an idle joint from its start."""
ROUNDING = 1e-6
"""Of the first time [s]; of the last one, as a share of the run's, and of a speed, as a share of its limit."""


class Given(NamedTuple):
    """A file's course, and what it was planned for: whoever makes it smooth keeps to that."""

    course: Course
    objective: Objective
    margin: Margin
    """from the joint limits [rad], [m]"""
    speed_share: float
    acceleration: float
    """[rad/s^2]; inf: no limit"""
    shaft_margin: float = 0.0
    """from losing the shaft, a share of the squared lever"""


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


def load_course(scenario: Scenario, robot: RobotModel, q_start: Array, targets: Targets) -> Given:
    """Read the file of ``[control] course``: a course of this run, at the times of its targets.

    Args:
        scenario: names the file, and what a course may do.
        robot: the run's.
        q_start: (n,) start of the run [rad].
        targets: of the run; poses between the file's times are interpolated.

    Raises:
        ScenarioError: the file cannot be read, is no course of this run, or one that its third level cannot follow;
            says which of robot, start, duration, path, limits and speeds differs, and by how much.
    """
    file, settings = scenario.control.course, scenario.control
    try:
        trace, t, q = _read(file, robot)
        _check_ends(trace, t, q, robot, q_start, float(targets.t_s[-1]))
        poses = np.stack([np.interp(targets.t_s, t, joint) for joint in q.T], axis=1)
        _check_poses(poses, robot, q_start, targets)
        fastest = _fastest(poses, robot, targets, settings.course_speed_fraction)
        told = _told(trace)
    except _Refused as refused:
        raise ScenarioError(f"[control] course = {shown(file)}: {refused}") from refused
    margin = margin_of(
        robot, max(settings.course_margin_rad, told["margin_rad"]), max(settings.limit_margin_m, told["margin_m"])
    )
    for pose in poses:  # a smoother course begins at this one: it is asked for no margin that this one has not
        margin = margin_at(robot, pose, margin)
    allowed = settings.course_speed_fraction
    return Given(
        make_course(robot, targets, poses, speed_share=allowed), objective_of(trace), margin,
        max(fastest, min(allowed, told["speed_share"])), told["acceleration"], told["shaft_margin"],
    )  # fmt: skip


class _Refused(Exception):
    """Why a file's course is not one of the run, and the cure."""

    def __init__(self, why: str, cure: str = "plan it for this scenario: moc-opt plan SCENARIO --out FILE") -> None:
        super().__init__(f"{why}; {cure}")


def _read(file: str, robot: RobotModel) -> tuple[Trace, Array, Array]:
    """Return the file, its times (k,) [s] and poses (k,n) [rad]."""
    try:
        trace = Trace.load(file)
    except TraceError as error:
        raise _Refused(f"no file of a course ({error})") from error
    if trace.meta.get("kind") != "course":
        raise _Refused("the file holds no course")
    t, q = (trace.columns.get(name, np.empty(0)) for name in ("t_s", "q_rad"))
    if q.shape != (len(t), robot.n) or len(t) < 2 or not t.dtype == q.dtype == np.float64:
        wanted = f"a course of {robot.n} joints (k,) and (k, {robot.n})"
        raise _Refused(f"t_s has shape {t.shape} and q_rad {q.shape}, {wanted}")
    if not (np.isfinite(q).all() and (np.diff(t) > 0.0).all()):
        raise _Refused("its times t_s do not rise, or a pose is not finite")
    if trace.meta.get("robot", robot.data.name) != robot.data.name:
        raise _Refused(f"a course of robot {shown(trace.meta['robot'])}, this run's is {robot.data.name!r}")
    return trace, t, q


def _check_ends(trace: Trace, t: Array, q: Array, robot: RobotModel, q_start: Array, end_s: float) -> None:
    """Compare where and when it begins and ends with the run."""
    off = np.abs(q[0] - q_start)
    if off.max() > MOST_OFF_RAD:
        j = int(np.argmax(off))
        name = robot.data.joint_names[j]
        if trace.meta.get("from_start") is False:
            raise _Refused(
                f"no course begins at this start, {name} of the file {off[j]:.3g} rad from it",
                f"begin there: [start] q_rad = {[round(angle, 9) for angle in q[0].tolist()]}",
            )
        raise _Refused(f"{name} begins {off[j]:.3g} rad from the start of the run")
    if abs(t[0]) > ROUNDING or abs(t[-1] - end_s) > ROUNDING * end_s:
        raise _Refused(f"it goes from {t[0]:.4g} to {t[-1]:.4g} s, the run from 0 to {end_s:.4g}")


def _check_poses(poses: Array, robot: RobotModel, q_start: Array, targets: Targets) -> None:
    """Hold the poses (k,n) at the run's times against path, shaft and joint limits."""
    if not np.isfinite(poses).all():
        raise _Refused("poses between its times are not finite")
    tips, wrists = robot.tool_along(poses)
    away = np.maximum(np.linalg.norm(tips - targets.tip, axis=1), np.linalg.norm(wrists - targets.wrist, axis=1))
    if not away.max() <= MOST_OFF_M:
        k = int(np.argmax(away))
        raise _Refused(f"tip or wrist is {1e3 * away[k]:.3g} mm off path and shaft at t = {targets.t_s[k]:.3g} s")
    names = robot.data.joint_names
    beyond = np.maximum(poses - robot.q_max, robot.q_min - poses).max(axis=0)
    if not beyond.max() <= MOST_OFF_RAD:
        j = int(np.argmax(beyond))
        raise _Refused(f"{names[j]} goes {beyond[j]:.3g} rad beyond its limit")
    idle = np.where(robot.moves.any(axis=0), 0.0, np.abs(poses - q_start).max(axis=0))
    if not idle.max() <= MOST_OFF_RAD:
        j = int(np.argmax(idle))
        raise _Refused(f"{names[j]} moves neither tip nor wrist and turns by {idle[j]:.3g} rad")


def _fastest(poses: Array, robot: RobotModel, targets: Targets, allowed: float) -> float:
    """Return the largest share of a joint's speed limit, not above the one allowed."""
    shares = speed_shares(robot, poses, targets.period_s)
    j = int(np.argmax(shares))
    if not shares[j] <= allowed + ROUNDING:
        raise _Refused(
            f"{robot.data.joint_names[j]} moves at {shares[j]:.3f} of its speed limit, the third level follows up to "
            f"course_speed_fraction = {allowed:g}",
            f"plan it with --speed-share {allowed:g}",
        )
    return float(shares[j])


def _told(trace: Trace) -> dict[str, float]:
    """Return what the course was planned for, by the names of `LIMITS`."""
    within = trace.meta.get("within", {})
    told: dict[str, Any] = {
        name: within.get(name, usual) if isinstance(within, Mapping) else None for name, usual in LIMITS.items()
    }
    for name, value in told.items():
        if not isinstance(value, int | float) or not value >= 0.0:
            raise _Refused(f"meta['within'] has no usable {name}: {shown(value)}")
    return told


def speed_shares(robot: RobotModel, poses: Array, period_s: float) -> Array:
    """Return (n,) the largest speed of each joint along poses (k,n), as a share of its limit."""
    fastest: Array = np.abs(np.diff(poses, axis=0)).max(axis=0) / (period_s * robot.v_max)
    return fastest


def objective_of(trace: Trace) -> Objective:
    """Return the objective that a file's course was planned for; "mean" where it does not say."""
    told = trace.meta.get("objective")
    return next((objective for objective in OBJECTIVES if objective == told), "mean")
