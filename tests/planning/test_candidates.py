"""The courses that refinement begins at: near the margin from losing the shaft those of a wider one, too."""

from __future__ import annotations

import numpy as np
import pytest

from moc_opt.model.robot_model import load_robot
from moc_opt.planning import candidates
from moc_opt.planning.candidates import WIDER, usable_courses
from moc_opt.planning.course import Course
from moc_opt.planning.plan import map_of
from moc_opt.planning.search import search
from moc_opt.planning.shaft import keeping_shaft
from tests.conftest import Array
from tests.planning.test_search import task
from tests.planning.test_shaft import start


@pytest.mark.parametrize(("margin", "more"), [(0.0875, True), (0.02, False)])
def test_near_the_margin_a_course_of_a_wider_one_is_begun_at_too(
    monkeypatch: pytest.MonkeyPatch, margin: float, more: bool
) -> None:
    robot = load_robot("lwr4")
    q = start(robot, 12)
    targets = task(robot, q, 60)
    whole, step = map_of(robot, q, targets, 120), robot.v_max * targets.period_s
    begin, begun = (q, float(robot.state(q).mu)), list[Array]()

    def refined(robot: object, targets: object, course: Course, *_: object, **more: object) -> Course:
        begun.append(course.q_rad)
        return course

    monkeypatch.setattr(candidates, "refine", refined)
    wider = search(keeping_shaft(whole, robot, WIDER * 0.0875), step, start=begin).q_rad
    assert wider is not None
    found = search(keeping_shaft(whole, robot, margin), step, start=begin)
    usable_courses(
        robot, whole, [found], begin, "mean", margin=0.0, speed_share=1.0, acceleration=np.inf, shaft_margin=margin,
        refined=True,
    )  # fmt: skip
    assert any(np.array_equal(one, wider) for one in begun) == more
    assert (len(begun) > 1) == more
