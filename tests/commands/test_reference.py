"""The reference of a scenario's keys is the schema's, and the page is up to date."""

from pathlib import Path

import pytest

from moc_opt.__main__ import main
from moc_opt.commands.reference import markdown, tables, unit
from moc_opt.scenario import Scenario

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_is_up_to_date():
    page = (ROOT / "docs" / "scenario.md").read_text(encoding="utf-8")
    assert page == markdown(), "run: moc-opt keys --markdown > docs/scenario.md"


def test_every_key_says_what_it_means():
    found = {f"{name}.{key.name}".lstrip("."): key for name, _, keys in tables() for key in keys}
    assert [name for name, key in found.items() if not key.meaning] == []
    assert len(found) > 140
    assert found["control.supervisor.check"].kind == "flag"
    assert found["task.waypoints_m"].kind == "list of lists of 3 numbers"


def test_a_default_of_the_page_is_that_of_the_scenario():
    scenario = Scenario()
    for name, _, keys in tables():
        table = scenario
        for part in filter(None, name.split(".")):
            table = getattr(table, part)
        for key in keys:
            value = getattr(table, key.name)
            if isinstance(value, float | int) and not isinstance(value, bool):
                assert float(key.default) == value, f"{name}.{key.name}"


@pytest.mark.parametrize(
    ("name", "meaning", "expected"),
    [
        ("depth_m", "", "m"), ("v_max_m_per_s", "", "m/s"), ("a_max_m_per_s2", "", "m/s^2"), ("k0_per_s", "", "1/s"),
        ("wall_damping_Nm_s_per_rad", "", "Nm s/rad"), ("trocar_damping_Ns_per_m", "", "N s/m"),
        ("K_X", "tip stiffness [N/m]", "N/m"), ("K_N", "wrist stiffness [N/m]", "N/m"), ("seed", "of all", "1"),
        ("deadline_us", "", "us"), ("delay_ticks", "", "1"), ("normal", "", "1"),
    ],
)  # fmt: skip
def test_units_are_read_off_the_names(name, meaning, expected):
    assert unit(name, meaning) == expected


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
