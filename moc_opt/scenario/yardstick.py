"""The references of a run's manipulability: the best course from its start, and the best over all starts.

Both are courses of dynamic programming, within the arm's own joint limits and speeds, on a grid of 50 ms and 0.5
degree; refined as `moc_opt.scenario.planned.plan` does they are a little better (docs/planning.md). They are planned
once for all runs of one path and start, for all controllers.
"""

from __future__ import annotations

import json
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import MocOptError
from moc_opt.inputs.files import to_json
from moc_opt.planning.course import Course, Limits, make_course
from moc_opt.planning.elbow import Elbow
from moc_opt.planning.plan import best_course, top_of
from moc_opt.planning.pose_map import PoseMap, map_of
from moc_opt.planning.search import Value
from moc_opt.planning.self_motion import best_freedoms
from moc_opt.robots.model import RobotModel
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.planned import layout_of, targets_of
from moc_opt.trace.trace import Trace

PERIOD_S = 0.05
"""Of the grid: a joint's way in one period is then several swivels of the map, so that little of its speed is lost."""
PATH = ("robot", "start", "trocar", "task", "duration_s", "seed")
"""The fields of a scenario that path and start follow from."""


class Yardstick(NamedTuple):
    """The best courses of one path."""

    robot: RobotModel
    from_start: Course | None
    best: Course | None
    absent: str  #: Why a course is missing; empty where none is.
    last: PoseMap | None  #: Of the end of the path alone.


def yardstick(scenario: Scenario) -> Yardstick:
    """Plan the best courses of a scenario's path, or return those planned before; raises as a run does."""
    return _planned(to_json(scenario.model_dump(mode="json", include=set(PATH)), indent=None, sort_keys=True))


@lru_cache(maxsize=64)
def _planned(table: str) -> Yardstick:
    scenario = Scenario(**json.loads(table))
    robot = scenario.robot.arm()
    real = best_freedoms(robot).real
    if real != 1:
        return Yardstick(robot, None, None, f"tip and shaft leave {real} freedoms, a map has one", None)
    layout = layout_of(scenario, robot)
    targets = targets_of(robot, layout, period_s=PERIOD_S)
    found = map_of(robot, layout.q, targets)
    value = Value(found, Limits())
    courses = [
        None if q is None else make_course(robot, targets, q)
        for q in (best_course(value, Limits(), start) for start in (layout.q, None))
    ]
    absent = "" if courses[0] is not None else "no course was found from this start on the grid of the map"
    return Yardstick(robot, courses[0], courses[1], absent, map_of(robot, layout.q, targets[-2:]))


def against_best(scenario: Scenario, trace: Trace) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return the columns of the best courses, and meta's entry ``best_courses``.

    Its ``absent`` says why there is none; its ``end`` has the maximum of mu [m^3] that a climb reaches from the run's
    last pose, the course's last mu, and the swivels of both [deg].
    """
    try:
        known = yardstick(scenario)
    except MocOptError as error:
        return {}, {"best_courses": {"absent": str(error)}}
    columns: dict[str, NDArray[Any]] = {}
    t = trace.t_s
    for name, course in (("mu_best_from_start", known.from_start), ("mu_best", known.best)):
        if course is not None:
            columns[name] = np.interp(t, course.t_s, course.mu)
    told: dict[str, Any] = {"absent": known.absent}
    if known.from_start is not None and known.last is not None:
        mine = known.from_start
        columns["q_best_from_start_rad"] = np.stack([np.interp(t, mine.t_s, q) for q in mine.q_rad.T], axis=1)
        top, elbow = top_of(known.last, trace.q_rad[-1]), Elbow(known.robot, known.last.targets.wrist)
        if top is not None and abs(t[-1] - mine.t_s[-1]) < PERIOD_S:  # a run that was stopped ends elsewhere
            here, there = np.degrees(elbow.swivel(np.stack([top.q_rad, mine.q_rad[-1]]))).tolist()
            told["end"] = {
                "mu": float(trace.mu[-1]), "top_mu": top.mu, "top_swivel_deg": here, "at_limit": top.at_limit,
                "best_mu": float(mine.mu[-1]), "best_swivel_deg": there,
            }  # fmt: skip
    return columns, {"best_courses": told}
