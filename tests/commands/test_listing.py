"""The lists name everything that a scenario may name, and the reference of its keys is the schema's."""

import json
from pathlib import Path

import pytest

import moc_opt as mo
from moc_opt.__main__ import main
from moc_opt.commands.reference import markdown, tables
from moc_opt.robots import available_robots
from moc_opt.scenario import Scenario
from moc_opt.tasks import CURVES
from moc_opt.trace.metrics import METRICS

PAGE = Path(__file__).resolve().parents[2] / "docs" / "scenario.md"


@pytest.mark.parametrize(("command", "expected"), [
    (["robots"], available_robots), (["tasks"], lambda: [*CURVES, "waypoints"]), (["metrics"], lambda: METRICS),
    (["solvers", "--list"], mo.solvers.available),
])  # fmt: skip
def test_a_list_has_every_name(capsys, monkeypatch, command, expected):
    monkeypatch.setenv("COLUMNS", "400")  # no name is broken
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
        assert all(row["about"] for row in rows.values())


def test_the_page_of_keys_is_up_to_date_and_its_defaults_are_those_of_the_scenario():
    assert PAGE.read_text(encoding="utf-8") == markdown(), "run: moc-opt keys --markdown > docs/scenario.md"
    scenario = Scenario()
    for name, _, keys in tables():
        table = scenario
        for part in filter(None, name.split(".")):
            table = getattr(table, part)
        for key in keys:
            if key.name == "preset":
                continue  # of a file alone
            value = getattr(table, key.name)
            if isinstance(value, float | int) and not isinstance(value, bool):
                assert float(key.default) == value, f"{name}.{key.name}"


def test_the_command_prints_a_table_of_keys_and_names_those_there_are(capsys):
    assert main(["keys", "control.supervisor"]) == 0
    assert "hold_ticks" in capsys.readouterr().out
    assert main(["keys", "control.supervisor", "--markdown"]) == 0
    part = capsys.readouterr().out
    assert part.startswith("## `[control.supervisor]`")
    assert part in markdown()
    assert part.count("## ") == 1
    assert main(["keys", "contrl"]) == 2
    assert "did you mean 'control'" in capsys.readouterr().err
