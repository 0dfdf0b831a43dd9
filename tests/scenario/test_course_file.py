"""A course in a file: written, read back, followed as one that is planned, and refused where it is another run's."""

from dataclasses import replace

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.__main__ import main
from moc_opt.errors import ScenarioError
from moc_opt.planning.guides import followed_course, load_course, speed_shares
from moc_opt.scenario import Setup
from moc_opt.scenario.planned import followable_plan, following_warnings, plan, save_course, targets_of

SCENARIO = mo.Scenario(bound_samples=0, judge=False, duration_s=1.0).change(control={"third_level": "planned"})


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    found, within = followable_plan(SCENARIO)
    saved = save_course(found, SCENARIO, tmp_path_factory.mktemp("course") / "course.parquet", within)
    trace = mo.Trace.load(saved)
    np.testing.assert_array_equal(trace.q_rad, found.from_start.q_rad)
    np.testing.assert_array_equal(trace.columns["swivel_rad"], found.swivel_rad)
    assert trace.meta["from_start"] is True
    return saved


def loaded(scenario):
    setup = Setup(scenario.change(control={"third_level": "local", "course": ""}))
    return load_course(scenario.control, setup.robot, setup.layout.q, targets_of(setup.robot, setup.layout))


def test_a_run_along_the_file_is_the_run_along_the_course_that_it_plans(file):
    planned = mo.run(SCENARIO)
    followed = mo.run(SCENARIO.change(control={"course": str(file)}))
    assert followed.meta["course_mu_mean"] == pytest.approx(planned.meta["course_mu_mean"], rel=1e-4)
    np.testing.assert_allclose(followed.q_rad, planned.q_rad, rtol=0.0, atol=1e-2)
    climbed = mo.run(SCENARIO.change(control={"third_level": "local"}))
    assert np.abs(climbed.q_rad - followed.q_rad).max() > 1e-3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"duration_s": 0.8}, "it goes from 0 to 1 s, the run from 0 to 0.8"),
        ({"start": {"swivel": 0.3}}, r"begins 0\.\d+ rad from the start of the run"),
        ({"task": {"v_max_m_per_s": 0.2}}, "mm off path and shaft at t ="),
        ({"robot": {"name": "iiwa14"}}, "a course of robot 'lwr4', this run's is 'iiwa14'"),
        ({"control": {"course_speed_fraction": 0.01}}, "plan it with --speed-share 0.01"),
        ({"control": {"course": "nowhere.parquet"}}, "nowhere.*no such file.*moc-opt plan"),
    ],
)
def test_a_course_of_another_run_is_refused_with_the_difference(file, change, message):
    with pytest.raises(ScenarioError, match=message):
        loaded(SCENARIO.change(control={"course": str(file)}).change(**change))


def test_a_file_that_is_no_course_is_refused(file, tmp_path):
    trace, to = mo.Trace.load(file), tmp_path / "other.parquet"
    mine, t, q = SCENARIO.change(control={"course": str(to)}), trace.t_s, trace.q_rad

    def moved(rows, joint, by):
        other = q.copy()
        other[rows, joint] += by
        return {"q_rad": other}

    for columns, meta, message in (
        ({"q_rad": q[:, :6]}, {}, r"q_rad \(\d+, 6\), a course of 7 joints"),
        (moved(3, 2, np.nan), {}, "a pose is not finite"),
        ({"t_s": t[::-1].copy()}, {}, "times t_s do not rise"),
        ({"t_s": np.round(t).astype(np.int64)}, {}, "t_s has shape"),
        (moved(slice(9, None), 6, 1000.0), {}, r"joint_7 goes 9\d\d\.?\d* rad beyond its limit"),
        (moved(5, slice(None), 0.05), {}, "mm off path and shaft at t = 0.125 s"),
        ({"t_s": t + 0.01}, {}, "it goes from 0.01 to 1.01 s"),
        ({}, {"kind": "run"}, "the file holds no course"),
        ({"q_rad": q + 0.1}, {"from_start": False}, r"from the start of the run; begin there: \[start\] q_rad = \["),
    ):
        mo.Trace({**trace.columns, **columns}, {**trace.meta, **meta}).save(to)
        with pytest.raises(ScenarioError, match=message):
            loaded(mine)


def test_a_course_is_made_smooth_within_what_it_was_planned_for(tmp_path):
    """Slower and further from limits than the third level's own."""
    within = {"margin_rad": 0.6, "speed_share": 0.1}
    to = save_course(plan(SCENARIO, **within), SCENARIO, tmp_path / "slow.parquet", within)
    scenario = SCENARIO.change(control={"course": str(to)})
    setup = Setup(scenario.change(control={"third_level": "local", "course": ""}))
    robot, period_s = setup.robot, targets_of(setup.robot, setup.layout).period_s
    slow, fast = (followed_course(replace(setup.following, settings=each.control)) for each in (scenario, SCENARIO))
    shares = [speed_shares(robot, course.q_rad, period_s).max() for course in (slow, fast)]
    assert 0.05 < shares[0] < 0.1 + 1e-6
    assert shares[1] > 0.3
    assert np.minimum(slow.q_rad - robot.q_min, robot.q_max - slow.q_rad)[:, :6].min() > 0.6 - 1e-6


def test_the_commands_write_and_follow_it(tmp_path, capsys):
    mine, to, ran = tmp_path / "mine.toml", tmp_path / "course.parquet", tmp_path / "run.parquet"
    text = 'duration_s = 0.3\nbound_samples = 0\nbest_courses = false\n[control]\nthird_level = "local"\n'
    mine.write_text(text, encoding="utf-8")
    for out, status in ((to, 0), (to, 0), (mine, 2)):  # a course replaces a course, and nothing else
        assert main(["plan", str(mine), "--out", str(out)]) == status
        assert "warning" not in capsys.readouterr().err
    assert mo.Trace.load(to).meta["within"]["speed_share"] == 0.85  # as if this third level followed it
    assert mine.read_text(encoding="utf-8") == text
    assert main(["run", str(mine), "--course", str(to), "--trace", str(ran)]) == 0
    assert mo.Trace.load(ran).meta["scenario"]["control"]["course"] == str(to)
    before, own = to.read_bytes(), tmp_path / "own.toml"
    own.write_text(text.replace("local", "planned") + 'course = "course.parquet"\n', encoding="utf-8")
    for command, message in (
        ([str(mine), "--course", str(to), "--third-level", "receding"], "only --third-level planned follows a file"),
        ([str(mine), "--course", str(to), "--trace", str(to)], "the course in that file; give another name"),
        ([str(own), "--trace", str(to)], "the course in that file; give another name"),
    ):
        assert main(["run", *command]) == 2
        assert message in capsys.readouterr().err
    assert to.read_bytes() == before
    assert main(["run", str(own), "--third-level", "local", "--json"]) == 0


def test_what_keeps_a_third_level_from_following_is_named_with_its_cure():
    scenario = mo.Scenario(duration_s=2.0, start={"swivel": 0.2})
    fast, robot = plan(scenario, refined=False), scenario.robot.arm()
    (said,) = following_warnings(scenario, fast)
    shares = np.abs(np.diff(fast.from_start.q_rad, axis=0)).max(axis=0) / fast.targets.period_s / robot.v_max
    assert robot.data.joint_names[int(np.argmax(shares))] in said
    assert f"{shares.max():.3f} of its speed limit" in said
    assert "--speed-share 0.85" in said
    for change, words in (({"preset": "paper"}, "regularization = 0"), ({"law": "dcac"}, "no third level")):
        assert any(words in line for line in following_warnings(scenario.change(control=change), fast))
