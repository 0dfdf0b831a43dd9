"""The lists name everything that a scenario may name."""

import json

import pytest

import moc_opt as mo
from moc_opt.__main__ import main
from moc_opt.robots import available_robots
from moc_opt.tasks import CURVES
from moc_opt.trace.metrics import METRICS


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        (["robots"], available_robots),
        (["tasks"], lambda: [*CURVES, "waypoints"]),
        (["metrics"], lambda: METRICS),
        (["solvers", "--list"], mo.solvers.available),
    ],
)
def test_a_list_has_every_name(capsys, monkeypatch, command, expected):
    monkeypatch.setenv("COLUMNS", "400")  # no name is broken
    assert main([*command, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(expected()) <= set(found)
    assert main(command) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in found)


def test_the_version_is_printed(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"moc-opt {mo.__version__}\n"


def test_an_unknown_option_is_refused_everywhere_but_in_the_study(capsys):
    with pytest.raises(SystemExit):
        main(["run", "--sede=3"])
    assert "unrecognized arguments: --sede=3" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["solvers", "--list", "--quick"])
    assert "--quick" in capsys.readouterr().err


def test_the_list_of_robots_says_what_each_is(capsys):
    main(["robots", "--json"])
    rows = json.loads(capsys.readouterr().out)
    assert {name: (row["joints"], row["real"], row["idle"]) for name, row in rows.items()} == {
        **dict.fromkeys(("lwr4", "iiwa14", "panda", "gen3", "xarm7"), (7, 1, 1)), "lwr4_rail": (8, 2, 1),
    }  # fmt: skip
    assert all(row["about"] for row in rows.values())
    assert "rail" in rows["lwr4_rail"]["about"]
