"""A course as a file: what ``moc-opt plan --out`` writes, and ``[control] course`` follows."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from moc_opt.errors import ScenarioError, shown
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.planning.course import Course, make_course
from moc_opt.planning.plan import Plan
from moc_opt.planning.targets import Targets
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.layout import described
from moc_opt.trace.trace import Trace

MOST_OFF_M = 1e-3
"""So far tip or wrist may be off the run's targets; the program that makes a course smooth puts them there."""
MOST_OFF_RAD = 1e-6
"""So far the first pose may be from the run's start, and a joint or its way beyond a limit."""


def save_course(found: Plan, scenario: Scenario, to: str | os.PathLike[str]) -> Path:
    """Write the plan's course as a Parquet file that `Trace.load` reads: t_s, q_rad, mu, swivel_rad, tip_ref_m, tip_m.

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
    }  # fmt: skip
    path = Path(to)
    Trace(columns, meta).save(path)
    return path


def load_course(scenario: Scenario, robot: RobotModel, q_start: Array, targets: Targets) -> Course:
    """Read the file of ``[control] course`` as a course of this run, at the times of its targets.

    Args:
        scenario: names the file, and what a course may do.
        robot: the run's.
        q_start: (n,) start of the run [rad].
        targets: of the run; poses between the file's times are interpolated.

    Raises:
        ScenarioError: the file is no course of this run, or one that its third level cannot follow; says which of
            robot, start, duration, path, limits and speeds differs, and by how much.
        TraceError: the file cannot be read.
    """
    file, settings = scenario.control.course, scenario.control
    trace, cure = Trace.load(file), "plan it for this scenario: moc-opt plan SCENARIO --out FILE"

    def refuse(why: str, cure: str = cure) -> ScenarioError:
        return ScenarioError(f"[control] course = {file!r}: {why}; {cure}")

    t, q = (trace.columns.get(name, np.empty(0)) for name in ("t_s", "q_rad"))
    shaped = t.ndim == 1 and len(t) > 1 and q.shape == (len(t), robot.n) and t.dtype == q.dtype == np.float64
    if not shaped or not np.isfinite(q).all() or not (np.diff(t) > 0.0).all():
        raise refuse(f"no course of {robot.n} joints, poses q_rad at rising times t_s")
    if trace.meta.get("robot", robot.data.name) != robot.data.name:
        raise refuse(f"a course of robot {shown(trace.meta['robot'])}, this run's is {robot.data.name!r}")
    names, end = robot.data.joint_names, float(targets.t_s[-1])
    off = np.abs(q[0] - q_start)
    if off.max() > MOST_OFF_RAD:
        j = int(np.argmax(off))
        raise refuse(f"{names[j]} begins {off[j]:.3g} rad from the start of the run")
    if abs(t[0]) > MOST_OFF_RAD or abs(t[-1] - end) > 1e-6 * end:
        raise refuse(f"it goes from {t[0]:.4g} to {t[-1]:.4g} s, the run from 0 to {end:.4g}")
    poses = np.stack([np.interp(targets.t_s, t, joint) for joint in q.T], axis=1)
    tips, wrists = robot.tool_along(poses)
    away = np.maximum(np.linalg.norm(tips - targets.tip, axis=1), np.linalg.norm(wrists - targets.wrist, axis=1))
    if away.max() > MOST_OFF_M:
        k = int(np.argmax(away))
        raise refuse(f"tip or wrist is {1e3 * away[k]:.3g} mm off path and shaft at t = {targets.t_s[k]:.3g} s")
    moving = np.asarray(robot.moves.any(axis=0))
    beyond = np.where(moving, np.maximum(poses - robot.q_max, robot.q_min - poses).max(axis=0), -1.0)
    if beyond.max() > MOST_OFF_RAD:
        j = int(np.argmax(beyond))
        raise refuse(f"{names[j]} goes {beyond[j]:.3g} rad beyond its limit")
    shares = np.where(moving, np.abs(np.diff(poses, axis=0)).max(axis=0) / (targets.period_s * robot.v_max), 0.0)
    j, allowed = int(np.argmax(shares)), settings.course_speed_fraction
    if shares[j] > allowed + MOST_OFF_RAD:
        raise refuse(
            f"{names[j]} moves at {shares[j]:.3f} of its speed limit, the third level follows up to "
            f"course_speed_fraction = {allowed:g}",
            f"plan it with --speed-share {allowed:g}",
        )
    return make_course(robot, targets, poses, speed_share=allowed)
