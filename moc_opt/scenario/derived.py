"""Columns computed after a run: model errors, residuals, largest mu, and best courses."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.errors import MocOptError, ScenarioError
from moc_opt.planning import pose_map
from moc_opt.planning.course import Course, Limits, make_course
from moc_opt.planning.elbow import Elbow
from moc_opt.planning.plan import best_course, top_of
from moc_opt.planning.search import Value
from moc_opt.planning.self_motion import best_freedoms
from moc_opt.qp.problem import compute_residuals
from moc_opt.qp.residuals import Residuals
from moc_opt.robots.model import RobotModel
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.layout import lay_out
from moc_opt.scenario.planned import targets_of
from moc_opt.sim.plant import Plant
from moc_opt.sim.record import TaskOffset
from moc_opt.solvers.base import Status
from moc_opt.tasks.trocar import shaft_distance
from moc_opt.trace.trace import Trace

Columns = Mapping[str, NDArray[Any]]

AT_ONCE = 5000  # number of answers whose residuals are computed together
PERIOD_S = 0.05  # time step of the planning grid [s]
PATH = {"robot", "start", "trocar", "task", "duration_s", "seed"}  # keys that determine path and start


def model_errors(columns: Columns, robot: RobotModel, plant: Plant, offset: TaskOffset) -> dict[str, NDArray[Any]]:
    """Compute the tip and RCM errors [m] that the controller's model gives for the measured joint positions.

    Return {} if the encoders measure the motors of elastic joints: ``columns`` has only the positions of the links.
    """
    if plant.settings.elastic and plant.settings.encoder_side == "motor":
        return {}
    tips, wrists = robot.tool_along(columns["q_rad"] + plant.mismatch.encoder_bias)
    told = columns["trocar_registered_m"] - offset.trocar
    return {
        "tip_error_model_m": np.linalg.norm(columns["tip_ref_m"] - tips, axis=1),
        "rcm_error_model_m": shaft_distance(tips, wrists, told),
    }


def residual_columns(columns: Columns) -> dict[str, NDArray[Any]]:
    """Compute each answer's residuals (NaN without an answer) and the flag ``verified``."""
    if "subproblem" not in columns:
        return {}
    x = columns["x_rad_per_s"]
    parts = [slice(first, first + AT_ONCE) for first in range(0, len(x), AT_ONCE)]
    each = [compute_residuals(columns["subproblem"][part], x[part], columns["dual"][part]) for part in parts]
    found = Residuals(*map(np.concatenate, zip(*each, strict=True)))
    silent = ~np.isfinite(x).all(axis=1) & (columns["status"] != Status.SOLVED.label)
    figures = {name: np.where(silent, np.nan, figure) for name, figure in found._asdict().items()}
    return {"verified": found.verified(), **figures}


def largest_mu(poses: Array, robot: RobotModel, samples: int) -> tuple[Array, dict[str, str]]:
    """Compute the largest mu [m^3] that is possible with tip and wrist of each of ``poses`` (N, n).

    Return (bound, meta). ``bound`` (N,) is NaN except at ``samples`` evenly spaced ticks.
    """
    bound = np.full(len(poses), np.nan)
    ticks = np.linspace(0, len(poses) - 1, min(samples, len(poses))).astype(int)
    ticks = ticks[np.isfinite(poses[ticks]).all(axis=1)]
    if not len(ticks):
        return bound, {}
    found = pose_map.largest_mu(robot, np.asarray(poses[ticks], dtype=np.float64))
    bound[ticks] = found.mu
    return bound, {"mu_bound_method": found.method}


class BestCourses(NamedTuple):
    """The courses with the largest mean mu along one path; None: no course was found."""

    robot: RobotModel
    from_start: Course | None  #: From the start pose of the run.
    best: Course | None  #: From any start pose.
    last: pose_map.PoseMap  #: Poses that reach the last two points of the path.


def best_courses(scenario: Scenario) -> BestCourses:
    """Plan the best courses. Raise a MocOptError if the scenario is not usable."""
    return _planned(scenario.model_dump_json(include=PATH))


@lru_cache(maxsize=64)
def _planned(path: str) -> BestCourses:
    scenario = Scenario(**json.loads(path))
    robot = scenario.robot.arm()
    real = best_freedoms(robot).real
    if real != 1:
        raise ScenarioError(f"with tip and shaft held, this arm has {real} degrees of freedom: the planner needs one")
    layout = lay_out(scenario, robot, checked=False)
    targets = targets_of(robot, layout, period_s=PERIOD_S)
    value = Value(pose_map.map_of(robot, layout.q, targets), Limits())
    grid = [best_course(value, start) for start in (layout.q, None)]
    mine, best = (None if q is None else make_course(robot, targets, q) for q in grid)
    return BestCourses(robot, mine, best, pose_map.map_of(robot, layout.q, targets[-2:]))


def against_best(scenario: Scenario, trace: Trace) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return the columns of the best courses, and the entry ``best_courses`` of the trace's meta.

    In the entry's part ``end``, ``best_mu`` is mu at the end of the best course from the start. ``top_mu`` is the mu
    reached by climbing along the self-motion from the run's last pose, until a maximum or a joint limit.
    """
    try:
        known = best_courses(scenario)
    except MocOptError as error:
        return {}, {"best_courses": {"absent": str(error)}}
    t, mine, last = trace.t_s, known.from_start, known.last
    columns: dict[str, NDArray[Any]] = {}
    for name, course in (("mu_best_from_start", mine), ("mu_best", known.best)):
        if course is not None:
            columns[name] = np.interp(t, course.t_s, course.mu)
    told: dict[str, Any] = {"absent": "" if mine else "no course was found from this start on the planner's grid"}
    if mine is not None:
        columns["q_best_from_start_rad"] = np.stack([np.interp(t, mine.t_s, q) for q in mine.q_rad.T], axis=1)
        top, elbow = top_of(last, trace.q_rad[-1]), Elbow(known.robot, last.targets.wrist)
        if top is not None and abs(t[-1] - mine.t_s[-1]) < PERIOD_S:  # a stopped run ends earlier on the path
            here, there = np.degrees(elbow.swivel(np.stack([top.q_rad, mine.q_rad[-1]]))).tolist()
            told["end"] = {
                "mu": float(trace.mu[-1]), "top_mu": top.mu, "top_swivel_deg": here, "at_limit": top.at_limit,
                "best_mu": float(mine.mu[-1]), "best_swivel_deg": there,
            }  # fmt: skip
    return columns, {"best_courses": told}
