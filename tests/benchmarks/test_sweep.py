from argparse import Namespace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import moc_opt as mo
from benchmarks import sweep
from benchmarks.sweep import Config, plan, random_draws
from moc_opt.errors import MocOptError
from moc_opt.study.command import Study
from moc_opt.study.results import Results
from moc_opt.study.trials import Trial, variant

TINY = {"duration_s": 0.05, "judge": False, "bound_samples": 0}
GRID = {"control.regularization": [1e-6, 1e-5, 1e-4], "plant.mass_error": [0.0, 0.1]}


def config(**changes: Any) -> Config:
    return Config(**{"grid": GRID, "seeds": 2, "solvers": ["exact"], "scenario": TINY, **changes})


@pytest.mark.parametrize(("changes", "message"), [
    ({"grid": {"seed": [1]}}, "give 'seeds'"), ({"grid": {"control.regularization": 1e-5}}, "give a list of values"),
    ({"grid": {"control.k0_per_sec": [1.0]}}, "did you mean 'k0_per_s'"),
    ({"grid": {"plant.mass_error": [0.1, 2.0]}}, "mass_error = 2.0: not a scenario"),
    ({"grid": {"solver.settings.epss": [1e-6]}, "solvers": ["osqp"]}, "did you mean 'eps'"),
    ({"grid": {p: [i / 1e4 for i in range(4000)] for p in ("control.c0", "control.c1")}}, "into several"),
    ({"random": {"fields": {"plant.mass_error": {"low": 0.2, "high": 0.1}}}}, "give low < high"),
    ({"random": {"fields": {"plant.delay_ticks": {"low": 0.2, "high": 0.8, "scale": "integer"}}}}, "whole number"),
    ({"random": {"fields": {"plant.mass_error": {"low": 0.1, "high": 0.2}}}}, r"\[grid\] and in \[random"),
    ({"seeds": []}, "0 runs"), *(({"settings": {"osqp": {}}, "solvers": s}, "in .settings") for s in (["exact"], None)),
    ({"grid": {"control.law": ["dcac"]}}, "no solver 'exact'"), ({"grid": {"solver": [{"name": "osqp"}]}}, "'solvers'"),
    ({"scenario": {"solver": {"name": "rnn"}}}, r"\[scenario.solver\]"),
    ({"random": {"fields": {"solver": {"choice": [{"name": "osqp"}]}}}}, "'solvers'"),
])  # fmt: skip
def test_wrong_sweep_is_refused_before_any_run(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(MocOptError, match=message):
        plan(config(**changes))


@given(st.integers(0, 2**32), st.integers(1, 40), st.floats(1e-9, 1e3), st.floats(1.01, 1e6))
@settings(max_examples=60)
def test_draws_stay_in_range_and_more_samples_keep_the_first(seed: int, samples: int, low: float, ratio: float) -> None:
    """The first draws do not depend on the number of samples."""
    fields: dict[str, Any] = {
        "control.regularization": {"low": low, "high": low * ratio, "scale": "log"},
        "plant.friction": {"low": -low, "high": low * ratio},
        "plant.delay_ticks": {"low": 0, "high": 5, "scale": "integer"}, "task.path": {"choice": ["circle", "spiral"]},
    }
    drawn = random_draws(fields, samples, seed)
    assert all(low <= v <= low * ratio for v in drawn["control.regularization"])
    assert all(-low <= v <= low * ratio for v in drawn["plant.friction"])
    assert set(drawn["plant.delay_ticks"]) <= set(range(6))
    assert all(isinstance(v, int) for v in drawn["plant.delay_ticks"])
    longer = random_draws({"control": {"regularization": fields["control.regularization"]}}, samples + 3, seed)
    assert longer["control.regularization"][:samples] == drawn["control.regularization"]


def test_plan_lists_every_combination_in_a_fixed_order() -> None:
    runs = plan(config(solvers=["exact", "osqp"]))
    assert len(runs) == 24
    assert [run.controller for run in runs[:3]] == ["exact", "osqp", "exact"]
    assert [run.case.seed for run in runs[:5]] == [0, 0, 1, 1, 0]
    last = runs[-1].case
    assert (last.control.regularization, last.plant.mass_error, last.seed) == (1e-4, 0.1, 1)
    assert (runs[-1].controller, last.duration_s) == ("osqp", 0.05)


def test_equal_runs_are_planned_once() -> None:
    axes = {"solver.settings.eps": [1e-6, 1e-8], "control.k0_per_s": [1.0, 2.0]}
    runs = plan(config(solvers=["dcac", "osqp"], grid=axes, seeds=1))
    assert len(runs) == 6  # not 8, because DCAC uses no solver
    assert ["solver.settings.eps" in run.tags for run in runs if run.controller == "dcac"] == [False, False]
    assert runs[1].settings == {"eps": 1e-6}
    drawn = {"samples": 50, "fields": {"task.path": {"choice": ["circle", "spiral"]}}}
    assert len(plan(config(random=drawn, grid={}, seeds=1))) == 2
    given = config(grid={"robot": [{}]}, random={"fields": {"robot.tool_length_m": {"low": 0.2, "high": 0.3}}})
    assert [run.tags["robot"] for run in plan(given)] == ["{}"] * 2
    assert given.grid == {"robot": [{}]}, "drawn values do not change the grid"


def test_solver_of_the_scenario_runs_if_no_solvers_are_listed() -> None:
    own = {**TINY, "solver": {"name": "osqp", "settings": {"eps": 1e-7}}, "control": {"law": "moc"}}
    (run,) = plan(Config(scenario=own, seeds=1))
    assert (run.controller, run.settings) == ("osqp", {"eps": 1e-7})
    (dcac,) = plan(Config(scenario={**TINY, "control": {"law": "dcac"}}))
    kept = variant(dcac.case, dcac.controller).control
    assert (dcac.controller, kept.law, kept.gains) == ("dcac", "dcac", "default")


def test_means_of_a_group_leave_out_stopped_and_failed_runs() -> None:
    rows = Results(
        {"controller": name, "ended": ended, "whole": whole, "error": None if whole else ended, "mu_mean": mu}
        for name, ended, whole, mu in [
            ("a", "completed", True, 1.0), ("a", "completed", True, 3.0), ("a", "stopped: force", False, 9.0),
            ("a", "failed", False, None), ("b", "oscillated", True, 5.0),
        ]
    )  # fmt: skip
    found = sweep.grouped(rows)
    assert [found["a"][word] for word in ("runs", "failed", "oscillated")] == [4, 2, 0]
    assert [found["a"][f"mu_mean{end}"] for end in ("", "_p05", "_p95")] == pytest.approx([2.0, 1.1, 2.9])
    assert (found["b"]["mu_mean"], found["b"]["oscillated"]) == (5.0, 1)


SMALL = """
seeds = 1
solvers = ["dcac", "exact"]
timed = true
grid.control.regularization = [1e-6, 1e-4]
scenario = { duration_s = 0.05, judge = false, bound_samples = 0 }
"""


def test_times_are_reported_only_if_runs_are_timed(tiny: Any) -> None:
    timed, untimed = (tiny(sweep, SMALL.replace("timed = true", asked)) for asked in ("timed = true", ""))
    assert min(row["tick_p50_us"] for row in timed.rows) > 0.0
    assert [row["mu_mean"] for row in untimed.rows] == [row["mu_mean"] for row in timed.rows]
    assert not [name for name in untimed.rows[0] if name.endswith("_us")]
    assert (untimed.summary["all"]["exact"]["runs"], untimed.summary["all"]["exact"]["failed"]) == (2, 0)
    assert untimed.summary["by control.regularization"]["exact, 0.0001"]["runs"] == 1


def test_caption_explains_the_mark_of_a_solver_whose_answers_were_replaced() -> None:
    row = {"controller": "a", "ended": "completed", "error": None, "whole": True, "asked": 9, "faults": 9}
    rows = Results([row, {**row, "controller": "b", "faults": 0}])
    table = sweep.report({"all": sweep.grouped(rows)}, rows, {}, config()).table
    assert [getattr(shown["group"], "symbol", "") for shown in table.rows] == ["!", ""]
    assert table.caption.startswith("!: The supervisor replaced 100 % of the answers of a, so the means say little")


def test_a_failed_run_is_tried_again(tmp_path: Path) -> None:
    lost = [Trial(mo.Scenario(robot={"name": str(tmp_path / "no.toml")}), "exact")]
    for _ in range(2):
        study = Study("sweep", tmp_path, Namespace())
        assert ([run.row["ended"] for run in study.trials(lost)], study.kept.reused) == (["failed"], 0)
