"""The plan of a scenario is that of its run: the same start, path and trocar; the command says it in 80 columns."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.__main__ import main
from moc_opt.errors import ScenarioError
from moc_opt.report.plan_table import plan_tables
from moc_opt.scenario import Setup
from moc_opt.scenario.planned import plan
from moc_opt.tasks.trocar import shaft_distance


@pytest.mark.parametrize("start", [{"pose": "random"}, {"swivel": "random"}, {}])
def test_the_plan_begins_where_the_run_does(start: dict[str, str]) -> None:
    scenario = mo.Scenario(seed=3).change(start=start, plant={"preset": "nominal"})
    found, setup = mo.plan(scenario, swivels=180, times=60), Setup(scenario)
    assert found.from_start is not None
    np.testing.assert_allclose(found.from_start.q_rad[0], setup.q_start, atol=1e-12)
    t = found.targets.t_s
    np.testing.assert_allclose(found.targets.tip, setup.reference.at(t)[0], atol=1e-12)
    assert t[-1] == pytest.approx(setup.duration_s)
    tips, wrists = setup.robot.tool_along(found.from_start.q_rad)
    assert shaft_distance(tips, wrists, setup.registered.at(t)[0]).max() < 1e-8


def test_no_run_beats_the_bound_of_its_plan() -> None:
    """mu of a real closed loop, in the nominal plant: what tracks to a tenth of a millimetre gains nothing by it."""
    scenario = mo.Scenario(bound_samples=0).change(plant={"preset": "nominal"})
    mean = float(mo.run(scenario).mu.mean())
    found = plan(scenario)
    assert mean < found.bound_from_start * 1.001
    assert mean > 0.9 * found.bound_from_start


def test_too_few_times_are_refused() -> None:
    with pytest.raises(ScenarioError, match="times = 1"):
        plan(mo.Scenario(), times=1)


# --- the command ---


def scenario_file(folder: Path, text: str) -> str:
    (folder / "mine.toml").write_text(text, encoding="utf-8")
    return str(folder / "mine.toml")


def test_the_command_prints_in_eighty_columns_and_writes_the_course(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    to = tmp_path / "course.parquet"
    assert main(["plan", "--out", str(to)]) == 0
    said = capsys.readouterr().out
    assert "can be executed from this start   yes" in said
    assert str(to) in said
    assert len(mo.Trace.load(to)) > 100


def test_tables_fit_eighty_columns(capsys: pytest.CaptureFixture[str]) -> None:
    from moc_opt.report.console import console

    found = plan(mo.Scenario(), swivels=180, times=60, margin_rad=0.6)
    assert found.blocked is not None
    screen = console()
    screen.width = 80
    pieces = [piece for table in plan_tables("circle", found) for piece in table.fitted(80)]
    for piece in pieces:
        screen.print(piece)
    said = capsys.readouterr().out
    assert max(len(line.rstrip()) for line in said.splitlines()) <= 80
    assert "first point out of reach" in said
    assert "100 % of their speed limits" in " ".join(said.split())


def test_a_path_that_cannot_be_executed_exits_with_three(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = scenario_file(tmp_path, '[task]\npath = "circle"\nv_max_m_per_s = 3.0\na_max_m_per_s2 = 50.0\n')
    assert main(["plan", file, "--json"]) == 3
    told = json.loads(capsys.readouterr().out)
    assert told["executable"] is False
    assert told["blocked"]["reason"]
    assert told["blocked"]["t_s"] > 0.0


def test_a_wrong_argument_exits_with_two(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "--speed-share", "2"]) == 2
    assert "--speed-share 2.0: give a share" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--margin", "-1"], "--margin -1.0: give zero or more"),
        (["--acceleration", "0"], "--acceleration 0.0: give a limit above 0"),
        (["--box", "0.1"], "--box 0.1: without --place nothing is searched"),
        (["--candidates", "3"], "--candidates 3: without --place nothing is searched"),
        (["--place", "base", "--candidates", "0"], "--candidates 0: give a whole number, 1 or more"),
        (["--place", "base", "--box", "2"], "--box 2.0: give half the edge"),
    ],
)
def test_a_wrong_option_is_named_as_it_was_typed(tmp_path, capsys, arguments, message):
    file = scenario_file(tmp_path, "duration_s = 0.1\n")
    assert main(["plan", file, *arguments]) == 2
    assert message in capsys.readouterr().err


def test_what_it_proposes_can_be_pasted_into_the_scenario(tmp_path, capsys):
    text = "duration_s = 1.0\nseed = 3\n"
    file = scenario_file(tmp_path, text + "[start]\nswivel = 0.15\n")
    found = plan(mo.Scenario.load(file))
    assert main(["plan", file]) == 0
    said = capsys.readouterr()
    assert said.err == ""  # its third level climbs: nobody is to follow the course
    assert max(len(line.rstrip()) for line in said.out.splitlines()) <= 80
    begun = scenario_file(tmp_path, text + said.out[said.out.index("\n[start]\n") :])
    again = plan(mo.Scenario.load(begun))
    assert again.from_start is not None
    assert again.from_start.mu_mean == pytest.approx(found.best.mu_mean, rel=1e-3)
    assert again.from_start.mu_mean > 1.02 * found.from_start.mu_mean


def test_it_plans_within_what_a_third_level_that_follows_keeps_to(tmp_path, capsys):
    file = scenario_file(tmp_path, 'duration_s = 0.5\n[control]\nthird_level = "planned"\n')
    assert main(["plan", file, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["within"] == {"margin_rad": 0.05, "margin_m": 0.0, "shaft_margin": 0.04375, "speed_share": 0.85}
    assert told["warnings"] == []
    assert main(["plan", file, "--json", "--speed-share", "1", "--margin", "0"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["within"] == {"margin_rad": 0.0, "margin_m": 0.0, "shaft_margin": 0.04375, "speed_share": 1.0}


@pytest.mark.parametrize("given", [None, 3])
def test_what_is_no_scenario_is_refused(given):
    for call in (mo.plan, mo.run):
        with pytest.raises(ScenarioError, match=r"give a Scenario, or the path"):
            call(given)


def test_the_third_level_is_chosen_from_the_command_line(tmp_path: Path) -> None:
    file, to = scenario_file(tmp_path, "duration_s = 0.3\nbound_samples = 0\n"), tmp_path / "run.parquet"
    assert main(["run", file, "--third-level", "receding", "--trace", str(to), "--json"]) == 0
    told = mo.Trace.load(to)
    assert told.meta["scenario"]["control"]["third_level"] == "receding"
    local = mo.run(mo.Scenario.load(file))
    assert np.abs(told.columns["x_rad_per_s"] - local.columns["x_rad_per_s"]).max() > 1e-3
