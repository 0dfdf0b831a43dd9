"""The map on a page: words that follow from the readings, one line for trajectories alike, and the command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from moc_opt import __main__ as command
from moc_opt.errors import ReportError
from moc_opt.report.map_page import (
    load_map,
)
from moc_opt.trace.trace import Trace


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
