"""The arms' benchmark: its figures follow from its rows, and what broke off or found no start is counted."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from benchmarks import robots
from benchmarks.common.output import default_config
from benchmarks.robots_study.page import answer
from benchmarks.robots_study.verdict import FINDINGS, JUDGED, summarise
from moc_opt.robots import available_robots
from tests import first_screens

TINY = """
robots = ["xarm7", "lwr4_rail"]
tasks = ["circle"]
starts = 1
solvers = ["exact"]
processes = 1
[scenario]
start = { pose = "random" }
duration_s = 1.0
bound_samples = 2
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("robots")
    (out / "tiny.toml").write_text(TINY, encoding="utf-8")
    assert robots.main([str(out / "tiny.toml"), "--out", str(out / "results"), "--seed", "3"]) == 0
    return out / "results"


def test_all_files_are_there_and_every_run_is_a_row(results: Path) -> None:
    first_screens.check((results / "report.html").read_text(encoding="utf-8"))
    rows = pq.read_table(results / "rows.parquet").to_pylist()
    told = [(row["robot"], row["controller"]) for row in rows]
    assert told == [("xarm7", "dcac"), ("xarm7", "exact"), ("lwr4_rail", "dcac"), ("lwr4_rail", "exact")]
    assert all(row["ended"] == "completed" for row in rows)
    summary = json.loads((results / "summary.json").read_text(encoding="utf-8"))
    for robot in ("xarm7", "lwr4_rail"):
        base, mine = (row for row in rows if row["robot"] == robot)
        gain = 100.0 * (mine["mu_mean"] / base["mu_mean"] - 1.0)
        assert summary["robots"][robot]["exact"]["mu_gain_percent"] == pytest.approx(gain)
        assert set(summary["findings"][robot]) == set(FINDINGS)
        assert ("freedoms" in mine["no_best_course"]) == (mine["mu_fraction_of_best"] is None) == (robot == "lwr4_rail")


def test_the_default_configuration_has_every_arm() -> None:
    config = robots.Config.load(default_config("robots"))
    assert sorted(config.robots) == available_robots()
    assert len(config.jobs()) == 6 * 3 * 5
    quick = config.quick()
    assert len(quick.jobs()) == 6 * 2
    starts = {(job.trial.robot.name, job.trial.seed) for job in config.jobs()}
    assert len({seed for _, seed in starts}) == len(starts) == 6 * 15  # every trial has a seed of its own


def row(robot: str, trial: str, controller: str, mu: float = 1.0, tip: float = 1.0, **more: Any) -> dict[str, Any]:
    about = {"robot": robot, "task": "circle", "trial": trial, "controller": controller, "ended": "completed"}
    figures = {"mu_mean": mu, "tip_error_mean_mm": tip, "settled_tip_error_mean_mm": tip,
               "settled_tip_error_registered_mean_mm": tip, "settled_rcm_error_mean_mm": 1.0,
               "settled_rcm_error_registered_mean_mm": 1.0, "trocar_force_mean_N": 1.0, "tip_error_model_mean_mm": 1.0,
               "settled_tip_error_model_mean_mm": 1.0, "settled_rcm_error_model_mean_mm": 1.0}  # fmt: skip
    return {**about, "whole": True, "error": "", **figures, **more}


def test_findings_follow_from_the_rows() -> None:
    rows = [row("a", f"t{k}", "dcac") for k in range(10)]
    rows += [row("a", f"t{k}", "exact", mu=1.2, tip=1.2 if k == 0 else 1.0) for k in range(10)]
    found = summarise(rows)
    assert found["robots"]["a"]["exact"]["mu_gain_percent"] == pytest.approx(20.0)
    assert found["robots"]["a"]["exact"]["tip_change_percent"] == pytest.approx(2.0)
    assert found["robots"]["a"]["exact"]["tip_much_worse"] == 1
    assert found["findings"]["a"] == dict.fromkeys(FINDINGS, True)
    rows[-1] = rows[-1] | {"tip_error_mean_mm": 1.2, "settled_tip_error_mean_mm": 1.6}
    worse = summarise(rows)["findings"]["a"]
    assert (worse["tails"], worse["tip"], worse["gains"]) == (False, False, True)
    assert (worse["tails_model"], worse["tip_model"], worse["rcm_model"]) == (True, True, True)
    for k in (-1, -2):
        rows[k] = rows[k] | {"tip_error_model_mean_mm": 1.2, "settled_rcm_error_model_mean_mm": 1.5}
    own = summarise(rows)["findings"]["a"]
    assert (own["tails_model"], own["tip_model"], own["rcm_model"], own["rcm"]) == (False, True, False, True)


def test_a_run_that_broke_off_is_counted_and_in_no_mean() -> None:
    rows = [row("a", "t0", "dcac"), row("a", "t0", "exact", mu=1.3), row("a", "t1", "dcac")]
    about = {"robot": "a", "task": "circle", "trial": "t1", "controller": "exact"}
    rows.append(about | {"ended": "stopped", "whole": False, "error": "RunAway: far off"})
    rows.append({"robot": "b", "task": "circle", "trial": "t0", "controller": "", "ended": "no start", "error": "none"})
    found = summarise(rows)
    assert found["robots"]["a"]["exact"]["broken"] == 1
    assert found["robots"]["a"]["exact"]["mu_gain_percent"] == pytest.approx(30.0)
    assert found["findings"]["a"]["all_end"] is False
    assert found["no_start"] == {"a": 0, "b": 1}
    assert found["findings"]["b"] == dict.fromkeys(FINDINGS)
    assert set(found["findings"]["a"].values()) == {False, None}, "of one trial only the end of a run is told"


def test_the_first_screen_says_what_holds_where() -> None:
    rows = [row(arm, f"t{k}", "dcac") for arm in "ab" for k in range(9)]
    rows += [row("a", f"t{k}", "exact", mu=1.2 + 0.002 * k) for k in range(9)]
    more = {"settled_rcm_error_registered_mean_mm": 2.1}
    rows += [row("b", f"t{k}", "exact", mu=1.05 + 0.002 * k, **more) for k in range(9)]
    first = answer(summarise(rows))
    assert "with `exact` over DCAC with the same gains [%], 9 random poses" in first.sentences[0]
    assert "a 20.8 [20" in first.sentences[0]
    assert FINDINGS["tip"] in first.sentences[1]
    assert FINDINGS["gains"] not in first.sentences[1]
    assert "each arm misses: a 0, b 2." in first.sentences[1]
    (a, b) = first.table.rows
    assert [(line["gains"].symbol, line["rcm"].symbol, line["rcm_model"].symbol) for line in (a, b)] == [
        ("✔", "✔", "✔"), ("✘", "✘", "✔")
    ]  # fmt: skip
    assert b["rcm"].word == "+110"
    assert "1 of 2 arms lie right of the goal" in first.pictures[0].says
    few = answer(summarise([one for one in rows if one["trial"] in ("t0", "t1")]))
    assert "a: too few trials to decide (2 of at least 8)" in few.sentences[1]
    assert {line[key].symbol for line in few.table.rows for key in JUDGED} == {"–"}


def test_arms_that_rank_solvers_alike_correlate() -> None:
    orders = {"a": (1.1, 1.2, 1.3), "b": (2.1, 2.2, 2.3), "c": (3.3, 3.2, 3.1)}
    rows = [row(robot, "t", "dcac") for robot in orders]
    rows += [row(r, "t", s, mu=m) for r, mus in orders.items() for s, m in zip(("x", "y", "z"), mus, strict=True)]
    rows += [row("d", "t", "dcac"), *[row("d", "t", s, mu=1.0 + k * 1e-6) for k, s in enumerate("xyz")]]
    ranking = summarise(rows)["ranking"]  # d tells none apart, and correlates with none
    assert ranking["order"]["a"] == ["z", "y", "x"]
    assert ranking["between"] == pytest.approx({"a, b": 1.0, "a, c": -1.0, "b, c": -1.0})
