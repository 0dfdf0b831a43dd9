"""A followed course is where it should be at every tick, and in the closed loop the arm goes along it."""

from __future__ import annotations

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.control import Controller
from moc_opt.errors import ControlError, MocOptError, ScenarioError, TaskError
from moc_opt.model.robot_model import RobotModel
from moc_opt.planning.course import Course
from moc_opt.planning.follow import Follower
from moc_opt.redundancy.arm_angle import reach
from moc_opt.scenario import Scenario, Setup, guided
from moc_opt.scenario.guided import followed_course
from moc_opt.scenario.planned import targets_of


def straight(robot: RobotModel) -> Course:
    t = np.linspace(0.0, 1.0, 11)
    q = robot.data.q_home + 0.1 * t[:, None]
    return Course(t, q, np.ones(11), 0.0)


def test_on_its_course_an_arm_is_asked_for_the_courses_speed(robot: RobotModel) -> None:
    guide = Follower(straight(robot), 0.002, gain_per_s=5.0)
    for tick in range(400):
        desired = guide.desired_velocity(robot.state(robot.data.q_home + 0.1 * 0.002 * tick))
        np.testing.assert_allclose(desired, 0.1, atol=1e-9)
    guide.start()
    np.testing.assert_allclose(guide.desired_velocity(robot.state(robot.data.q_home)), 0.1, atol=1e-9)


def test_an_error_is_pulled_back_and_after_the_end_the_last_pose_is_held(robot: RobotModel) -> None:
    guide = Follower(straight(robot), 0.002, gain_per_s=5.0)
    off = robot.state(robot.data.q_home + 0.01)
    np.testing.assert_allclose(guide.desired_velocity(off), 0.1 - 0.05, atol=1e-9)
    for _ in range(600):
        last = guide.desired_velocity(robot.state(robot.data.q_home + 0.2))
    np.testing.assert_allclose(last, 5.0 * (0.1 - 0.2), atol=1e-9)


def test_bad_settings_are_named(robot: RobotModel) -> None:
    with pytest.raises(TaskError, match="period_s = 0"):
        Follower(straight(robot), 0.0)


def test_an_arm_that_has_left_its_course_is_led_to_its_maximum_of_mu_from_where_it_is() -> None:
    """Its elbow is held for a second, in which the course leaves its first maximum; then it goes as asked."""
    change = {"control": {"third_level": "planned"}, "start": {"pose": "random"}, "task": {"path": "circle"}}
    setup = Setup(Scenario(seed=9, bound_samples=0).change(**change))
    robot, guide = setup.robot, setup.controller()._guide
    assert isinstance(guide, Follower)
    targets = targets_of(robot, setup.layout, setup.ticks + 1)
    q, held = np.array(setup.q_start), 500
    assert robot.mu_along(guide._q[held][None])[0] > 1.3 * robot.mu_along(q[None])[0]
    for tick in range(setup.ticks):
        desired = guide.desired_velocity(robot.state(q))
        if tick == 0:
            assert not guide.told
            np.testing.assert_allclose(desired, guide._v[0], atol=1e-9)
        q = q if tick < held else q + 0.002 * desired
        if tick % 25 == 0:
            reached = reach(robot, q, targets.tip[tick + 1], targets.wrist[tick + 1])
            assert reached is not None
            q = reached
    assert guide.told["left_course_s"] < 1.0
    assert robot.mu_along(q[None])[0] > 0.99 * robot.mu_along(guide._q[-1:])[0]
    guide.start()
    assert not guide.told


# --- in the loop ---

FOLLOWED = Scenario(bound_samples=0).change(control={"third_level": "planned"}, plant={"preset": "nominal"})


def test_the_subproblem_follows_the_wish_on_its_self_motion(robot: RobotModel) -> None:
    """x is the references' motion plus the projection of the desired velocity on ker A, by pseudo-inverse."""
    setup = Setup(FOLLOWED)
    controller = setup.controller()
    assert isinstance(controller, Controller)
    guide = setup._guides()
    state = setup.robot.state(setup.q_start)
    tip, trocar = setup.reference.rows(0.0), setup.registered.rows(0.0)
    controller.start(state, tip, trocar)
    controller.tick(state, tip, trocar)
    desired = guide.desired_velocity(state)
    qp = controller.subproblem
    assert qp is not None
    inverse = np.linalg.pinv(state.A, rcond=1e-6)
    expected = inverse @ qp.b + desired - inverse @ (state.A @ desired)
    assert np.abs(expected).max() > 1e-3
    assert ((expected > qp.lower) & (expected < qp.upper)).all()
    np.testing.assert_allclose(controller.answer, expected, atol=1e-7)


def test_the_arm_goes_along_its_course_and_no_worse_than_by_climbing() -> None:
    setup = Setup(FOLLOWED)
    trace = mo.run(FOLLOWED)
    assert trace.meta["ended"] == "completed"
    course = followed_course(FOLLOWED, setup.robot, setup.layout)
    wanted = np.stack([np.interp(trace.t_s, course.t_s, joint) for joint in course.q_rad.T], axis=1)
    late = trace.t_s > 1.0
    assert np.abs(trace.q_rad - wanted)[late].max() < 0.05
    climbed = mo.run(FOLLOWED.change(control={"third_level": "local"}))
    # From a pose without a trap a climb gets as far; the course pays for going gently, the climb does not.
    assert trace.mu.mean() > 0.995 * climbed.mu.mean()
    assert trace.columns["verified"].mean() > 0.99


def test_from_a_start_just_inside_the_margin_the_course_is_as_smooth_and_good_as_from_deeper_in_it() -> None:
    """The margin can be regained within a step of the map, but by no course that the refinement may return."""
    courses = []
    for swivel in (0.01, 0.0142):  # 0.030 and 0.043 rad from a limit
        setup = Setup(FOLLOWED.change(start={"swivel": swivel}, control={"course_margin_rad": 0.05}))
        room = np.minimum(setup.q_start - setup.robot.q_min, setup.robot.q_max - setup.q_start)
        assert 0.02 < room[setup.robot.moves.any(axis=0)].min() < 0.05
        courses.append(followed_course(setup.scenario, setup.robot, setup.layout))
    deeper, just_inside = courses
    assert just_inside.certified
    assert just_inside.kept
    assert just_inside.mu_mean > 0.99 * deeper.mu_mean


@pytest.mark.parametrize(
    ("control", "message"),
    [({"regularization": 0.0}, "regularization = 0"), ({"c2": 0.0}, "c2 = 0"), ({"backend": "c"}, "third_level")],
)
def test_what_cannot_follow_is_refused(control: dict[str, object], message: str) -> None:
    with pytest.raises((ControlError, MocOptError), match=message):
        Setup(FOLLOWED.change(control=control)).adapter()


def test_a_path_without_a_course_is_refused_before_the_run() -> None:
    fast = FOLLOWED.change(task={"v_max_m_per_s": 2.0, "a_max_m_per_s2": 20.0}, start={"check_path": False})
    with pytest.raises(ScenarioError, match=r"third_level = 'planned'.*mm along the path"):
        Setup(fast).controller()


def test_dcac_with_a_course_is_refused_and_the_matched_baseline_has_none() -> None:
    with pytest.raises(ControlError, match=r"law = 'dcac' with third_level = 'planned'"):
        FOLLOWED.change(control={"law": "dcac"})
    baseline = FOLLOWED.change(control=FOLLOWED.control.matched_dcac())
    assert Setup(baseline).controller()._guide is None


def test_another_controller_of_a_scenario_follows_the_same_course(monkeypatch: pytest.MonkeyPatch) -> None:
    setup = Setup(FOLLOWED)
    setup.controller()
    monkeypatch.setattr(guided, "make_plan", None)
    state = setup.robot.state(setup.q_start)
    one, other = (setup.controller()._guide for _ in range(2))
    assert one is not None
    assert other is not None
    assert one is not other
    for _ in range(300):  # a controller that runs leaves the others where they are
        one.desired_velocity(state)
    np.testing.assert_array_equal(other.desired_velocity(state), setup.controller()._guide.desired_velocity(state))


@pytest.mark.parametrize("duration_s", [0.002, 0.02, 0.07])
def test_a_run_of_a_few_ticks_is_planned_too(duration_s: float) -> None:
    trace = mo.run(FOLLOWED.change(duration_s=duration_s))
    assert len(trace) == round(duration_s / 0.002)
