"""The page of a run, from the command line."""

import shutil

import numpy as np
import pytest

from moc_opt.__main__ import main
from moc_opt.report.run_page import run_page
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
    two = [str(shutil.copy(tmp_path / "a.parquet", tmp_path / f"{name}.parquet")) for name in ("one", "other")]
    assert main(["report", *two, "--out", str(tmp_path / "both.html")]) == 0
    assert "one and other" in (tmp_path / "both.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("command", ["report", "replay", "map"])
def test_where_a_page_cannot_go_is_said_before_any_work(tmp_path, capsys, command):
    assert main([command, str(tmp_path / "no.parquet"), "--out", str(tmp_path)]) == 2
    assert "a folder, pipe or device is there" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    assert main([command, str(tmp_path / "no.parquet"), "--out", str(tmp_path / "file" / "x.html")]) == 2
    assert "cannot be written in the folder" in capsys.readouterr().err


def test_a_file_that_is_no_trace_is_named(tmp_path, capsys):
    (tmp_path / "a.parquet").write_text("hello")
    assert main(["report", str(tmp_path / "a.parquet"), "--out", str(tmp_path / "b.html")]) == 2
    assert "a.parquet" in capsys.readouterr().err


def test_a_trace_in_the_place_of_a_scenario_is_told_apart(tmp_path, capsys):
    Trace({"t_s": [0.0]}).save(tmp_path / "a.parquet")
    assert main(["run", str(tmp_path / "a.parquet")]) == 2
    assert "is a trace, no scenario: moc-opt report, replay or map shows it" in capsys.readouterr().err


def test_a_run_that_cannot_be_mapped_has_its_curves(robot):
    t = np.linspace(0.0, 1.0, 20)
    trace = Trace({"t_s": t, "mu": 0.1 + t}, {"ended": "stopped: too far off"})
    found = run_page({"own": trace}, {"own": {"mu_mean": 0.6}}, robot)
    assert set(found.figures) == {"curves"}
    html = found.html()
    assert "There is no map" in html
    assert "stopped: too far off" in html
