"""A proposed place keeps its promise: a scenario begun there can be executed with the manipulability that was told."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.__main__ import main
from moc_opt.errors import ScenarioError, TaskError
from moc_opt.scenario.placement import MOVABLE, Movable, place
from moc_opt.scenario.planned import plan

ASKED = mo.Scenario(duration_s=2.0)


@pytest.mark.parametrize("what", MOVABLE)
def test_the_best_place_serves_better_and_keeps_its_promise(what: Movable) -> None:
    places = place(ASKED, what, box_m=0.08, candidates=12, best=2)
    values = [found.course.mu_mean for found in places if found.course is not None]
    assert len(places) == 3
    assert values == sorted(values, reverse=True)
    first, (here,) = places[0], [found for found in places if not any(found.shift_m)]
    assert first.course is not None
    assert here.course is not None
    assert first.course.mu_mean > here.course.mu_mean
    assert np.abs(first.shift_m).max() <= 0.08
    moved = ASKED.change(**first.changes())
    again = plan(moved, refined=False)
    assert again.executable
    assert again.from_start is not None
    assert again.from_start.mu_mean == pytest.approx(first.course.mu_mean, rel=2e-3)
    # The trocar of that scenario is where the search had it, seen from the arm's own base.
    before, after = mo.Scenario(duration_s=2.0), moved
    entries = [_entry(scenario) for scenario in (before, after)]
    shift = np.array(first.shift_m) * (1.0 if what == "trocar" else -1.0)
    np.testing.assert_allclose(entries[1] - entries[0], shift, atol=1e-8)


def _entry(scenario: mo.Scenario) -> np.ndarray:
    from moc_opt.scenario import Setup

    found: np.ndarray = np.asarray(Setup(scenario.change(start={"check_path": False})).registered.at(0.0)[0])
    return found


def test_the_search_is_seeded_and_plans_what_it_is_asked_for() -> None:
    one, two, other = (place(ASKED, "base", candidates=4, best=1, seed=seed) for seed in (1, 1, 2))
    assert [p.shift_m for p in one] == [p.shift_m for p in two] != [p.shift_m for p in other]
    away = place(ASKED, "base", candidates=2, best=1, margin_rad=1.0)
    assert away[-1].course is None
    with pytest.raises(ScenarioError, match="cannot be executed there"):
        away[-1].changes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"what": "table"}, "place = 'table'"), ({"box_m": 0.0}, "box_m = 0.0"), ({"box_m": "a"}, "box_m = 'a'"),
        ({"candidates": 0}, "candidates = 0"), ({"candidates": 2.5}, "candidates = 2.5"),
        ({"candidates": True}, "candidates = True"), ({"box_m": True}, "box_m = True"), ({"seed": -1}, "seed = -1"),
        ({"objective": "x"}, "objective = 'x'"), ({"margin_rad": -1.0}, "margin_rad = -1.0"),
        ({"margin_m": "x"}, "margin_m = 'x'"), ({"speed_share": -1.0}, "speed_share = -1.0"),
        ({"shaft_margin": -1.0}, "shaft_margin = -1.0"),
    ],
)  # fmt: skip
def test_bad_arguments_are_named(change: dict[str, object], message: str) -> None:
    with pytest.raises((ScenarioError, TaskError), match=message):
        place(ASKED, **{"what": "base", **change})  # type: ignore[arg-type]


def test_the_command_prints_the_places(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "short.toml").write_text("duration_s = 1.0\n", encoding="utf-8")
    asked = ["plan", str(tmp_path / "short.toml"), "--place", "trocar", "--candidates", "3", "--box", "0.03"]
    assert main(asked) == 0
    printed = capsys.readouterr().out
    assert "3 places drawn from a cube of +-30 mm" in " ".join(printed.split())
    assert "(as it is)" in printed
    assert main([*asked, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {"shift_mm", "depth_m", "mu_mean", "q_rad"} <= set(told["places"][0])
