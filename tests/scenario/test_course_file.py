"""A course in a file: written, read back, followed as one that is planned, and refused where it is another run's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.__main__ import main
from moc_opt.errors import ControlError, ScenarioError
from moc_opt.planning import guides
from moc_opt.planning.guides import followed_course, load_course, speed_shares
from moc_opt.planning.plan import Plan
from moc_opt.scenario import Setup
from moc_opt.scenario.planned import followable_plan, following_warnings, plan, save_course, targets_of

SCENARIO = mo.Scenario(bound_samples=0, judge=False, duration_s=1.0).change(control={"third_level": "planned"})


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found, within = followable_plan(SCENARIO, None, None, objective="mean", acceleration=np.inf)
    return save_course(found, SCENARIO, tmp_path_factory.mktemp("course") / "course.parquet", within)


def loaded(scenario: mo.Scenario) -> Any:
    setup = Setup(scenario.change(control={"third_level": "local", "course": ""}))
    return load_course(scenario.control, setup.robot, setup.layout.q, targets_of(setup.robot, setup.layout))


def test_a_course_is_written_and_read_back(tmp_path: Path) -> None:
    scenario = mo.Scenario()
    found = plan(scenario, swivels=180, times=60)
    trace = mo.Trace.load(save_course(found, scenario, tmp_path / "course.parquet"))
    assert found.from_start is not None
    np.testing.assert_array_equal(trace.q_rad, found.from_start.q_rad)
    np.testing.assert_array_equal(trace.columns["swivel_rad"], found.swivel_rad)
    assert trace.meta["from_start"] is True


def test_a_run_along_the_file_is_the_run_along_the_course_that_it_plans(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    planned = mo.run(SCENARIO)
    monkeypatch.setattr(guides, "best_course", lambda *given, **more: pytest.fail("the course is in the file"))
    followed = mo.run(SCENARIO.change(control={"course": str(file)}))
    assert followed.meta["course_mu_mean"] == pytest.approx(planned.meta["course_mu_mean"], rel=1e-4)
    np.testing.assert_allclose(followed.q_rad, planned.q_rad, rtol=0.0, atol=1e-2)
    climbed = mo.run(SCENARIO.change(control={"third_level": "local"}))
    assert np.abs(climbed.q_rad - followed.q_rad).max() > 1e-3


def changed(file: Path, to: Path, **columns: Any) -> mo.Scenario:
    trace = mo.Trace.load(file)
    mo.Trace({**trace.columns, **columns}, trace.meta).save(to)
    return SCENARIO.change(control={"course": str(to)})


def test_a_course_of_another_run_is_refused_with_the_difference(file: Path) -> None:
    mine = SCENARIO.change(control={"course": str(file)})
    for change, message in (
        ({"duration_s": 0.8}, "it goes from 0 to 1 s, the run from 0 to 0.8"),
        ({"start": {"swivel": 0.3}}, r"begins 0\.\d+ rad from the start of the run"),
        ({"task": {"v_max_m_per_s": 0.2}}, "mm off path and shaft at t ="),
        ({"robot": {"name": "iiwa14"}}, "a course of robot 'lwr4', this run's is 'iiwa14'"),
        ({"control": {"course_speed_fraction": 0.01}}, "plan it with --speed-share 0.01"),
    ):
        with pytest.raises(ScenarioError, match=message):
            loaded(mine.change(**change))


def test_a_file_that_is_no_course_is_refused(file: Path, tmp_path: Path) -> None:
    trace, to = mo.Trace.load(file), tmp_path / "other.parquet"
    t, q = trace.t_s, trace.q_rad
    broken, gone, idle, far = (np.array(q) for _ in range(4))
    broken[3, 2], gone[5] = np.nan, q[5] + 0.05
    idle[9:, 6] += 0.5
    far[9:, 6] += 1000.0
    for columns, message in (
        ({"q_rad": q[:, :6]}, r"q_rad \(\d+, 6\), a course of 7 joints"),
        ({"q_rad": broken}, "a pose is not finite"),
        ({"t_s": t[::-1].copy()}, "times t_s do not rise"),
        ({"t_s": np.round(t).astype(np.int64)}, "t_s has shape"),
        ({"q_rad": idle}, r"joint_7 moves neither tip nor wrist and turns by 0\.5 rad"),
        ({"q_rad": far}, r"joint_7 goes 9\d\d\.?\d* rad beyond its limit"),
        ({"q_rad": gone}, "mm off path and shaft at t = 0.125 s"),
        ({"t_s": t + 0.01}, "it goes from 0.01 to 1.01 s"),
    ):
        with pytest.raises(ScenarioError, match=message):
            loaded(changed(file, to, **columns))
    with pytest.raises(ScenarioError, match=r"\[control\] course = .*nowhere.*no such file.*moc-opt plan"):
        loaded(SCENARIO.change(control={"course": str(tmp_path / "nowhere.parquet")}))
    mo.Trace(trace.columns, {"robot": "lwr4"}).save(to)
    with pytest.raises(ScenarioError, match="the file holds no course"):
        loaded(SCENARIO.change(control={"course": str(to)}))
    elsewhere = mo.Trace({**trace.columns, "q_rad": q + 0.1}, {**trace.meta, "from_start": False})
    elsewhere.save(to)
    with pytest.raises(ScenarioError, match=r"no course begins at this start, .*; begin there: \[start\] q_rad = \["):
        loaded(SCENARIO.change(control={"course": str(to)}))


def test_a_course_is_made_smooth_within_what_it_was_planned_for(tmp_path: Path) -> None:
    """Slower, further from limits and for another objective than the third level's own."""
    within = {"margin_rad": 0.6, "speed_share": 0.1}
    found = plan(SCENARIO, **within)
    to = save_course(found, SCENARIO, tmp_path / "slow.parquet", within)
    scenario = SCENARIO.change(control={"course": str(to)})
    setup = Setup(scenario.change(control={"third_level": "local", "course": ""}))
    robot, targets = setup.robot, targets_of(setup.robot, setup.layout)
    slow, fast = (followed_course(replace(setup.following, settings=each.control)) for each in (scenario, SCENARIO))
    shares = [speed_shares(robot, course.q_rad, targets.period_s).max() for course in (slow, fast)]
    assert 0.05 < shares[0] < 0.1 + 1e-6
    assert shares[1] > 0.3
    assert np.minimum(slow.q_rad - robot.q_min, robot.q_max - slow.q_rad)[:, :6].min() > 0.6 - 1e-6
    trace = mo.Trace.load(to)
    for wrong in ({"margin_rad": "much"}, {"speed_share": -1.0}, ["acceleration"]):
        mo.Trace(trace.columns, {**trace.meta, "within": wrong}).save(to)
        with pytest.raises(ScenarioError, match="no usable"):
            loaded(scenario)


def test_a_course_that_nobody_follows_is_refused(file: Path) -> None:
    for change in ({"third_level": "local"}, {"third_level": "receding"}):
        with pytest.raises(ControlError, match="only third_level = 'planned' follows a file"):
            SCENARIO.change(control={"course": str(file), **change})
    assert mo.Scenario().control.replace(SCENARIO.control.matched_dcac()).course == ""


def test_the_commands_write_and_follow_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mine, to, ran = tmp_path / "mine.toml", tmp_path / "course.parquet", tmp_path / "run.parquet"
    mine.write_text('duration_s = 0.5\nbound_samples = 0\n[control]\nthird_level = "local"\n', encoding="utf-8")
    assert main(["plan", str(mine), "--out", str(to)]) == 0  # to be followed, though this third level follows none
    assert "warning" not in capsys.readouterr().err
    assert mo.Trace.load(to).meta["within"]["speed_share"] == 0.85
    assert main(["run", str(mine), "--course", str(to), "--trace", str(ran)]) == 0
    assert mo.Trace.load(ran).meta["scenario"]["control"]["course"] == str(to)
    assert main(["run", str(mine), "--course", str(to), "--seed", "1", "--third-level", "local"]) == 2
    assert "only --third-level planned follows a file" in capsys.readouterr().err
    assert main(["run", str(mine), "--course", ""]) == 2
    assert "give the file" in capsys.readouterr().err
    before = to.read_bytes()
    own = tmp_path / "own.toml"
    planned = mine.read_text(encoding="utf-8").replace("local", "planned")
    own.write_text(planned + 'course = "course.parquet"\n', encoding="utf-8")
    for command in (["run", str(mine), "--course", str(to)], ["run", str(own)]):
        assert main([*command, "--trace", str(to)]) == 2
        assert "that file is read; give another name" in capsys.readouterr().err
    assert to.read_bytes() == before
    assert main(["run", str(own), "--third-level", "local", "--json"]) == 0


# --- what keeps a third level from following ---

WARNED = mo.Scenario(duration_s=2.0, start={"swivel": 0.2})


@pytest.fixture(scope="module")
def fast() -> Plan:
    return plan(WARNED, refined=False)


def test_a_course_that_is_too_fast_is_named_with_joint_and_cure(fast: Plan) -> None:
    (said,) = following_warnings(WARNED, fast)
    assert fast.from_start is not None
    robot = WARNED.robot.arm()
    shares = np.abs(np.diff(fast.from_start.q_rad, axis=0)).max(axis=0) / fast.targets.period_s / robot.v_max
    assert robot.data.joint_names[int(np.argmax(shares))] in said
    assert f"{shares.max():.2f} of its speed limit" in said
    assert "--speed-share 0.85" in said


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"preset": "paper"}, "regularization = 0"),
        ({"law": "dcac"}, "no third level"),
        ({"course_margin_rad": 1.2}, "lower course_margin_rad"),
    ],
)
def test_what_else_is_in_the_way_is_said(fast: Plan, change: dict[str, object], said: str) -> None:
    assert any(said in line for line in following_warnings(WARNED.change(control=change), fast))
