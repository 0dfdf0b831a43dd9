"""The planning benchmark: all parts on the same trials, figures that follow from its rows, and an order among them."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from rich.console import Console

from benchmarks import plan
from benchmarks.common.output import default_config
from benchmarks.planning.first_screen import answer
from benchmarks.planning.goals import goal_rows
from benchmarks.planning.page import COMMANDS, PAGE, page_text
from benchmarks.planning.tables import summarise
from moc_opt.errors import MocOptError
from tests import first_screens

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
    expected = {"map": 1, "courses": 2, "loop": 4, "halving": 1, "closed_form": 1, "restarts": 1}
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
    summary = json.loads((results / "summary.json").read_text())
    rows = [{key: value for key, value in row.items() if value is not None} for row in rows_of(results)]
    again = json.loads(json.dumps(summarise(rows)))
    values = [row["from_start"] for row in rows if row["part"] == "courses"]
    assert summary["courses"]["lwr4"]["from_start"] == pytest.approx(sum(values) / 2)
    assert again["courses"]["lwr4"]["climb_gap_percent"] == summary["courses"]["lwr4"]["climb_gap_percent"]


def test_the_configuration_that_ships_is_the_default() -> None:
    shipped = plan.Config.load(default_config("plan"))
    assert shipped == plan.Config()
    assert len([job for job in shipped.jobs() if job.part == "courses"]) == 180
    assert not [job for job in shipped.jobs() if job.robot == "panda" and job.part in ("map", "closed_form")]
    assert len(plan.Config().quick().jobs()) == 12


def test_a_job_that_was_done_is_not_done_again(results: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    commit = json.loads((results / "environment.json").read_text())["commit"]
    (job,) = [job for job in plan.Config.load(results.parent / "tiny.toml").model_copy(update={"seed": 3}).jobs()
              if job.part == "map"]  # fmt: skip
    monkeypatch.setattr(plan, "run_job", lambda job: [{"done": "again"}])
    (kept,) = plan.kept_rows(results / "jobs", str(commit), job)
    assert kept["map_s"] in [row["map_s"] for row in rows_of(results) if row["part"] == "map"]
    assert plan.kept_rows(results / "jobs", "another commit", job) == [{"done": "again"}]


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
    rows = made({"local": [1.0, 22.0, 1.5, 8.0], "planned": [0.2, 0.3, 0.1, 0.2]})
    first = answer(summarise(rows), rows)
    assert "`planned` 0.20 [" in first.sentences[0]
    assert "(22.0 at worst, 4 runs)" in first.sentences[0]
    where = "arm circle/1 (22 %), arm circle/3 (8 %)"
    assert f"trapped (more than 5 % below) at 2 of 4 starts: {where}; elsewhere it leaves 1.25" in first.sentences[1]
    local, planned = first.table.rows
    assert (local["gap"].symbol, local["over"], planned["gap"].symbol, planned["over"]) == ("✘", 2, "✔", 0)
    assert (planned["tip"].symbol, planned["tip"].word, planned["rcm"].symbol) == ("✘", "+10.0", "✔")
    assert list(first.pictures[0].figure.data[0].y) == [22.0, 8.0, 1.5, 1.0]
    none = made({"local": [1.0, 2.0]})
    assert "at none of 2 starts" in answer(summarise(none), none).sentences[1]
    broken = [{**row, "error": "stopped"} for row in none]
    assert answer(summarise(broken), broken).sentences == ["No run came to its end: see the errors below."]


def test_the_report_opens_with_the_answer_and_folds_the_rest(results: Path) -> None:
    page = (results / "report.html").read_text(encoding="utf-8")
    places = [page.index(f'id="{name}"') for name in ("gaps", "rcm-cost", "in-the-loop", "courses-and-checks")]
    assert places == sorted(places)
    first_screens.check(page)
    rows = [row for row in rows_of(results) if row["part"] == "loop"]
    summary = json.loads((results / "summary.json").read_text(encoding="utf-8"))
    screen = Console(file=io.StringIO(), width=80, color_system=None)
    for part in answer(summary, rows).screens(80):
        screen.print(part, markup=False)
    assert max(map(len, screen.file.getvalue().splitlines())) <= 80
    assert all(word in screen.file.getvalue() for word in ("trapped", "planned", "RCM"))


def test_the_page_shows_runs_of_the_configurations_that_ship_alone(results: Path) -> None:
    summary, environment = (json.loads((results / f"{name}.json").read_text()) for name in ("summary", "environment"))
    whole, limits = (page_text(section, summary, environment) for section in COMMANDS)
    assert "`python -m benchmarks.plan --page` (seed 3; poses: lwr4 2; " in whole
    gap = summary["loops"]["lwr4"]["planned"]["gap_percent"]
    assert f"| planned: mean gap to the best course [%] | 0.5 | {gap:.3g}" in whole
    assert whole.count("| lwr4 | planned | 2 |") == limits.count("| lwr4 | planned | 2 |") == 1
    assert ("random starts" in whole, "random starts" in limits) == (True, False)
    text = PAGE.read_text(encoding="utf-8")
    for name in COMMANDS:
        assert plan.section_of(plan.Config.load(default_config(name))) == name
        assert f"<!-- {name} -->" in text
    tiny = plan.Config.load(results.parent / "tiny.toml")
    with pytest.raises(MocOptError, match=r"--page: the page shows runs of 'python -m benchmarks.plan --page' and"):
        plan.section_of(tiny)
    assert plan.main([str(results.parent / "tiny.toml"), "--out", str(results), "--page"]) == 2


def test_what_a_course_gives_up_is_told_apart_from_what_the_run_does(results: Path) -> None:
    rows = [row for row in rows_of(results) if row["part"] == "loop" and row["loop"] == "planned" and not row["error"]]
    found = json.loads((results / "summary.json").read_text())["loops"]["lwr4"]["planned"]
    assert rows
    for row in rows:
        assert -1e-6 < row["course_gap_percent"] < 50.0
        assert abs(row["gap_percent"] - row["course_gap_percent"]) < 10.0 or row["left_course_s"] is not None
    assert found["course_gap_percent"] == pytest.approx(sum(row["course_gap_percent"] for row in rows) / len(rows))
    assert found["left_course"] == sum(row.get("left_course_s") is not None for row in rows)


def test_a_wrong_configuration_exits_with_two(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.toml").write_text("poses = 0\n", encoding="utf-8")
    assert plan.main([str(tmp_path / "bad.toml")]) == 2
    assert "poses" in capsys.readouterr().err
