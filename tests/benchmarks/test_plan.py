"""The planning benchmark: all parts on the same trials, figures that follow from its rows, and an order among them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from benchmarks import plan
from benchmarks.common.output import default_config
from benchmarks.planning.page import COMMANDS, PAGE, answer, page_text
from benchmarks.planning.verdict import goal_rows, summarise
from tests import first_screens
from tests.study import work

TINY = """
robots = ["lwr4"]
tasks = ["circle"]
poses = 2
processes = 1
map_points = 1
random_starts = 10
restart_poses = 1
restarts = 2
halvings = 1
[loops]
local = { third_level = "local" }
planned = { third_level = "planned" }
[scenario]
start = { pose = "random" }
duration_s = 2.0
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("plan")
    (out / "tiny.toml").write_text(TINY, encoding="utf-8")
    assert plan.main([str(out / "tiny.toml"), "--out", str(out / "results"), "--seed", "3"]) == 0
    return out / "results"


def rows_of(folder: Path) -> list[dict[str, Any]]:
    return pq.read_table(folder / "rows.parquet").to_pylist()


def test_all_files_are_there_and_every_part_has_its_rows(results: Path) -> None:
    assert {"summary.json", "rows.parquet", "environment.json", "report.html"} <= {f.name for f in results.iterdir()}
    rows = rows_of(results)
    parts = [row["part"] for row in rows]
    expected = {"courses": 2, "loop": 4, "halving": 1, "closed_form": 1, "restarts": 1}
    assert {part: parts.count(part) for part in parts} == expected
    assert not any(row["error"] for row in rows if row["part"] != "loop")
    assert sum(not row["error"] for row in rows if row["part"] == "loop") >= 3


def test_courses_are_in_order_and_nothing_beats_map_plan_or_bound(results: Path) -> None:
    for row in rows_of(results):
        if row["part"] == "courses":
            assert row["climbed"] <= row["from_start"] <= row["bound_from_start"]
            assert row["from_start"] <= row["best"] <= row["bound"]
            assert row["violation"] < 1e-8
        if row["part"] == "halving":
            assert abs(row["halving_percent"]) < 0.5
        if row["part"] == "loop" and not row["error"]:
            (course,) = [r for r in rows_of(results) if r["part"] == "courses" and r["trial"] == row["trial"]]
            assert row["gap_percent"] == pytest.approx(100.0 * (1.0 - row["mu"] / course["from_start"]))
            assert -0.5 < row["gap_percent"] < 50.0
        if row["part"] == "closed_form":
            assert row["placed"] > 0
            assert row["above_map"] < 1e-6
        if row["part"] == "restarts":
            assert row["restarts"] > 0
            assert row["above_own_percent"] < 1e-3


def test_the_summary_follows_from_the_rows(results: Path) -> None:
    summary, rows = json.loads((results / "summary.json").read_text()), rows_of(results)
    values = [row["from_start"] for row in rows if row["part"] == "courses"]
    assert summary["courses"]["lwr4"]["from_start"] == pytest.approx(sum(values) / 2)
    runs = [row for row in rows if row["part"] == "loop" and row["loop"] == "planned" and not row["error"]]
    found = summary["loops"]["lwr4"]["planned"]
    for row in runs:  # what a course gives up is told apart from what the run does
        assert -1e-6 < row["course_gap_percent"] < 50.0
        assert abs(row["gap_percent"] - row["course_gap_percent"]) < 10.0 or row["left_course_s"] is not None
    assert found["course_gap_percent"] == pytest.approx(sum(row["course_gap_percent"] for row in runs) / len(runs))
    assert found["left_course"] == sum(row.get("left_course_s") is not None for row in runs)


def test_the_configuration_that_ships_is_the_default() -> None:
    shipped = plan.Config.load(default_config("plan"))
    assert shipped == plan.Config()
    assert len([job for job in shipped.jobs() if job.part == "courses"]) == 180
    assert not [job for job in shipped.jobs() if job.robot == "panda" and job.part in ("closed_form", "restarts")]
    assert len(plan.Config().quick().jobs()) == 10


def test_a_trial_whose_process_dies_is_a_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "tiny.toml").write_text(TINY, encoding="utf-8")
    monkeypatch.setattr(plan, "run_job", work.die_of)
    assert plan.main([str(tmp_path / "tiny.toml"), "--out", str(tmp_path / "results")]) == 0
    rows = rows_of(tmp_path / "results")
    assert rows
    assert all("SIGSEGV" in row["error"] and row["trial"] for row in rows)


@pytest.mark.parametrize(
    ("gap", "verdict"),
    [((0.3, 0.2, 0.45), "met"), ((0.45, 0.3, 0.6), "open"), ((0.9, 0.6, 1.2), "missed"), (None, "not measured")],
)
def test_a_goal_is_judged_by_the_end_of_its_interval(gap: tuple[float, float, float] | None, verdict: str) -> None:
    value = {} if gap is None else dict(zip(("gap_percent", "gap_percent_low", "gap_percent_high"), gap, strict=True))
    summary = {"courses": {"arm": {}}, "loops": {"arm": {"planned": value}}, "closed_form": {}}
    (row,) = [row for row in goal_rows(summary) if row["goal"].startswith("planned: mean gap")]
    assert row["verdict"] == verdict
    assert {row["verdict"] for row in goal_rows(summary) if row is not None} <= {verdict, "not measured"}


def made(gaps: dict[str, list[float]]) -> list[dict[str, Any]]:
    about = {"robot": "arm", "task": "circle", "error": "", "part": "loop", "fraction_of_best": 0.9, "mu": 0.2,
             "solve_p99_us": None, "rcm_error_model_mean_mm": 0.2}  # fmt: skip
    return [
        {**about, "loop": loop, "trial": f"circle/{k}", "gap_percent": gap,
         "tip_error_model_mean_mm": 0.1 if loop == "local" else 0.11}
        for loop, values in gaps.items() for k, gap in enumerate(values)
    ]  # fmt: skip


def test_the_first_screen_says_where_the_local_law_is_trapped_and_by_how_much() -> None:
    rows = made({"local": [3.0, 22.0, 3.5, 8.0] * 2, "planned": [0.2, 0.3, 0.1, 0.2] * 2})
    first = answer(summarise(rows), rows)
    assert "`planned` 0.20 [" in first.sentences[0]
    assert "(22.0 at worst, 8 runs)" in first.sentences[0]
    where = "arm circle/1 (22 %), arm circle/5 (22 %), arm circle/3 (8 %), arm circle/7 (8 %)"
    assert f"at 4 of 8 starts: the worst are {where}; elsewhere it leaves 3.25 [" in first.sentences[1]
    local, planned = first.table.rows
    assert (local["gap"].symbol, local["gap_over_5"]) == ("–", 4)
    assert (planned["gap"].symbol, planned["gap_over_5"]) == ("✔", 0)
    assert (planned["tip"].symbol, planned["tip"].word, planned["rcm"].symbol) == ("✘", "+10.0", "✔")
    assert list(first.pictures[0].figure.data[0].y) == [22.0, 22.0, 8.0, 8.0, 3.5, 3.5, 3.0, 3.0]
    broken = [{**row, "error": "stopped"} for row in rows]
    assert len(answer(summarise(broken), broken).sentences) == 1


def test_the_report_opens_with_the_answer_and_folds_the_rest(results: Path) -> None:
    first_screens.check((results / "report.html").read_text(encoding="utf-8"), pictures=1)


def test_the_page_shows_runs_of_the_configurations_that_ship_alone(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary, environment = (json.loads((results / f"{name}.json").read_text()) for name in ("summary", "environment"))
    whole, limits = (page_text(section, summary, environment) for section in COMMANDS)
    gap = summary["loops"]["lwr4"]["planned"]["gap_percent"]
    assert f"| planned: mean gap to the best course [%] | 0.5 | {gap:.3g}" in whole
    assert whole.count("| lwr4 | planned | 2 |") == limits.count("| lwr4 | planned | 2 |") == 1
    assert ("random starts" in whole, "random starts" in limits) == (True, False)
    text = PAGE.read_text(encoding="utf-8")
    for name in COMMANDS:
        assert plan.section_of(plan.Config.load(default_config(name))) == name
        assert f"<!-- {name} -->" in text
    assert plan.main([str(results.parent / "tiny.toml"), "--out", str(results), "--page"]) == 2
    assert "--page: the page shows runs of" in capsys.readouterr().err
