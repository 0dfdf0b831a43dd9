"""The reference of a scenario's keys is the schema's, and the page is up to date."""

from pathlib import Path

from moc_opt.__main__ import main
from moc_opt.commands.reference import markdown, tables
from moc_opt.scenario import Scenario

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_is_up_to_date():
    page = (ROOT / "docs" / "scenario.md").read_text(encoding="utf-8")
    assert page == markdown(), "run: moc-opt keys --markdown > docs/scenario.md"


def test_a_default_of_the_page_is_that_of_the_scenario():
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


def test_the_command_prints_a_table_and_names_those_there_are(capsys):
    assert main(["keys", "control.supervisor"]) == 0
    assert "hold_ticks" in capsys.readouterr().out
    assert main(["keys", "control.supervisor", "--markdown"]) == 0
    part = capsys.readouterr().out
    assert part.startswith("## `[control.supervisor]`")
    assert part in markdown()
    assert part.count("## ") == 1
    assert main(["keys", "contrl"]) == 2
    assert "did you mean 'control'" in capsys.readouterr().err
