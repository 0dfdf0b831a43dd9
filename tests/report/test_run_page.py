"""The page of a run, from the command line."""

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.__main__ import main
from moc_opt.errors import ReportError
from moc_opt.report.run_page import beside, run_page
from moc_opt.report.run_table import asked, run_table
from moc_opt.trace.metrics import METRICS
from moc_opt.trace.trace import Trace


def test_run_writes_the_page_with_its_baseline(tmp_path, capsys):
    file, page = tmp_path / "line.toml", tmp_path / "pages" / "line.html"
    file.write_text('duration_s = 0.4\nbound_samples = 3\n[task]\npath = "line"\n', encoding="utf-8")
    assert main(["run", str(file), "--report", str(page), "--trace", str(tmp_path / "a.parquet")]) == 0
    shown = capsys.readouterr()
    assert str(page) in shown.err
    text = page.read_text(encoding="utf-8")
    assert "<title>line" in text
    assert "DCAC, same gains" in text
    assert "mu_gain_percent" in text
    assert main(["report", str(tmp_path / "a.parquet"), "--out", str(tmp_path / "b.html")]) == 0
    assert "verified_solved" in (tmp_path / "b.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("command", ["report", "replay", "map"])
def test_where_a_page_cannot_go_is_said_before_any_work(tmp_path, capsys, command):
    assert main([command, str(tmp_path / "no.parquet"), "--out", str(tmp_path)]) == 2
    assert "a folder, pipe or device is there" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    assert main([command, str(tmp_path / "no.parquet"), "--out", str(tmp_path / "file" / "x.html")]) == 2
    assert "is no folder that may be written to" in capsys.readouterr().err


def test_a_file_that_is_no_trace_is_named(tmp_path, capsys):
    (tmp_path / "a.parquet").write_text("hello")
    assert main(["report", str(tmp_path / "a.parquet"), "--out", str(tmp_path / "b.html")]) == 2
    assert "a.parquet" in capsys.readouterr().err


def test_a_trace_in_the_place_of_a_scenario_is_told_apart(tmp_path, capsys):
    Trace({"t_s": [0.0]}).save(tmp_path / "a.parquet")
    assert main(["run", str(tmp_path / "a.parquet")]) == 2
    assert "is a trace, no scenario: moc-opt report, replay or map shows it" in capsys.readouterr().err


def test_without_a_run_there_is_no_page():
    with pytest.raises(ReportError, match="give one trace or more"):
        run_page({}, {}, mo.load_robot())


def test_a_run_that_cannot_be_mapped_has_its_curves(robot):
    t = np.linspace(0.0, 1.0, 20)
    trace = Trace({"t_s": t, "mu": 0.1 + t}, {"ended": "stopped: too far off"})
    found = run_page({"own": trace}, {"own": {"mu_mean": 0.6}}, robot)
    assert set(found.figures) == {"curves"}
    html = found.html()
    assert "There is no map" in html
    assert "stopped: too far off" in html


def test_the_run_comes_before_its_baseline_and_says_what_it_misses(robot):
    t = np.linspace(0.0, 1.0, 20)
    plain = Trace({"t_s": t, "mu": 0.1 + 0.0 * t}, {"ended": "completed"})
    own = Trace({"t_s": t, "mu": 0.2 + 0.0 * t, "mu_best_from_start": 0.25 + 0.0 * t}, {"ended": "completed"})
    html = run_page({"plain": plain, "own": own}, {"own": {"mu_mean": 0.2}}, robot).html()
    assert html.index("own completed.") < html.index("plain completed.")
    assert "Mean mu is 20.0 % below the best course from this start." in html
    assert html.count("below the best course") == 1


def _run(law="moc", ended="completed", ticks=2, solver="osqp"):
    scenario = {
        "seed": 5, "task": {"path": "line"}, "control": {"law": law, "gains": "tuned"}, "solver": {"name": solver},
    }  # fmt: skip
    about = {"ended": ended, "ticks": ticks, "ticks_planned": 2, "period_s": 0.1, "scenario": scenario}
    return Trace({"t_s": 0.1 * np.arange(ticks)}, about)


def test_two_runs_stand_side_by_side_with_what_each_figure_says():
    traces = {"a": _run(), "b": _run(ended="oscillated: joint_7", solver="daqp")}
    figures = {"a": {"mu_mean": 0.25, "mu_gain_percent": 7.0}, "b": {"mu_mean": 0.125}}
    (table,) = beside({n: run_table(n, traces[n], figures[n], explained=True) for n in traces}, traces)
    assert [column.title for column in table.columns] == ["metric", "a", "b", "what it says"]
    shown = [[cell.text for cell in table.cells(column)] for column in table.columns]
    assert shown[0] == ["ended", "mu_mean", "mu_gain_percent"]
    assert shown[1][1:] == ["0.2500", "7"]
    assert shown[2][0] == "oscillated: joint_7"
    assert shown[2][1:] == ["0.1250", "–"]
    assert shown[3][1:] == [METRICS[name].about.replace("m^3", "m³") for name in shown[0][1:]]


def test_a_part_stands_beside_no_whole_run():
    traces = {"a": _run(), "b": _run(ended="stopped: x", ticks=1)}
    tables = {name: run_table(name, trace, {"mu_mean": 0.25}, first=True) for name, trace in traces.items()}
    assert beside(tables, traces) == list(tables.values())


def test_what_was_run_is_said():
    assert asked(_run()) == "path line, solver osqp, gains tuned, seed 5"
    assert asked(_run("dcac")) == "path line, controller dcac, gains tuned, seed 5"
    assert asked(Trace({"t_s": [0.0]})) == ""
