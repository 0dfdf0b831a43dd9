"""Commands plan a course, follow it and compare runs with it."""

import json

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.__main__ import main
from moc_opt.scenario import Setup
from moc_opt.scenario.derived import best_courses
from moc_opt.scenario.planned import following_warnings, plan
from moc_opt.tasks.trocar import shaft_distance


@pytest.mark.parametrize("start", [{"pose": "random"}, {"swivel": "random"}, {}])
def test_plan_begins_at_the_start_of_the_run_and_follows_its_path(start):
    scenario = mo.Scenario(seed=3).change(start=start, plant={"preset": "nominal"})
    found, setup = mo.plan(scenario, swivels=180, times=60, refined=False), Setup(scenario)
    np.testing.assert_allclose(found.from_start.q_rad[0], setup.q_start, atol=1e-12)
    t = found.targets.t_s
    np.testing.assert_allclose(found.targets.tip, setup.reference.at(t)[0], atol=1e-12)
    assert t[-1] == pytest.approx(setup.duration_s)
    tips, wrists = setup.robot.tool_along(found.from_start.q_rad)
    assert shaft_distance(tips, wrists, setup.registered.at(t)[0]).max() < 1e-8


def scenario_file(folder, text):
    (folder / "mine.toml").write_text(text, encoding="utf-8")
    return str(folder / "mine.toml")


def test_command_plan_exits_with_3_for_impossible_path(tmp_path, capsys):
    file = scenario_file(tmp_path, '[task]\npath = "circle"\nv_max_m_per_s = 3.0\na_max_m_per_s2 = 50.0\n')
    assert main(["plan", file, "--json"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert (found["executable"], bool(found["blocked"]["reason"]), found["blocked"]["t_s"] > 0.0) == (False, True, True)


def test_proposed_start_can_be_pasted_into_the_scenario(tmp_path, capsys):
    text = "duration_s = 1.0\nseed = 3\n"
    file = scenario_file(tmp_path, text + "[start]\nswivel = 0.15\n")
    found = plan(mo.Scenario.load(file))
    assert main(["plan", file]) == 0
    said = capsys.readouterr()
    assert said.err == ""  # no warnings, because third_level = 'local' follows no course
    assert "can be executed from this start yes" in " ".join(said.out.split())
    assert max(len(line.rstrip()) for line in said.out.splitlines()) <= 80
    again = plan(mo.Scenario.load(scenario_file(tmp_path, text + said.out[said.out.index("\n[start]\n") :])))
    assert again.from_start.mu_mean == pytest.approx(found.best.mu_mean, rel=1e-3)
    assert again.from_start.mu_mean > 1.02 * found.from_start.mu_mean


def test_options_of_plan_replace_the_limits_of_the_third_level(tmp_path, capsys):
    file = scenario_file(tmp_path, 'duration_s = 0.5\n[control]\nthird_level = "planned"\n')
    for options, margin, share in (([], 0.05, 0.85), (["--speed-share", "1", "--margin", "0"], 0.0, 1.0)):
        assert main(["plan", file, "--json", *options]) == 0
        found = json.loads(capsys.readouterr().out)
        within = {"margin_rad": margin, "margin_m": 0.0, "shaft_margin": 0.04375, "speed_share": share}
        assert found["within"] == within
        assert bool(found["warnings"]) == bool(options)  # a course with speed share 1 is too fast to be followed


COMPARED = mo.Scenario(duration_s=1.5, judge=False, bound_samples=0, best_courses=True, start={"swivel": 0.2})


def test_run_is_compared_with_the_best_courses_along_its_path():
    trace, robot, found = mo.run(COMPARED), COMPARED.robot.arm(), plan(COMPARED)
    q = trace.columns["q_best_from_start_rad"]
    np.testing.assert_allclose(q[0], found.climbed.q_rad[0], atol=1e-12)
    np.testing.assert_allclose(trace.columns["mu_best_from_start"][::25], robot.mu_along(q[::25]), rtol=2e-3)
    metrics = mo.summarize(trace)
    for name, course in (("mu_fraction_of_best_from_start", found.from_start), ("mu_fraction_of_best", found.best)):
        assert metrics[name] == pytest.approx(metrics["mu_mean"] / course.mu_mean, rel=0.01)
    assert metrics["mu_fraction_of_best"] <= metrics["mu_fraction_of_best_from_start"] <= 1.005
    known = best_courses(COMPARED)  # planned once for all controllers
    assert known is best_courses(COMPARED.change(control={"preset": "tuned"}, solver={"name": "osqp"}))
    assert known is not best_courses(COMPARED.change(start={"swivel": 0.3}))


@pytest.mark.parametrize(("line", "there"), [("", True), ("best_courses = false\n", False)])
def test_command_run_compares_with_best_courses_by_default(tmp_path, capsys, line, there):
    file = scenario_file(tmp_path, f"{line}duration_s = 0.1\nbound_samples = 0\n")
    assert main(["run", file, "--seed", "3", "--json"]) == 0
    assert ("mu_fraction_of_best" in json.loads(capsys.readouterr().out)) == there


def test_trace_says_why_an_arm_on_a_rail_has_no_courses():
    run = mo.run(COMPARED.change(robot={"name": "lwr4_rail"}, start={"swivel": "given"}, duration_s=0.1))
    assert "mu_best" not in run.columns
    assert "degrees of freedom" in run.meta["best_courses"]["absent"]


def test_commands_write_a_course_and_follow_it(tmp_path, capsys):
    to, ran = tmp_path / "course.parquet", tmp_path / "run.parquet"
    text = 'duration_s = 0.3\nbound_samples = 0\nbest_courses = false\n[control]\nthird_level = "local"\n'
    mine = scenario_file(tmp_path, text)
    for out, status in ((to, 0), (to, 0), (mine, 2)):  # --out may replace only a course file
        assert main(["plan", mine, "--out", str(out)]) == status
        assert "warning" not in capsys.readouterr().err
    assert mo.Trace.load(to).meta["within"]["speed_share"] == 0.85  # as for third_level = 'planned'
    assert (tmp_path / "mine.toml").read_text(encoding="utf-8") == text
    assert main(["run", mine, "--course", str(to), "--trace", str(ran)]) == 0
    assert mo.Trace.load(ran).meta["scenario"]["control"]["course"] == str(to)
    before, own = to.read_bytes(), tmp_path / "own.toml"
    own.write_text(text.replace("local", "planned") + 'course = "course.parquet"\n', encoding="utf-8")
    for command, message in (
        ([mine, "--course", str(to), "--third-level", "receding"], "only --third-level planned follows a file"),
        ([mine, "--course", str(to), "--trace", str(to)], "the course in that file; give another name"),
        ([str(own), "--trace", str(to)], "the course in that file; give another name"),
    ):
        assert main(["run", *command]) == 2
        assert message in capsys.readouterr().err
    assert to.read_bytes() == before
    assert main(["run", str(own), "--third-level", "local", "--json"]) == 0


def test_warning_says_why_a_course_cannot_be_followed():
    scenario = mo.Scenario(duration_s=2.0, start={"swivel": 0.2})
    fast, robot = plan(scenario, refined=False), scenario.robot.arm()
    (said,) = following_warnings(scenario, fast)
    shares = np.abs(np.diff(fast.from_start.q_rad, axis=0)).max(axis=0) / fast.targets.period_s / robot.v_max
    assert robot.data.joint_names[int(np.argmax(shares))] in said
    assert f"{shares.max():.3f} of its speed limit" in said
    assert "--speed-share 0.85" in said
    for change, words in (({"preset": "paper"}, "regularization = 0"), ({"law": "dcac"}, "no third level")):
        assert any(words in line for line in following_warnings(scenario.change(control=change), fast))
