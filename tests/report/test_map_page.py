"""The map on a page: words that follow from the readings, one line for trajectories alike, and the command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from moc_opt import __main__ as command
from moc_opt.errors import ReportError
from moc_opt.redundancy.map_analysis import End, Reading
from moc_opt.report.map_page import (
    MOST_LINES,
    add_map,
    end_in_words,
    in_words,
    lines,
    load_map,
    trajectory_table,
)
from moc_opt.report.page import Page
from moc_opt.report.table_html import draw
from moc_opt.trace.trace import Trace
from tests.redundancy.test_map_analysis import hill, made, ramp

NAN = float("nan")


def reading(name: str, near: float, end: End, *, joint: int = 0, from_s: float = NAN, **more: Any) -> Reading:
    return Reading(name, near, 0.9, 0.1, from_s, end, joint, **{"at_edge": 0.0, "limits": (), **more})


def test_words_follow_from_the_readings() -> None:
    given = [
        reading("dcac", 0.0, End.STILL),
        reading("exact", 0.71, End.OPTIMUM, from_s=2.3),
        reading("rnn", 0.2, End.FEASIBLE_EDGE, joint=4),
    ]
    words = in_words(given, {"exact": "exact and 3 more"})
    assert "exact and 3 more for 71 % (from 2.3 s on for good); rnn for 20 %." in words
    assert "dcac never gets there: it rests in the end, though mu rises to one side (joint" in words
    assert "rnn ends at the edge of the feasible poses: mu rises beyond the limit of joint 4." in words
    two = in_words([reading("a", 1.0, End.OPTIMUM, from_s=0.0), reading("b", 1.0, End.OPTIMUM, from_s=0.0)])
    assert "a for 100 %; b for 100 %." in two
    assert two.endswith("a and b end at the optimum.")
    assert (
        in_words([reading("a", NAN, End.OTHER_BRANCH)])
        == "a is on another branch of the inverse kinematics: the map does not hold there."
    )


def test_what_touches_the_feasible_edge_is_said_to() -> None:
    touching = {"at_edge": 0.1, "limits": (2, 6)}
    words = in_words([reading("a", 0.5, End.STILL, **touching), reading("b", 0.5, End.STILL, **touching)])
    assert "a and b touch the feasible edge on its way" not in words
    assert "a and b touch the feasible edge on the way (joint 2 and joint 6)." in words
    alone = in_words([reading("a", 0.5, End.FEASIBLE_EDGE, joint=2, **touching)])
    assert "touch" not in alone, "its end says it already"


@pytest.mark.parametrize("end", list(End))
def test_every_end_has_words_for_one_and_for_several(end: End) -> None:
    one = reading("a", 0.5, end)
    assert " " in end_in_words(one)
    assert in_words([one, reading("b", 0.5, end)]).count("a and b ") == 1


def test_a_few_trajectories_are_all_drawn_and_spoken_of() -> None:
    found = made(hill(60.0, 0.3), {"a": 0.0, "b": 1.0, "c": ramp(0.0, 60.0), "d": 2.0})
    assert lines(found) == {name: name for name in "abcd"}
    page = Page("Map")
    assert [r.name for r in add_map(page, found, what="A trial")] == ["a", "b", "c", "d"]
    (figure,) = page.figures.values()
    dashes = {line.name: line.line.dash for line in figure.data if line.legendrank}
    assert dashes == {"a": "solid", "b": "9px,9px", "c": "solid", "d": "5px,13px"}, (
        "one line in three colours"
    )
    html = page.html()
    assert "a, b and d never get there: they rest" in html
    assert "21 by 120 poses" in html


def test_of_many_trajectories_one_of_each_kind_is_drawn() -> None:
    trajectories = {"s0": 0.0, "c": ramp(0.0, 60.0), **{f"s{k}": 0.1 * k for k in range(1, 9)}}
    found = made(hill(60.0, 0.3), trajectories)
    assert lines(found) == {"s0": "s0 and 8 more", "c": "c"}
    page = Page("Map")
    assert len(add_map(page, found)) == 10
    (figure,) = page.figures.values()
    assert {line.name: line.line.dash for line in figure.data if line.legendrank} == {
        "s0 and 8 more": "solid", "c": "solid",
    }  # fmt: skip
    assert "s0 stands for s1, s2, s3" in page.html(), "the table names those that are not drawn"
    assert "s0 and 8 more never get there: they rest" in page.html()
    apart = made(hill(60.0, 0.3), {str(k): 10.0 * k for k in range(12)})
    assert len(lines(apart)) == MOST_LINES
    page = Page("Many")
    add_map(page, apart)
    assert all(f">{k}<" in page.html() for k in range(12)), "the table has them all"


def test_the_table_says_what_is_missing_and_why() -> None:
    given = {"a": reading("a", 0.7, End.OPTIMUM, from_s=1.0), "b": reading("b", 0.1, End.FEASIBLE_EDGE, joint=2)}
    table = trajectory_table(given, {"a": [], "b": []})
    keys = [column.key for column in table.columns]
    assert table.caption == ""
    assert all(set(row) >= set(keys) for row in table.rows)
    assert [row["end"] for row in table.rows] == ["at the optimum", "at the edge of the feasible poses, joint 2"]
    assert "not there in the end" in str(draw(table, 1))


@pytest.fixture(scope="module")
def files(robot: object, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two saved runs of a quarter of a second, that stand still."""
    import moc_opt as mo

    trial = mo.Scenario(duration_s=0.1, judge=False, bound_samples=0)
    folder = tmp_path_factory.mktemp("runs")
    found = {"moc": trial, "dcac": trial.change(control={"law": "dcac"})}
    for name, scenario in found.items():
        mo.run(scenario).save(folder / f"{name}.parquet")
    return [folder / f"{name}.parquet" for name in found]


def test_saved_runs_become_a_page(files: list[Path]) -> None:
    page = load_map(files)
    assert page.subtitle == "moc and dcac"
    (figure,) = page.figures.values()
    assert figure.data
    with pytest.raises(ReportError, match="one robot with one tool"):
        load_map([])


def test_the_command_writes_the_page_and_the_figures(
    files: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "map.html"
    code = command.main(["map", *map(str, files), "--out", str(out), "--figures"])
    printed = capsys.readouterr()
    assert out.stat().st_size > 10_000, "the page is there, with or without a browser"
    if "BrowserMissingError" in printed.err:
        pytest.skip(printed.err)
    assert code == 0
    figures = [out.parent / "figures" / f"map.{kind}" for kind in ("svg", "pdf")]
    assert printed.out.split() == [str(file) for file in (out, *figures)]
    assert all(file.stat().st_size > 10_000 for file in figures)


def test_runs_that_cannot_be_shown_together_are_refused(
    files: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = Trace.load(files[0])
    moved = first.with_columns(tip_ref_m=first.tip_ref_m + np.array([0.0, 0.0, 0.01]))
    moved.save(tmp_path / "moved.parquet")
    assert (
        command.main(
            ["map", str(files[0]), str(tmp_path / "moved.parquet"), "--out", str(tmp_path / "m.html")]
        )
        == 2
    )
    assert "'moved' was given another path" in capsys.readouterr().err
    Trace(dict(first.columns), {**first.meta, "kind": "course"}).save(tmp_path / "course.parquet")
    assert command.main(["map", str(tmp_path / "course.parquet"), "--out", str(tmp_path / "m.html")]) == 2
    assert "'course' is a course, not a run" in capsys.readouterr().err
    assert not (tmp_path / "m.html").exists()
