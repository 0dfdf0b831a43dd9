"""A third level follows the course (planned joint motion) of a file, if it is a course of this run."""

from dataclasses import replace

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.errors import ScenarioError
from moc_opt.planning import guides
from moc_opt.planning.guides import followed_course, load_course, speed_shares
from moc_opt.scenario import Setup
from moc_opt.scenario.planned import followable_plan, plan, save_course, targets_of

SCENARIO = mo.Scenario(bound_samples=0, judge=False, duration_s=1.0).change(control={"third_level": "planned"})


@pytest.fixture(scope="module")
def course(tmp_path_factory):
    found, within = followable_plan(SCENARIO)
    saved = save_course(found, SCENARIO, tmp_path_factory.mktemp("course") / "course.parquet", within)
    trace = mo.Trace.load(saved)
    np.testing.assert_array_equal(trace.q_rad, found.from_start.q_rad)
    np.testing.assert_array_equal(trace.columns["swivel_rad"], found.swivel_rad)
    assert trace.meta["from_start"] is True
    return saved


def without_course(scenario):
    return Setup(scenario.change(control={"third_level": "local", "course": ""}))


def loaded(scenario):
    setup = without_course(scenario)
    return load_course(scenario.control, setup.robot, setup.layout.q, targets_of(setup.robot, setup.layout))


def test_a_run_along_a_saved_course_equals_the_run_that_plans_it(course):
    planned = mo.run(SCENARIO)
    followed = mo.run(SCENARIO.change(control={"course": str(course)}))
    assert followed.meta["course_mu_mean"] == pytest.approx(planned.meta["course_mu_mean"], rel=1e-4)
    np.testing.assert_allclose(followed.q_rad, planned.q_rad, rtol=0.0, atol=1e-2)
    climbed = mo.run(SCENARIO.change(control={"third_level": "local"}))
    assert np.abs(climbed.q_rad - followed.q_rad).max() > 1e-3


@pytest.mark.parametrize(("change", "message"), [
    ({"duration_s": 0.8}, "it goes from 0 to 1 s, the run from 0 to 0.8"),
    ({"start": {"swivel": 0.3}}, r"begins 0\.\d+ rad from the start of the run; plan it"),
    ({"robot": {"name": "iiwa14"}}, "a course of robot 'lwr4', this run's is 'iiwa14'"),
    ({"control": {"course_speed_fraction": 0.01}}, "plan it with --speed-share 0.01"),
    ({"control": {"course": "nowhere.parquet"}}, "nowhere.*no such file.*moc-opt plan"),
])  # fmt: skip
def test_a_course_of_another_run_is_refused_with_the_difference(course, change, message):
    with pytest.raises(ScenarioError, match=message):
        loaded(SCENARIO.change(control={"course": str(course)}).change(**change))


def test_a_file_that_is_no_course_is_refused(course, tmp_path):
    trace, to = mo.Trace.load(course), tmp_path / "other.parquet"
    mine, t, q = SCENARIO.change(control={"course": str(to)}), trace.t_s, trace.q_rad

    def moved(rows, joint, by):
        other = q.copy()
        other[rows, joint] += by
        return {"q_rad": other}

    for columns, meta, message in (
        ({"q_rad": q[:, :6]}, {}, r"q_rad \(\d+, 6\), a course of 7 joints"),
        (moved(3, 2, np.nan), {}, "a pose is not finite"), ({"t_s": t[::-1].copy()}, {}, "times t_s do not rise"),
        ({"t_s": np.round(t).astype(np.int64)}, {}, "t_s has shape"),
        *((moved(slice(9, None), 6, by), {}, r"joint_7 goes 9\d\d\.?\d* rad beyond its limit") for by in (1e3, -1e3)),
        (moved(5, slice(None), 0.05), {}, "mm off path and shaft at t = 0.125 s"),
        ({"t_s": np.maximum(t, 0.01)}, {}, "it goes from 0.01 to 1 s"), ({}, {"kind": "run"}, "holds no course"),
        ({"q_rad": q + 0.1}, {"from_start": False}, r"from the start of the run; begin there: \[start\] q_rad = \["),
    ):  # fmt: skip
        mo.Trace({**trace.columns, **columns}, {**trace.meta, **meta}).save(to)
        with pytest.raises(ScenarioError, match=message):
            loaded(mine)


@pytest.mark.parametrize("last", [np.inf, None])
def test_a_course_that_cannot_brake_in_time_is_smoothed_without_the_brake_or_followed_as_it_is(
    course, monkeypatch, last
):
    scenario, tried = SCENARIO.change(control={"course": str(course)}), []

    def refined(robot, targets, course, limits, *, smoothness, brake):
        tried.append(brake)
        return replace(course) if brake == last else course

    monkeypatch.setattr(guides, "refine", refined)
    following = replace(without_course(scenario).following, settings=scenario.control)
    np.testing.assert_allclose(followed_course(following).q_rad, loaded(scenario)[0].q_rad)
    assert tried == [pytest.approx(0.9 * following.brake), np.inf]


def test_smoothing_a_course_keeps_the_limits_that_it_was_planned_for(tmp_path):
    within = {"margin_rad": 0.6, "speed_share": 0.1}
    to = save_course(plan(SCENARIO, **within), SCENARIO, tmp_path / "slow.parquet", within)
    scenario = SCENARIO.change(control={"course": str(to)})
    setup = without_course(scenario)
    course, limits = loaded(scenario)
    assert course.kept
    assert (limits.margin, limits.speed_share) == (pytest.approx(0.6, abs=1e-6), pytest.approx(0.1, abs=1e-6))
    assert limits.shaft == 0.25 * scenario.control.shaft_margin
    robot, period_s = setup.robot, targets_of(setup.robot, setup.layout).period_s
    slow, fast = (followed_course(replace(setup.following, settings=each.control)) for each in (scenario, SCENARIO))
    shares = [speed_shares(robot, course.q_rad, period_s).max() for course in (slow, fast)]
    assert 0.05 < shares[0] < 0.1 + 1e-6
    assert shares[1] > 0.3
    assert np.minimum(slow.q_rad - robot.q_min, robot.q_max - slow.q_rad)[:, :6].min() > 0.6 - 1e-6
