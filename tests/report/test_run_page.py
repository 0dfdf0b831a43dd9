"""Tables and pages of runs."""

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import moc_opt as mo
from moc_opt.__main__ import main
from moc_opt.errors import ReportError
from moc_opt.report.document import save_document
from moc_opt.report.run_page import run_page
from moc_opt.report.run_table import run_json, run_tables, title_of
from moc_opt.trace.trace import Trace

WARNING = {"of": "the RCM error", "first_s": 1.25, "largest": 11.04, "unit": "mm", "level": 6.0}


def trace(ended="completed", ticks=4, **meta):
    counts = {"period_s": 0.1, "ticks": ticks, "ticks_planned": 4}
    return Trace({"t_s": 0.1 * np.arange(ticks)}, {"ended": ended, **counts, **meta})


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> list[Path]:
    trial = mo.Scenario(duration_s=0.1, judge=False, bound_samples=0)
    folder = tmp_path_factory.mktemp("runs")
    found = {"moc": trial, "dcac": trial.change(control={"law": "dcac"})}
    for name, scenario in found.items():
        mo.run(scenario).save(folder / f"{name}.parquet")
    return [folder / f"{name}.parquet" for name in found]


def test_ending_is_the_first_row():
    metrics = {"completed": 0.0, "share_of_run": 0.75, "mu_mean": 0.25}
    stopped = trace("stopped: x", 3, warnings=[WARNING])
    (table,) = run_tables({"slip": stopped}, {"slip": metrics})
    assert [row["metric"] for row in table.rows] == ["ended", "completed", "share_of_run", "mu_mean (part)"]
    assert (table.title, table.rows[0]["run slip"]) == ("slip (first 0.3 s of 0.4 s, braking included)", "stopped: x")
    assert "the RCM error was above 6 mm, first at t = 1.250 s; its maximum was 11 mm" in table.caption
    assert list(run_json(stopped, {"mu_mean": 0.2}).items()) == [
        ("ended", "stopped: x"), ("part", "first 0.3 s of 0.4 s, braking included"), ("mu_mean", 0.2),
        ("warnings", [WARNING]), ("faults", {}),
    ]  # fmt: skip
    for ended in ("completed", "oscillated: joint_7"):
        (table,) = run_tables({"slip": trace(ended)}, {"slip": metrics})
        assert [row["metric"] for row in table.rows] == ["ended", *metrics]


@pytest.mark.parametrize(("raised", "most"), [(2, False), (3, True)])
def test_replaced_answers_are_reported_above_the_metrics(raised, most):
    faults = {"raised": {"count": raised, "first_at_s": 0.0, "first": "ZeroDivisionError"}}
    (table,) = run_tables({"slip": trace(faults=faults)}, {"slip": {"mu_mean": 0.25}}, first=True)
    assert [row["metric"] for row in table.rows] == ["ended", "solver replaced", "mu_mean"]
    said = table.rows[1]["run slip"]
    assert said.startswith(f"at {raised} of 4 ticks")
    assert ("not this solver's" in said) == most
    found = run_json(trace(faults=faults), {"mu_mean": 0.25})
    assert list(found).index("solver_replaced") < list(found).index("mu_mean")
    assert found["solver_replaced"] == said
    assert "solver_replaced" not in run_json(trace(), {})


@pytest.mark.parametrize(
    ("solver", "law", "shown"), [("nlp-sqp", "moc", "–"), ("osqp", "moc", "4"), ("nlp-sqp", "dcac", "4")]
)
def test_answers_of_nonlinear_solvers_are_not_judged(solver, law, shown):
    run = trace(scenario={"solver": {"name": solver}, "control": {"law": law}})
    metrics = {"mu_mean": 0.2, "verified_solved": 4.0, "silently_wrong": 4.0}
    (table,) = run_tables({"x": run}, {"x": metrics}, first=True)
    (value,) = (table.cells(column) for column in table.columns if column.title == "value")
    assert [cell.text for cell in value] == ["completed", "0.2000", shown, shown]
    assert ("nonlinear" in table.caption) == (shown == "–")
    assert run_json(run, metrics)["silently_wrong"] == (None if shown == "–" else 4.0)
    assert "silently_wrong" not in run_json(run, {})


@pytest.mark.parametrize(("table", "status", "ended"), [
    ("", 0, "completed"), ("[plant]\nfriction = 0.0\n", 3, "oscillated: joint_7 at "),
    ("[guard]\nrcm_error_m = 1e-5\nrcm_warning_m = 1e-5\n", 3, "stopped: the RCM error has been above 0.01 mm"),
], ids=["completed", "oscillated", "stopped"])  # fmt: skip
def test_exit_status_is_zero_only_after_completion(tmp_path, capsys, table, status, ended):
    file = tmp_path / "s.toml"
    file.write_text(
        'name = "one"\nduration_s = 2.0\nbound_samples = 0\njudge = false\n'
        f"[control]\nK_X = 3000.0\nD_X = 80.0\nK_N = 800.0\nD_N = 60.0\nK_N2 = 80.0\nD_N2 = 1.0\n{table}"
    )
    assert main(["run", str(file), "--json"]) == status
    said = capsys.readouterr()
    found = json.loads(said.out, parse_constant=pytest.fail)
    assert found["ended"].startswith(ended)
    assert found["completed"] == float(status == 0)
    assert ("one: " + found["ended"] in said.err) == (status != 0)
    if ended.startswith("stopped"):
        assert found["share_of_run"] < 1.0
        assert [w["of"] for w in found["warnings"]] == ["the RCM error"]
    # A run is not compared with DCAC if DCAC was stopped before it.
    assert "mu_gain_percent" in found or (ended.startswith("stopped") and "not compared with DCAC" in said.err)


def test_incomplete_run_has_a_table_of_its_own():
    late = {"late": {"count": 1, "first_at_s": 0.0, "first": "x"}}
    runs = {"a": trace(faults=late), "b": trace("oscillated: joint_7", scenario={"solver": {"name": "nlp-sqp"}})}
    metrics = {"a": {"mu_mean": 0.2, "silently_wrong": 1.0}, "b": {"mu_mean": 0.3, "silently_wrong": 1.0}}
    (table,) = run_tables(runs, metrics, first=True)
    cells = {column.title: [cell.text for cell in table.cells(column)] for column in table.columns}
    assert cells["metric"] == ["ended", "solver replaced", "mu_mean", "silently_wrong"]
    assert cells["a"] == ["completed", "at 1 of 4 ticks: late 1", "0.2000", "1"]
    assert cells["b"] == ["oscillated", "–", "0.3000", "–"]
    assert "nonlinear" in table.caption
    apart = run_tables({**runs, "b": trace("stopped: x", 3)}, metrics, first=True)
    assert [table.title for table in apart] == ["a", "b (first 0.3 s of 0.4 s, braking included)"]


def test_page_title_states_arm_then_task_then_gains_then_solver(tmp_path, capsys, files):
    file, page = tmp_path / "line.toml", tmp_path / "pages" / "line.html"
    file.write_text('duration_s = 0.4\nbound_samples = 3\n[task]\npath = "line"\n', encoding="utf-8")
    assert main(["run", str(file), "--report", str(page), "--trace", str(tmp_path / "a.parquet")]) == 0
    assert str(page) in capsys.readouterr().err
    text = page.read_text(encoding="utf-8")
    assert "<title>lwr4, line, default gains: exact</title>" in text
    assert all(words in text for words in ("DCAC (same gains)", "mu_gain_percent", "verified_solved"))
    both = tmp_path / "both.html"
    assert main(["report", *map(str, files), "--out", str(both)]) == 0
    assert "<title>lwr4, circle, default gains: exact and dcac</title>" in both.read_text(encoding="utf-8")
    assert title_of({"a": trace(), "b": trace()}) == "a and b"
    assert main(["run", str(tmp_path / "a.parquet")]) == 2
    assert "is a trace, not a scenario: `moc-opt report`, `replay` or `map` shows it" in capsys.readouterr().err
    assert main(["run", str(tmp_path / "arm.urdf")]) == 2
    assert "arm.urdf is a robot, not a scenario: `moc-opt robot new" in capsys.readouterr().err


def test_page_without_a_map_has_curves(robot):
    t = np.linspace(0.0, 1.0, 20)
    own = Trace({"t_s": t, "mu": 0.1 + t}, {"ended": "stopped: too far off"})
    found = run_page({"own": own}, {"own": {"mu_mean": 0.6}}, robot)
    assert set(found.figures) == {"curves"}
    assert all(words in found.html() for words in ("There is no map", "stopped: too far off"))


def test_map_writes_page_and_figures(files, tmp_path, capsys, chromium):
    out = tmp_path / "new" / "map.html"
    assert main(["map", *map(str, files), "--out", str(out), "--figures"]) == 0
    figures = [out.parent / "figures" / f"map.{kind}" for kind in ("svg", "pdf")]
    assert capsys.readouterr().out.split() == [str(file) for file in (out, *figures)]
    assert all(file.stat().st_size > 10_000 for file in (out, *figures))


@pytest.mark.parametrize("command", ["report", "replay", "map"])
def test_page_replaces_foreign_files_only_with_force(files, tmp_path, capsys, command):
    out = tmp_path / "page.html"
    out.write_text("mine")
    for place, said in (
        (tmp_path, "a folder, pipe or device is there"), (out, "--force"), (out / "x.html", "cannot be written"),
    ):  # fmt: skip
        assert main([command, str(tmp_path / "no.parquet"), "--out", str(place)]) == 2, "before the trace is read"
        assert said in capsys.readouterr().err
    assert out.read_text() == "mine"
    order = [command, str(files[0]), "--out", str(out)]
    assert main([*order, "--force"]) == 0
    assert main(order) == 0, "a page that moc_opt wrote may be replaced"
    assert out.stat().st_size > 10_000


def test_no_command_replaces_foreign_files_without_force(tmp_path, capsys):
    out = tmp_path / "rows"
    out.write_text("mine")
    for order in (["compare", "exact", "--out"], ["plan", "--out"], ["run", "--trace"], ["plant", "--trace"]):
        assert main([*order, str(out)]) == 2
        assert "--force" in capsys.readouterr().err
    pl.DataFrame({"own": [1.0]}).write_parquet(tmp_path / "own.parquet")
    for command in ("run", "plant"):
        assert main([command, "--trace", str(tmp_path / "own.parquet")]) == 2
        assert "--force" in capsys.readouterr().err
    assert pl.read_parquet(tmp_path / "own.parquet").columns == ["own"]
    with pytest.raises(ReportError, match="--force"):
        save_document(out, "page", "page")
    assert out.read_text() == "mine"
