"""The nonlinear program keeps every constraint by the model's own kinematics, and is never worse than its start."""

from __future__ import annotations

from pathlib import Path

import casadi
import numpy as np
import pytest

from moc_opt.model.robot_model import RobotModel
from moc_opt.planning.course import OBJECTIVES, Objective, make_course
from moc_opt.planning.refine import OPTIONS, refine, too_fast
from moc_opt.planning.search import search
from moc_opt.planning.traced import traced_map
from moc_opt.scenario import Scenario
from moc_opt.scenario.planned import plan
from tests.planning.arms import PANDA, build
from tests.planning.test_search import course_of, map_of
from tests.planning.test_traced import line_from


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("free_start", [False, True])
def test_a_course_is_refined_between_its_grid_and_its_bound(
    robot: RobotModel, objective: Objective, free_start: bool
) -> None:
    q = robot.data.q_home
    found, step = map_of(robot, q, count=60, swivels=90)
    start = None if free_start else (q, robot.state(q).mu)
    course = course_of(robot, found, search(found, step, objective, start=start).q_rad)
    better = refine(robot, found.targets, course, objective, free_start=free_start)
    assert better.certified
    assert better.kept
    bound = search(found, step, objective, start=start, generous=True).value
    assert course.value(objective) <= better.value(objective) <= bound + 1e-12
    if not free_start:
        np.testing.assert_array_equal(better.q_rad[0], q)
    if objective != "worst":
        assert better.value(objective) > course.value(objective)


def test_perturbed_starts_of_the_program_find_nothing_better(robot: RobotModel) -> None:
    q = robot.data.q_home
    found, step = map_of(robot, q, count=40, swivels=360)
    begin = (q, robot.state(q).mu)
    best = refine(robot, found.targets, course_of(robot, found, search(found, step, start=begin).q_rad))
    rng, tried = np.random.default_rng(0), 0
    for _ in range(5):
        noisy = found.mu * np.exp(rng.normal(scale=0.5, size=found.mu.shape[2]))
        other = search(type(found)(**{**found.__dict__, "mu": noisy}), step, start=begin)
        if other.q_rad is None:
            continue
        tried += 1
        again = refine(robot, found.targets, make_course(robot, found.targets, other.q_rad))
        assert again.mu_mean <= best.mu_mean * (1.0 + 1e-6)
    assert tried > 2


def test_a_course_at_its_limits_stays_at_its_maximum_of_mu_when_it_is_made_smooth(robot: RobotModel) -> None:
    """From a start where the way to the better maximum is narrow: the program stays on it, and does not turn back."""
    q = (0.2912492688528833, -0.9312126696305606, -0.2813874639891124, -0.9455987681077571, 0.08576585626315732,
         -1.0843382517252966, 1.987021145390591)  # fmt: skip
    begin = {"q_rad": q, "check_path": False}
    circle = Scenario().change(start=begin, task={"sizes": {"radius": 0.02}})
    found = plan(circle, margin_rad=0.05, speed_share=0.97, refined=False)
    assert found.from_start is not None
    course = found.from_start
    smooth = refine(robot, found.targets, course, margin=0.05, speed_share=0.97, smoothness=1e-4)
    assert smooth is not course
    assert smooth.mu_mean > 0.99 * course.mu_mean
    assert found.climbed.mu_mean < 0.97 * course.mu_mean


def test_an_arm_without_closed_form_is_refined(tmp_path: Path) -> None:
    panda = build(tmp_path, PANDA)
    targets = line_from(panda, panda.data.q_home, 20)
    found, step = traced_map(panda, targets, panda.data.q_home, seeds=16), panda.v_max * targets.period_s
    start = (panda.data.q_home, panda.state(panda.data.q_home).mu)
    answer = search(found, step, start=start)
    assert answer.q_rad is not None
    course = make_course(panda, targets, answer.q_rad)
    better = refine(panda, targets, course)
    assert better.kept
    assert better.mu_mean >= course.mu_mean
    assert better.certified


def test_a_course_that_breaks_a_limit_is_said_to(robot: RobotModel) -> None:
    q = robot.data.q_home
    found, step = map_of(robot, q, count=20)
    answer = search(found, step)
    assert answer.q_rad is not None
    jump = np.array(answer.q_rad)
    jump[10, 6] += 3.5  # the idle joint: tip and wrist stay, its speed does not
    assert make_course(robot, found.targets, jump).violation == pytest.approx(
        abs(jump[10, 6] - jump[9, 6]) - robot.v_max[6] * found.targets.period_s
    )
    assert make_course(robot, found.targets, answer.q_rad, margin=1.5).violation > 0.1
    off = np.array(answer.q_rad)
    off[3, 1] += 1e-3
    assert make_course(robot, found.targets, off).violation > 1e-5


def test_a_joint_that_is_just_not_too_fast_stops_before_its_limit_by_braking_alone() -> None:
    """Carried on at the most speed that is allowed: never beyond the limit, never braked harder than told."""
    v, q, zero = casadi.MX.sym("v"), casadi.MX.sym("q"), casadi.DM(0.0)
    excess = casadi.Function("excess", [v, q], [too_fast(v, q, casadi.DM(-9.0), zero, 2.0)])
    pose, dt, speeds = -1.5, 1e-3, []
    for _ in range(6000):
        speeds.append(-float(excess(0.0, pose)[0]))
        pose += dt * speeds[-1]
        assert pose <= 0.0
    assert pose > -1e-3
    hardest = -np.diff(speeds).min() / dt
    assert 1.8 < hardest <= 2.0 + 1e-6
    assert float(excess(-100.0, -9.0)[1]) == 100.0, "the other way the other limit counts"


def test_a_course_brakes_off_before_the_limits_that_it_keeps(robot: RobotModel) -> None:
    """At margins at which the course without a brake is too fast towards a limit, by the rule itself."""
    q, brake, margin = robot.data.q_home, 0.5, 0.3
    found, step = map_of(robot, q, count=60, swivels=180)
    course = course_of(robot, found, search(found, step, start=(q, robot.state(q).mu), margin=margin).q_rad)
    dt, late = found.targets.period_s, []
    for limit in (np.inf, brake):
        poses = refine(robot, found.targets, course, margin=margin, brake=limit).q_rad
        speed, ends = np.diff(poses, axis=0) / dt, (robot.q_min + margin, robot.q_max - margin)
        rows = zip(speed, poses[1:], strict=True)
        excess = [too_fast(*(casadi.DM(given) for given in (*row, *ends)), brake) for row in rows]
        late.append(float(np.array(excess)[:, robot.moves.any(axis=0).tolist() * 2].max()))
    assert late[0] > 0.05
    assert late[1] < 1e-6


@pytest.mark.parametrize("slow", [{"speed_share": 1e-10}, {"acceleration": 1e-7}])
def test_a_course_for_which_the_joints_are_far_too_slow_is_none(robot: RobotModel, slow: dict[str, float]) -> None:
    """Also where a step is shorter than what limits are kept inside by: no bounds that cross."""
    q = robot.data.q_home
    found, step = map_of(robot, q, count=20)
    answer = search(found, step)
    assert answer.q_rad is not None
    assert not refine(robot, found.targets, make_course(robot, found.targets, answer.q_rad, **slow), **slow).kept


def test_a_course_is_certified_only_where_the_program_has_ended(robot: RobotModel, monkeypatch) -> None:
    """Stopped after few steps it may be better, and is at no optimum."""
    q = robot.data.q_home
    found, step = map_of(robot, q, count=60, swivels=90)
    course = course_of(robot, found, search(found, step, start=(q, robot.state(q).mu)).q_rad)
    said = []
    for most in (8, 300):
        monkeypatch.setitem(OPTIONS, "ipopt.max_iter", most)
        said.append(refine(robot, found.targets, course))
    assert [each.certified for each in said] == [False, True]
    assert course.mu_mean <= said[0].mu_mean < said[1].mu_mean
