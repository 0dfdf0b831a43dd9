"""What the controller's end of a wire prints of a run."""

import json

import pytest

from moc_opt.__main__ import main
from moc_opt.realtime.answering import Ending
from moc_opt.realtime.link import Quality


@pytest.fixture
def ended(monkeypatch):
    """The run of a plant that nobody has to wait for."""
    found = Ending("stopped: pressed", 40, Quality(forged=3), {"missed": 2, "late": 0}, [], {"lied": {"count": 1}})
    monkeypatch.setattr("moc_opt.scenario.wired.answer", lambda *given, **more: found)


def test_a_table_says_whose_figures_they_are(ended, capsys):
    assert main(["control"]) == 3
    said = capsys.readouterr().out
    assert "Controller of circle" in said
    expected = {"ended": "stopped: pressed", "ticks": "40", "quality: forged": "3", "plant: missed": "2"}
    for what, value in expected.items():
        assert any(what in line and value in line for line in said.splitlines()), what
    assert "late" not in said  # nothing of that kind happened
    assert max(map(len, said.splitlines())) <= 80


def test_json_has_everything(ended, capsys):
    assert main(["control", "--json"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert (found["ticks"], found["quality"]["forged"], found["plant"]["late"]) == (40, 3, 0)
