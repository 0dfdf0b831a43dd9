"""A plan says when its scenario's third level cannot follow the course, and how it could."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.planning.course import Course
from moc_opt.planning.plan import Plan
from moc_opt.planning.targets import Targets
from moc_opt.scenario.followable import following_warnings
from moc_opt.scenario.planned import margin_of, plan

ASKED = mo.Scenario(duration_s=2.0, start={"swivel": 0.2})


@pytest.fixture(scope="module")
def fast() -> Plan:
    return plan(ASKED, refined=False)


def test_a_joint_that_slides_has_a_margin_of_its_own() -> None:
    """Of the default course on a rail: in m, and the cure is the option that is in m."""
    scenario = ASKED.change(robot={"name": "lwr4_rail"}, control={"third_level": "planned", "limit_margin_m": 0.3})
    robot = scenario.robot.arm()
    margin = margin_of(robot, 0.05, 0.3)
    slides = robot.chain.prismatic
    assert slides.sum() == 1
    np.testing.assert_array_equal(margin, np.where(slides, 0.3, 0.05))
    assert margin_of(ASKED.robot.arm(), 0.05, 0.3) == 0.05
    t, q = np.array([0.0, 1.0]), np.array([(robot.q_min + robot.q_max) / 2.0] * 2)
    q[:, slides] = robot.q_max[slides] - 0.2
    course = Course(t, q, np.ones(2), 0.0)
    targets = Targets(t, np.zeros((2, 3)), np.zeros((2, 3)), np.zeros(2))
    (said,) = following_warnings(scenario, SimpleNamespace(course=course, targets=targets))  # type: ignore[arg-type]
    assert "0.200 m of its limit" in said
    assert "--margin-m 0.3, or lower limit_margin_m" in said


def test_what_the_third_level_may_do_itself_is_not_warned_of() -> None:
    control = ASKED.control
    slow = plan(
        ASKED, refined=False, speed_share=control.course_speed_fraction, margin_rad=control.course_margin_rad
    )
    assert slow.executable
    assert following_warnings(ASKED, slow) == []


def test_a_course_that_is_too_fast_is_named_with_joint_and_cure(fast: Plan) -> None:
    (said,) = following_warnings(ASKED, fast)
    assert fast.from_start is not None
    robot = ASKED.robot.arm()
    shares = np.abs(np.diff(fast.from_start.q_rad, axis=0)).max(axis=0) / fast.targets.period_s / robot.v_max
    assert robot.data.joint_names[int(np.argmax(shares))] in said
    assert f"{shares.max():.2f} of its speed limit" in said
    assert "--speed-share 0.85" in said


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"preset": "paper"}, "regularization = 0"),
        ({"law": "dcac"}, "no third level"),
        ({"backend": "c"}, "knows no course"),
        ({"course_margin_rad": 1.2}, "lower course_margin_rad"),
    ],
)
def test_what_else_is_in_the_way_is_said(fast: Plan, change: dict[str, object], said: str) -> None:
    assert any(said in line for line in following_warnings(ASKED.change(control=change), fast))
