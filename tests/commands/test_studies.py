"""moc-opt compare, and the study behind moc-opt solvers."""

import csv
import json

import pytest

from moc_opt.__main__ import main


@pytest.fixture
def brief(tmp_path):
    file = tmp_path / "brief.toml"
    file.write_text("duration_s = 0.02\nbound_samples = 0\n", encoding="utf-8")
    return str(file)


def test_compare_prints_every_solver_and_writes_every_run(capsys, brief, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    rows = tmp_path / "rows.csv"
    assert main(["compare", "exact", "rnn", "--scenario", brief, "--trials", "2", "--out", str(rows)]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in ("dcac", "exact", "rnn"))
    with rows.open(encoding="utf-8") as file:
        found = list(csv.DictReader(file))
    assert [(row["solver"], row["seed"]) for row in found] == [
        (name, seed) for seed in "01" for name in ("dcac", "exact", "rnn")
    ]
    assert all(float(row["mu_mean"]) > 0.0 for row in found)


def test_compare_prints_json_with_intervals(capsys, brief):
    assert main(["compare", "exact", "--scenario", brief, "--trials", "2", "--seed", "3", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["exact"]["trials"] == 2
    assert found["exact"]["mu_mean"]["samples"] == 2
    assert found["exact"]["mu_mean"]["low"] <= found["exact"]["mu_mean"]["value"]


def test_the_study_gets_its_own_arguments(monkeypatch):
    asked = []
    monkeypatch.setattr("moc_opt.study.solvers.main", lambda arguments: asked.append(arguments) or 7)
    assert main(["solvers", "--quick", "--out", "here", "--json"]) == 7
    assert asked == [["--quick", "--out", "here", "--json"]]


def test_a_comparison_that_no_run_survives_says_so(tmp_path, capsys):
    file = tmp_path / "far.toml"
    file.write_text("bound_samples = 0\n[guard]\ntip_error_m = 1e-6\ntip_error_s = 0.004\n", encoding="utf-8")
    assert main(["compare", "exact", "--trials", "1", "--scenario", str(file)]) == 3
    said = capsys.readouterr().err
    assert "exact: no trial came to its end; the first was stopped" in said
