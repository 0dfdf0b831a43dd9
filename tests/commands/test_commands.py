"""The commands of moc-opt, and the page of a scenario's keys."""

import json
import os
import subprocess
import sys
from pathlib import Path

import polars as pl
import pytest

import moc_opt as mo
from moc_opt.__main__ import main
from moc_opt.commands.parser import COMMANDS, work_of
from moc_opt.commands.reference import markdown, tables
from moc_opt.robots import available_robots
from moc_opt.scenario import Scenario
from moc_opt.tasks import CURVES
from moc_opt.trace.metrics import METRICS

PAGE = Path(__file__).resolve().parents[2] / "docs" / "scenario.md"


@pytest.mark.parametrize("command", [*COMMANDS, "robot"])
def test_every_command_has_help(command, capsys):
    assert callable(work_of(command))
    if command != "solvers":  # the study parses the options of `solvers`
        with pytest.raises(SystemExit) as ended:
            main([command, "--help"])
        assert ended.value.code == 0
        assert f"usage: moc-opt {command}" in capsys.readouterr().out


@pytest.mark.parametrize(("line", "goes_on"), [("ex", "export-c "), ("run --third-level pl", "planned ")])
def test_shell_completes_a_command_line(line, goes_on, tmp_path):
    asked = f"moc-opt {line}"
    shell = {"_ARGCOMPLETE": "1", "COMP_LINE": asked, "COMP_POINT": str(len(asked)),
             "_ARGCOMPLETE_STDOUT_FILENAME": str(tmp_path / "told")}  # fmt: skip
    subprocess.run([sys.executable, "-m", "moc_opt"], env=os.environ | shell, check=True)
    assert (tmp_path / "told").read_text() == goes_on


@pytest.mark.parametrize("arguments", [
    ("run", "a.toml", "--trace", "a.toml"), ("run", "a.toml", "--report", "a.toml"),
    ("report", "a.toml", "--out", "a.toml"), ("compare", "exact", "--scenario", "a.toml", "--out", "a.toml"),
    ("plan", "a.toml", "--out", "a.toml"), ("map", "x", "a.toml", "--out", "x/../a.toml"),
])  # fmt: skip
def test_input_file_is_not_overwritten(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text("duration_s = 0.02\n", encoding="utf-8")
    assert main(list(arguments)) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert (tmp_path / "a.toml").read_text(encoding="utf-8") == "duration_s = 0.02\n"
    assert [file.name for file in tmp_path.iterdir()] == ["a.toml"]


@pytest.mark.parametrize(("command", "name"), [
    (("run",), "a\0b"), (("report",), "x" * 300), (("replay",), "\ud800"), (("plan",), "."), (("robot", "new"), ""),
    (("compare", "exact"), "loop"),
])  # fmt: skip
def test_impossible_file_name_is_refused(command, name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop").symlink_to("loop")
    given = ["--scenario", name] if command[0] == "compare" else [name]
    out = [] if command[0] in ("run", "compare") else ["--out", "o.toml"]
    assert main([*command, *given, *out]) == 2
    said = capsys.readouterr().err
    assert (said.count("\n"), len(said) > 15) == (1, True)
    assert [file.name for file in tmp_path.iterdir()] == ["loop"]


@pytest.mark.parametrize("arguments", [["run", "--sede=3"], ["solvers", "--list", "--quick"], []])
def test_unknown_option_or_missing_command_is_refused(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    shown = capsys.readouterr().err
    assert (arguments or ["no command"])[-1] in shown
    assert ("did you mean --seed?" in shown) == ("--sede=3" in arguments)


def test_unwritable_output_gives_no_traceback():
    reader, writer = os.pipe()
    os.close(reader)  # as `| head` does once it has its lines
    with os.fdopen(writer, "wb") as closed, open("/dev/full", "wb") as full:
        ended = [subprocess.run([sys.executable, "-m", "moc_opt", "keys"], stdout=out, stderr=subprocess.PIPE)
                 for out in (closed, full)]  # fmt: skip
    assert (ended[0].returncode, ended[0].stderr) == (141, b"")
    assert (ended[1].returncode, ended[1].stderr.count(b"\n"), b"No space" in ended[1].stderr) == (2, 1, True)


@pytest.mark.parametrize(("command", "expected"), [
    (["robots"], available_robots), (["tasks"], lambda: [*CURVES, "waypoints"]), (["metrics"], lambda: METRICS),
    (["solvers", "--list"], mo.solvers.available),
])  # fmt: skip
def test_lists_of_names_are_complete(capsys, monkeypatch, command, expected):
    monkeypatch.setenv("COLUMNS", "400")  # so that no name is wrapped
    assert main([*command, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert set(expected()) <= set(rows)
    assert main(command) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in rows)
    if command == ["robots"]:
        assert {name: (row["joints"], row["real"], row["idle"]) for name, row in rows.items()} == {
            **dict.fromkeys(("lwr4", "iiwa14", "panda", "gen3", "xarm7"), (7, 1, 1)), "lwr4_rail": (8, 2, 1),
        }  # fmt: skip


def test_page_of_keys_is_up_to_date():
    assert PAGE.read_text(encoding="utf-8") == markdown(), "run: moc-opt keys --markdown > docs/scenario.md"
    for name, _, keys in tables():
        table = Scenario()
        for part in filter(None, name.split(".")):
            table = getattr(table, part)
        for key, _, default, _ in keys:
            value = getattr(table, key, None)  # `preset` is a key of the file, not a field
            if isinstance(value, float | int) and not isinstance(value, bool):
                assert float(default) == value, f"{name}.{key}"


def test_keys_command_prints_one_table(capsys):
    assert main(["keys", "control.supervisor"]) == 0
    assert "hold_ticks" in capsys.readouterr().out
    assert main(["keys", "control.supervisor", "--markdown"]) == 0
    part = capsys.readouterr().out
    assert part.startswith("## `[control.supervisor]`")
    assert part in markdown()
    assert part.count("## ") == 1
    assert main(["keys", "contrl"]) == 2
    assert "did you mean 'control'" in capsys.readouterr().err


def test_compare_command_writes_every_run(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    brief, rows = tmp_path / "brief.toml", tmp_path / "rows.csv"
    brief.write_text("duration_s = 0.02\nbound_samples = 0\n", encoding="utf-8")
    given = ["compare", "exact", "rnn", "--scenario", str(brief), "--trials", "2"]
    assert main([*given, "--out", str(rows)]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in ("dcac", "exact", "rnn", str(rows)))
    found = pl.read_csv(rows)
    assert found.select("seed", "solver").rows() == [(k, name) for k in (0, 1) for name in ("dcac", "exact", "rnn")]
    assert found["mu_mean"].min() > 0.0
    assert main([*given, "--seed", "3", "--json"]) == 0
    exact = json.loads(capsys.readouterr().out)["exact"]
    assert (exact["whole"], exact["mu_mean_low"] <= exact["mu_mean"] <= exact["mu_mean_high"]) == (2, True)


def test_comparison_reports_stopped_runs(tmp_path, capsys):
    file = tmp_path / "far.toml"
    file.write_text("bound_samples = 0\n[guard]\ntip_error_m = 1e-6\ntip_error_s = 0.004\n", encoding="utf-8")
    assert main(["compare", "exact", "--trials", "1", "--scenario", str(file)]) == 3
    assert "exact: no trial was completed; the first trial: stopped" in capsys.readouterr().err


def test_solvers_command_passes_its_arguments_to_the_study(monkeypatch):
    asked = []
    monkeypatch.setattr("moc_opt.study.solvers.main", lambda arguments: asked.append(arguments) or 7)
    assert main(["solvers", "--quick", "--out", "here", "--json"]) == 7
    assert asked == [["--quick", "--out", "here", "--json"]]
