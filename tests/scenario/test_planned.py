"""The plan of a scenario is that of its run, and a run is compared with its best courses."""

import json

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.__main__ import main
from moc_opt.scenario import Setup
from moc_opt.scenario.derived import best_courses
from moc_opt.scenario.planned import plan
from moc_opt.tasks.trocar import shaft_distance


@pytest.mark.parametrize("start", [{"pose": "random"}, {"swivel": "random"}, {}])
def test_the_plan_begins_where_the_run_does(start):
    scenario = mo.Scenario(seed=3).change(start=start, plant={"preset": "nominal"})
    found, setup = mo.plan(scenario, swivels=180, times=60, refined=False), Setup(scenario)
    np.testing.assert_allclose(found.from_start.q_rad[0], setup.q_start, atol=1e-12)
    t = found.targets.t_s
    np.testing.assert_allclose(found.targets.tip, setup.reference.at(t)[0], atol=1e-12)
    assert t[-1] == pytest.approx(setup.duration_s)
    tips, wrists = setup.robot.tool_along(found.from_start.q_rad)
    assert shaft_distance(tips, wrists, setup.registered.at(t)[0]).max() < 1e-8


def test_no_run_beats_the_bound_of_its_plan():
    """mu of a real closed loop, in the nominal plant: what tracks to a tenth of a millimetre gains nothing by it."""
    scenario = mo.Scenario(bound_samples=0, judge=False, duration_s=3.0).change(plant={"preset": "nominal"})
    bound = plan(scenario, refined=False).bound_from_start
    assert 0.9 * bound < float(mo.run(scenario).mu.mean()) < bound * 1.001


def scenario_file(folder, text):
    (folder / "mine.toml").write_text(text, encoding="utf-8")
    return str(folder / "mine.toml")


def test_a_path_that_cannot_be_executed_exits_with_three(tmp_path, capsys):
    file = scenario_file(tmp_path, '[task]\npath = "circle"\nv_max_m_per_s = 3.0\na_max_m_per_s2 = 50.0\n')
    assert main(["plan", file, "--json"]) == 3
    told = json.loads(capsys.readouterr().out)
    assert told["executable"] is False
    assert told["blocked"]["reason"]
    assert told["blocked"]["t_s"] > 0.0


def test_what_it_proposes_can_be_pasted_into_the_scenario(tmp_path, capsys):
    text = "duration_s = 1.0\nseed = 3\n"
    file = scenario_file(tmp_path, text + "[start]\nswivel = 0.15\n")
    found = plan(mo.Scenario.load(file))
    assert main(["plan", file]) == 0
    said = capsys.readouterr()
    assert said.err == ""  # its third level climbs: nobody is to follow the course
    assert "can be executed from this start yes" in " ".join(said.out.split())
    assert max(len(line.rstrip()) for line in said.out.splitlines()) <= 80
    again = plan(mo.Scenario.load(scenario_file(tmp_path, text + said.out[said.out.index("\n[start]\n") :])))
    assert again.from_start.mu_mean == pytest.approx(found.best.mu_mean, rel=1e-3)
    assert again.from_start.mu_mean > 1.02 * found.from_start.mu_mean


def test_it_plans_within_what_a_third_level_that_follows_keeps_to(tmp_path, capsys):
    file = scenario_file(tmp_path, 'duration_s = 0.5\n[control]\nthird_level = "planned"\n')
    for options, margin, share in (([], 0.05, 0.85), (["--speed-share", "1", "--margin", "0"], 0.0, 1.0)):
        assert main(["plan", file, "--json", *options]) == 0
        told = json.loads(capsys.readouterr().out)
        within = {"margin_rad": margin, "margin_m": 0.0, "shaft_margin": 0.04375, "speed_share": share}
        assert told["within"] == within
        assert bool(told["warnings"]) == bool(options)  # such a course is too fast to be followed


COMPARED = mo.Scenario(duration_s=1.5, judge=False, bound_samples=0, best_courses=True, start={"swivel": 0.2})


@pytest.fixture(scope="module")
def trace():
    return mo.run(COMPARED)


def test_a_run_is_compared_with_the_courses_of_its_own_path(trace):
    robot, found = COMPARED.robot.arm(), plan(COMPARED)
    q = trace.columns["q_best_from_start_rad"]
    np.testing.assert_allclose(q[0], found.climbed.q_rad[0], atol=1e-12)
    np.testing.assert_allclose(trace.columns["mu_best_from_start"][::25], robot.mu_along(q[::25]), rtol=2e-3)
    metrics = mo.summarize(trace)
    for name, course in (("mu_fraction_of_best_from_start", found.from_start), ("mu_fraction_of_best", found.best)):
        assert metrics[name] == pytest.approx(metrics["mu_mean"] / course.mu_mean, rel=0.01)
    assert metrics["mu_fraction_of_best"] <= metrics["mu_fraction_of_best_from_start"] <= 1.005
    known = best_courses(COMPARED)  # planned once, whatever the controller
    assert known is best_courses(COMPARED.change(control={"preset": "tuned"}, solver={"name": "osqp"}))
    assert known is not best_courses(COMPARED.change(start={"swivel": 0.3}))


@pytest.mark.parametrize(("line", "there"), [("", True), ("best_courses = false\n", False)])
def test_the_command_run_compares_unless_the_scenario_says_no(tmp_path, capsys, line, there):
    file = scenario_file(tmp_path, f"{line}duration_s = 0.1\nbound_samples = 0\n")
    assert main(["run", file, "--seed", "3", "--json"]) == 0
    assert ("mu_fraction_of_best" in json.loads(capsys.readouterr().out)) == there


def test_of_an_arm_with_two_freedoms_the_reason_is_given():
    run = mo.run(COMPARED.change(robot={"name": "lwr4_rail"}, start={"swivel": "given"}, duration_s=0.1))
    assert "mu_best" not in run.columns
    assert "freedoms" in run.meta["best_courses"]["absent"]
