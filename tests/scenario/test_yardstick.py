"""The best courses that a run is compared with: of its own path, the same for every controller."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.__main__ import main
from moc_opt.planning.climb import top_of
from moc_opt.report.map_page import best_courses
from moc_opt.scenario.planned import plan
from moc_opt.scenario.yardstick import yardstick
from moc_opt.trace.trace import Trace

ASKED = mo.Scenario(duration_s=1.5, judge=False, bound_samples=0, best_courses=True, start={"swivel": 0.2})


@pytest.fixture(scope="module")
def trace() -> Trace:
    return mo.run(ASKED)


def test_a_run_is_compared_with_the_courses_of_its_own_path(trace: Trace) -> None:
    robot, found = ASKED.robot.arm(), plan(ASKED)
    q = trace.columns["q_best_from_start_rad"]
    np.testing.assert_allclose(q[0], found.climbed.q_rad[0], atol=1e-12)
    np.testing.assert_allclose(trace.columns["mu_best_from_start"][::25], robot.mu_along(q[::25]), rtol=2e-3)
    metrics = mo.summarize(trace)
    assert found.from_start is not None
    assert found.best is not None
    for name, course in (("from_start", found.from_start), ("", found.best)):
        share = metrics["mu_fraction_of_best" + ("_" if name else "") + name]
        assert share == pytest.approx(metrics["mu_mean"] / course.mu_mean, rel=0.01)
    assert metrics["mu_fraction_of_best"] <= metrics["mu_fraction_of_best_from_start"] <= 1.005


def test_the_courses_do_not_depend_on_the_controller_and_are_planned_once(trace: Trace) -> None:
    other = mo.run(ASKED.change(control={"law": "dcac"}))
    for name in ("mu_best_from_start", "mu_best", "q_best_from_start_rad"):
        np.testing.assert_array_equal(trace.columns[name], other.columns[name])
    assert yardstick(ASKED) is yardstick(ASKED.change(control={"preset": "tuned"}, solver={"name": "osqp"}))
    assert yardstick(ASKED) is not yardstick(ASKED.change(start={"swivel": 0.3}))


def test_a_run_into_a_file_has_them_too(trace: Trace, tmp_path: Path) -> None:
    written = mo.run(ASKED, to=tmp_path / "run.parquet")
    np.testing.assert_array_equal(written.columns["mu_best"][:], trace.columns["mu_best"])
    assert written.meta["best_courses"] == trace.meta["best_courses"]
    assert written.meta["best_courses"]["absent"] == ""


def test_without_the_setting_nothing_is_planned() -> None:
    quick = mo.run(ASKED.change(best_courses=False, duration_s=0.02))
    assert "mu_best" not in quick.columns
    assert "best_courses" not in quick.meta
    assert "mu_fraction_of_best" not in mo.summarize(quick)


@pytest.mark.parametrize(("line", "there"), [("", True), ("best_courses = false\n", False)])
def test_the_command_run_compares_unless_the_scenario_says_no(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], line: str, there: bool
) -> None:
    (tmp_path / "short.toml").write_text(f"{line}duration_s = 0.1\nbound_samples = 0\n", encoding="utf-8")
    assert main(["run", str(tmp_path / "short.toml"), "--seed", "3", "--json"]) == 0
    assert ("mu_fraction_of_best" in json.loads(capsys.readouterr().out)) == there


def test_of_an_arm_with_two_freedoms_the_reason_is_given() -> None:
    run = mo.run(ASKED.change(robot={"name": "lwr4_rail"}, start={"swivel": "given"}, duration_s=0.1))
    assert "mu_best" not in run.columns
    assert "freedoms" in run.meta["best_courses"]["absent"]


def test_the_top_above_a_pose_is_one_and_told_from_a_limit() -> None:
    known = yardstick(ASKED)
    found = known.last
    assert found is not None
    top = top_of(found, found.poses(-1)[0, 100])
    assert top is not None
    column, may = found.mu[-1, 0], found.feasible()[-1]
    b, j = np.argwhere((found.poses(-1) == top.q_rad).all(axis=2))[0]
    assert may[b, j]
    beside = [column[(j + side) % len(column)] for side in (-1, 1) if may[b, (j + side) % len(column)]]
    assert max(beside) <= top.mu == column[j]
    assert top.at_limit == bool(max(column[j - 1], column[(j + 1) % len(column)]) > top.mu)


def test_the_map_page_gets_one_course_for_each_start(trace: Trace) -> None:
    later = trace.with_columns(q_best_from_start_rad=trace.columns["q_best_from_start_rad"] + 0.1)
    found = best_courses({"a": trace, "b": trace, "c": later, "d": trace.select(np.arange(len(trace)) < 9)})
    assert list(found) == ["best course from the start of a", "best course from the start of c"]
    course = found["best course from the start of a"].q_rad
    np.testing.assert_array_equal(course, trace.columns["q_best_from_start_rad"])
