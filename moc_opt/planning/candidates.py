"""The courses to choose from: those of the searches, each refined, as far as they keep the limits."""

from __future__ import annotations

import numpy as np

from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.planning.course import Course, Objective, make_course
from moc_opt.planning.pose_map import Margin, PoseMap
from moc_opt.planning.refine import refine
from moc_opt.planning.search import Search, search
from moc_opt.planning.shaft import keeping_shaft, shaft_shares

WIDER = 2.0
"""Times the margin from losing the shaft with which a course near it is searched for once more."""


def usable_courses(
    robot: RobotModel, whole: PoseMap, found: list[Search], start: tuple[Array, float] | None, objective: Objective, *,
    margin: Margin, speed_share: float, acceleration: float, shaft_margin: float, refined: bool,
) -> list[Course]:  # fmt: skip
    """Return the courses of searches, and each refined, as far as they keep the limits.

    The bound's own course is a second one to begin at, which helps where the grid's steps are just too coarse. Where
    courses go near the margin from losing the shaft, those of a wider margin are more of them: a way that is refined
    to a better one may lie there, and the map's steps are coarse where the joints turn fast.

    Args:
        robot: the arm.
        whole: the map, not lowered for any margin.
        found: the search with its margin, and the bound's.
        start: as of `search`.
        objective, margin, speed_share, acceleration, shaft_margin: as of `moc_opt.planning.plan.make_plan`.
        refined: whether the courses are refined, too.
    """
    targets, free = whole.targets, start is None
    poses = [each.q_rad for each in found if each.q_rad is not None and np.isfinite(each.q_rad).all()]
    wider = min(1.0, WIDER * shaft_margin)
    if refined and any((shaft_shares(robot, q) < wider).any() for q in poses):
        step, held = speed_share * robot.v_max * targets.period_s, keeping_shaft(whole, robot, wider, objective)
        for generous in (False, True):
            q = search(held, step, objective, start=start, margin=margin, generous=generous).q_rad
            if q is not None and np.isfinite(q).all() and not any(np.array_equal(q, known) for known in poses):
                poses.append(q)
    made = [make_course(robot, targets, q, margin, speed_share, acceleration) for q in poses]
    if refined:
        made += [
            refine(
                robot, targets, course, objective, free_start=free, margin=margin, speed_share=speed_share,
                acceleration=acceleration, shaft_margin=shaft_margin,
            ) for course in made
        ]  # fmt: skip
    usable = [course for course in made if course.kept]
    if not usable and made and found[0].q_rad is not None and not np.isfinite(acceleration):
        usable = made[:1]  # of the grid: its poses miss their targets by rounding alone
    return usable
