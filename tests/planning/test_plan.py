"""A plan says whether a path can be executed, and if not, where it is blocked."""

import numpy as np
import pytest

from moc_opt.errors import MocOptError, TaskError
from moc_opt.planning import plan
from moc_opt.planning.course import MOST_VIOLATION, Limits, Targets, lay_targets
from moc_opt.planning.plan import climb, make_plan
from moc_opt.robots.inverse_kinematics import solve_pose
from moc_opt.scenario import Scenario, planned
from moc_opt.tasks import Reference, Trocar, make_path
from tests.planning.arms import line_from, task


def test_mean_mu_of_a_course_lies_between_local_climb_and_bound(robot):
    q = robot.data.q_home
    targets = task(robot, q, 60)
    plan = make_plan(robot, q, targets, swivels=360)
    assert (plan.executable, plan.blocked, plan.climbed_whole, plan.from_start.certified) == (True, None, True, True)
    assert plan.climbed.mu_mean <= plan.from_start.mu_mean <= plan.best.mu_mean
    assert plan.from_start.mu_mean <= plan.bound_from_start < 1.005 * plan.from_start.mu_mean
    assert plan.best.mu_mean <= plan.bound < 1.005 * plan.best.mu_mean
    assert repr(plan).startswith(f"Plan(executable: yes, mean mu from the start: {plan.from_start.mu_mean:.4g} m^3, ")
    assert (len(plan.swivel_rad), plan.swivel_rad[0]) == (60, pytest.approx(plan.start_swivel_rad))
    again = make_plan(robot, plan.best.q_rad[0], targets, swivels=360)
    assert again.start_swivel_rad == pytest.approx(plan.best_swivel_rad)
    assert again.from_start.mu_mean == pytest.approx(plan.best.mu_mean, rel=1e-4)


def test_at_every_target_the_shaft_passes_through_the_trocar(robot):
    state = robot.state(robot.data.q_home)
    targets = line_from(robot, robot.data.q_home, 5)
    way = state.tip - 0.15 * state.tool_direction - targets.tip
    shaft = state.tool_span * way / np.linalg.norm(way, axis=1)[:, None]
    np.testing.assert_allclose(targets.wrist - targets.tip, shaft, atol=1e-12)
    np.testing.assert_allclose(targets.arc_length_m, np.linalg.norm(targets.tip - targets.tip[0], axis=1), atol=1e-12)
    path = make_path("line", state.tip, normal=(0.0, 0.0, 1.0), heading=(1.0, 0.0, 0.0), length=0.02)
    for depth, tool, words in ((1e-3, 0.3, "it is 1 mm"), (0.4, 0.5, "t = 0.00 s"), (0.15, 0.14, "2 to 140 mm")):
        trocar = Trocar(state.tip - depth * state.tool_direction)
        with pytest.raises(TaskError, match=words):
            lay_targets(Reference(path, 0.05, 0.2), trocar, state.tool_span, 0.8, 5, tool)


def test_a_bound_below_the_mu_of_a_course_is_dropped(robot, monkeypatch):
    """Scaling the bound's mu by 0.9 imitates a map that is too coarse."""
    monkeypatch.setattr("moc_opt.planning.search._highest_nearby", lambda mu: 0.9 * mu)
    plan = make_plan(robot, robot.data.q_home, task(robot, robot.data.q_home, 20), swivels=180)
    assert np.isnan([plan.bound, plan.bound_from_start]).all()


def test_a_path_is_blocked_at_its_first_unreachable_point(robot):
    q = robot.data.q_home
    state = robot.state(q)
    away = np.linspace(0.0, 0.8, 81)[:, None] * np.array([0.0, 0.6, 0.8])
    targets = Targets(0.1 * np.arange(81), state.tip + away, state.wrist + away, np.linalg.norm(away, axis=1))
    plan = make_plan(robot, q, targets, swivels=360, refined=False)
    assert (plan.executable, plan.best, plan.climbed_whole, plan.blocked.t_s > 0.0) == (False, None, False, True)
    assert f"blocked: at t = {plan.blocked.t_s:.3f} s, {plan.blocked.reason}" in repr(plan)
    k = int(np.argmin(np.abs(targets.t_s - plan.blocked.t_s)))
    assert plan.blocked.arc_length_m == pytest.approx(0.01 * k)
    np.testing.assert_allclose(plan.blocked.tip_m, targets.tip[k])
    starts = np.random.default_rng(0).uniform(robot.q_min, robot.q_max, (100, 7))
    found = [[solve_pose(robot, q, targets.tip[i], targets.wrist[i]).found for q in starts] for i in (k - 1, k)]
    assert [any(each) for each in found] == [True, False]
    assert make_plan(robot, q, targets[: k + 1], swivels=360, refined=False).blocked.t_s == plan.blocked.t_s
    assert "out of reach" in plan.blocked.reason or "no pose there" in plan.blocked.reason


@pytest.mark.parametrize(("limits", "told"), [
    (Limits(speed_share=0.03), "joint_4 would have to turn at 1.03 times its speed limit"),
    (Limits(0.6), "within the joint limits: joint_4 is beyond its limit"),
    (Limits(1.957 * np.eye(7)[2], 0.15), "runs into its limit; only other swivels or branches"),
])  # fmt: skip
def test_the_joint_that_blocks_a_path_is_named(robot, limits, told):
    q = robot.data.q_home
    plan = make_plan(robot, q, task(robot, q, 60), limits, swivels=180, refined=False)
    assert told in plan.blocked.reason
    assert plan.blocked.t_s > 0.2, "while the tip rests, no speed is needed"


@pytest.mark.parametrize(("change", "name"), [
    ({"limits": Limits(3.0)}, "margin_rad"), ({"limits": Limits(np.full(6, 0.1))}, "margin_m"),
    ({"limits": Limits(speed_share=0.0)}, "speed_share"), ({"limits": Limits(speed_share=1.1)}, "speed_share"),
    ({"limits": Limits(shaft=1.05)}, "shaft_margin"), ({"limits": Limits(-0.1)}, "margin_rad"), ({}, "q_start"),
])  # fmt: skip
def test_errors_name_the_bad_argument(robot, change, name):
    q = robot.data.q_home
    with pytest.raises(TaskError, match=name):  # if ``change`` is empty, the start is off the path
        make_plan(robot, q if change else q + 0.01, task(robot, q, 10), **change)


def test_refinement_finds_a_course_that_a_coarse_map_lacks():
    scenario = Scenario(seed=1).change(start={"pose": "random"})
    coarse = {"swivels": 90, "speed_share": 0.15, "times": 100}
    found, grid = planned.plan(scenario, **coarse), planned.plan(scenario, **coarse, refined=False)
    assert (found.from_start.violation < MOST_VIOLATION, grid.from_start) == (True, None)
    assert "between poses of the map" in grid.blocked.reason


def test_a_course_far_below_the_bound_is_replaced(monkeypatch):
    best_course, asked = plan.best_course, []

    def poor(value, start):
        asked.append(start)
        return climb(value.map, start, Limits()) if len(asked) == 1 else best_course(value, start)

    monkeypatch.setattr(plan, "best_course", poor)
    trapped = Scenario(seed=9).change(start={"pose": "random"}, task={"path": "circle"})
    found = planned.plan(trapped, times=60, swivels=180)
    assert found.climbed_whole
    assert 1.15 * found.climbed.mu_mean < found.from_start.mu_mean <= found.bound_from_start
    assert [start is None for start in asked] == [False, True, False], "the search from the given start is repeated"


@pytest.mark.parametrize(("name", "margin"), [("margin_rad", -1.0), ("margin_m", np.inf), ("margin_m", "x")])
def test_the_error_for_a_wrong_margin_names_the_margin(name, margin):
    with pytest.raises(MocOptError, match=f"{name} = .*give zero or more"):
        planned.plan(Scenario(duration_s=0.1), times=5, **{name: margin})
