"""Sweeps: which runs a configuration makes, and what the command leaves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import sweep
from benchmarks.common.output import default_config
from benchmarks.sweeps.config import Config
from benchmarks.sweeps.fields import check_path, paths, random_draws
from benchmarks.sweeps.plan import plan
from moc_opt.errors import MocOptError, SolverError, UnknownNameError
from tests import first_screens

TINY = {"duration_s": 0.05, "judge": False, "bound_samples": 0}
GRID = {"control.regularization": [1e-6, 1e-5, 1e-4], "plant.mass_error": [0.0, 0.1]}


def config(**changes: Any) -> Config:
    """12 runs: 3 x 2 x 2 seeds."""
    return Config(**{"grid": GRID, "seeds": 2, "solvers": ["exact"], "scenario": TINY, **changes})


def test_every_field_of_a_scenario_has_a_path() -> None:
    known = dict(paths())
    assert {"duration_s", "control.k0_per_s", "plant.mass_error", "task.path", "start.swivel"} <= known.keys()
    assert known["solver.settings"]
    assert not known["control.k0_per_s"]
    assert "control" not in known
    check_path("solver.settings.eps")
    check_path("task.sizes.radius")


@pytest.mark.parametrize(
    ("path", "nearest"),
    [("control.k0_per_sec", "control.k0_per_s"), ("plant.mas_error", "plant.mass_error"), ("mass_error", "plant.mass"),
     ("solver.setings.eps", "solver.settings")],
)  # fmt: skip
def test_unknown_field_is_refused_with_the_nearest_names(path: str, nearest: str, tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=f"did you mean.*{nearest}"):
        plan(config(grid={path: [1.0]}))
    file = tmp_path / "sweep.toml"
    file.write_text(f'[grid]\n"{path}" = [1.0]\n')
    assert sweep.main([str(file), "--out", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"grid": {"seed": [1]}}, "give 'seeds'"),
        ({"grid": {"solver.name": ["osqp"]}}, "give 'solvers'"),
        ({"grid": {"control.regularization": 1e-5}}, "give a list of values"),
        ({"grid": {"control.regularization": [1e-5, 1e-5]}}, "given twice"),
        ({"grid": {"control": {"regularization": [1.0]}, "control.regularization": [2.0]}}, "given twice"),
        ({"grid": {"plant.mass_error": [0.1, 2.0]}}, "mass_error = 2.0: not a scenario"),
        ({"grid": {"task.sizes.radius": [float("nan")]}}, r"radius\[0\] = nan"),
        ({"random": {"fields": {"plant.mass_error": {"low": 0.2, "high": 0.1}}}}, "not below"),
        ({"random": {"fields": {"plant.friction": {"low": 0.0, "high": 0.1, "scale": "log"}}}}, "begins above 0"),
        ({"random": {"fields": {"plant.delay_ticks": {"low": 0.2, "high": 0.8, "scale": "integer"}}}}, "whole number"),
        ({"random": {"fields": {"plant.friction": 3.0}}}, "choice"),
        ({"random": {"fields": {"plant.mass_error": {"low": 0.1, "high": 0.2}}}}, r"\[grid\] and in \[random"),
        ({"seeds": [1, 1]}, "different"),
        ({"seeds": 0}, "1 or more"),
        ({"solvers": []}, "each once"),
        ({"scenario": {"solver": {"name": "rnn"}}}, r"\[scenario.solver\]"),
        ({"grid": {"control.regularization": list(range(1, 4000)), "seed_": [1]}}, "unknown scenario field"),
        ({"grid": {p: [i / 1e4 for i in range(4000)] for p in ("control.c0", "control.c1")}}, "several sweeps"),
    ],
)  # fmt: skip
def test_what_cannot_be_swept_is_said_before_anything_runs(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(MocOptError, match=message):
        plan(config(**changes))


def test_names_in_values_and_settings_are_checked_before_anything_runs() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'circle'"):
        plan(config(grid={"task.path": ["circle", "circel"]}))
    with pytest.raises(UnknownNameError, match="did you mean 'eps'"):
        plan(config(solvers=["osqp"], grid={"solver.settings.epss": [1e-6]}))
    with pytest.raises(UnknownNameError, match="did you mean 'osqp'"):
        plan(config(solvers=["osqpp"]))
    with pytest.raises(UnknownNameError, match=r"\[settings\]"):
        plan(config(settings={"osqp": {}}))


def test_solver_that_cannot_run_here_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "benchmarks.common.config.available", lambda: {"exact": None, "osqp": "pip install osqp"}
    )
    with pytest.raises(SolverError, match="pip install osqp"):
        plan(config(solvers=["osqp"]))
    assert {run.solver for run in plan(config(solvers="all"))} == {"dcac", "exact"}


@given(st.integers(0, 2**32), st.integers(1, 40), st.floats(1e-9, 1e3), st.floats(1.01, 1e6))
@settings(max_examples=60)
def test_a_sample_stays_in_its_range_and_only_grows(
    seed: int, samples: int, low: float, ratio: float
) -> None:
    fields: dict[str, Any] = {
        "control.regularization": {"low": low, "high": low * ratio, "scale": "log"},
        "plant.friction": {"low": -low, "high": low * ratio},
        "plant.delay_ticks": {"low": 0, "high": 5, "scale": "integer"},
        "task.path": {"choice": ["circle", "spiral"]},
    }
    drawn = random_draws(fields, samples, seed)
    assert all(low <= v <= low * ratio for v in drawn["control.regularization"])
    assert all(-low <= v <= low * ratio for v in drawn["plant.friction"])
    assert set(drawn["plant.delay_ticks"]) <= set(range(6))
    assert all(isinstance(v, int) for v in drawn["plant.delay_ticks"])
    longer = random_draws({"control": {"regularization": fields["control.regularization"]}}, samples + 3, seed)
    assert longer["control.regularization"][:samples] == drawn["control.regularization"]


def test_a_logarithmic_sample_is_uniform_in_its_exponent() -> None:
    fields = {"control.regularization": {"low": 1e-6, "high": 1e-2, "scale": "log"}}
    drawn = np.log10(random_draws(fields, 4000, 0)["control.regularization"])
    assert np.histogram(drawn, [-6, -5, -4, -3, -2])[0] == pytest.approx([1000] * 4, rel=0.1)


def test_the_plan_is_every_combination_in_a_fixed_order() -> None:
    runs = plan(config(solvers=["exact", "osqp"]))
    assert len(runs) == 24
    assert [run.solver for run in runs[:3]] == ["exact", "osqp", "exact"]
    assert [run.seed for run in runs[:5]] == [0, 0, 1, 1, 0]
    last = runs[-1].scenario
    assert (last.control.regularization, last.plant.mass_error, last.seed) == (1e-4, 0.1, 1)
    assert (last.solver.name, last.duration_s) == ("osqp", 0.05)


def test_ids_belong_to_scenarios_not_to_places() -> None:
    runs, others = plan(config()), plan(config(grid={"plant.mass_error": [0.1]}, seeds=[1]))
    here = {run.id: run.scenario for run in runs}
    assert len(here) == 12
    assert here[others[0].id] == others[0].scenario  # regularization 1e-5 is the default
    assert plan(config(scenario={**TINY, "duration_s": 0.06}))[0].id not in here


def test_the_same_run_is_done_once() -> None:
    axes = {"solver.settings.eps": [1e-6, 1e-8], "control.k0_per_s": [1.0, 2.0]}
    runs = plan(config(solvers=["dcac", "osqp"], grid=axes, seeds=1))
    assert len(runs) == 6  # of 8: dcac asks no solver
    assert [run.values["solver.settings.eps"] for run in runs if run.solver == "dcac"] == [None, None]
    assert runs[0].scenario.control.law == "dcac"
    assert runs[0].scenario.control.gains == "default"
    assert runs[1].scenario.solver.settings == {"eps": 1e-6}
    drawn = {"samples": 50, "fields": {"task.path": {"choice": ["circle", "spiral"]}}}
    assert len(plan(config(random=drawn, grid={}, seeds=1))) == 2


def test_without_solvers_the_scenarios_own_is_taken() -> None:
    own = {**TINY, "solver": {"name": "osqp", "settings": {"eps": 1e-7}}, "control": {"law": "moc"}}
    (run,) = plan(Config(scenario=own, seeds=1))
    assert (run.solver, run.scenario.solver.settings) == ("osqp", {"eps": 1e-7})
    (dcac,) = plan(Config(scenario={**TINY, "control": {"law": "dcac"}}))
    assert (dcac.solver, dcac.scenario.control.gains) == ("dcac", "default")


def test_quick_is_the_same_sweep_on_less() -> None:
    full = Config.load(default_config("sweep"))
    small, whole = plan(full.quick()), plan(full)
    assert 0 < len(small) <= 8 < len(whole)
    assert small[0].values.keys() == whole[0].values.keys()
    assert small[0].scenario.duration_s == 0.2


def test_groups_hold_the_figures_of_their_rows() -> None:
    rows = [
        {"solver": name, "ended": ended, "error": error, "mu_mean": mu}
        for name, ended, error, mu in [
            ("a", "completed", None, 1.0), ("a", "completed", None, 3.0), ("a", "stopped: force", None, 9.0),
            ("a", "failed", "no", None), ("b", "oscillated", None, 5.0),
        ]
    ]  # fmt: skip
    found = sweep.summarise(rows)
    counts = {word: found["a"][word] for word in ("runs", "failed", "stopped", "oscillated")}
    assert counts == {"runs": 4, "failed": 1, "stopped": 1, "oscillated": 0}
    assert found["a"]["mu_mean"] == pytest.approx(
        {"count": 2, "mean": 2.0, "min": 1.0, "max": 3.0, "p05": 1.1, "p50": 2.0, "p95": 2.9}
    )
    assert found["b"]["mu_mean"]["mean"] == 5.0


def test_the_command_leaves_its_files_and_keeps_shared_times_out(tmp_path: Path, capsys: Any) -> None:
    file = tmp_path / "sweep.toml"
    file.write_text(
        'seeds = 1\nsolvers = ["dcac", "exact"]\n[grid]\ncontrol.regularization = [1e-6, 1e-4]\n'
        "[scenario]\nduration_s = 0.05\njudge = false\nbound_samples = 0\n"
    )
    command = [str(file), "--out", str(tmp_path / "out"), "--workers", "1"]
    assert sweep.main(command) == 0
    shown = capsys.readouterr().out
    assert "By solver and control.regularization" in shown
    assert "4 runs, 0 of them ended by an error" in shown
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["sweep"]["runs"] == {
        "all": 4, "failed": 0, "stopped": 0, "oscillated": 0, "timed_alone": 4, "timed_shared": 0,
    }  # fmt: skip
    assert summary["latency"]["exact"]["tick_p50_us"]["count"] == 2
    assert summary["by control.regularization"]["exact, 0.0001"]["runs"] == 1
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Manipulability against control.regularization" in page
    first_screens.check(page, pictures=2)
    assert (tmp_path / "out" / "environment.json").exists()
    rows = pl.read_parquet(tmp_path / "out" / "rows.parquet")
    assert sweep.main(command) == 0
    again = pl.read_parquet(tmp_path / "out" / "rows.parquet")
    assert rows.equals(again)  # times too: nothing was done again
    assert "4 of 4 runs were finished before" in capsys.readouterr().err

    shared = [str(file), "--out", str(tmp_path / "shared"), "--workers", "2", "--json"]
    assert sweep.main(shared) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["sweep"]["runs"]["timed_shared"] == 4
    assert summary["latency"] == {}
    other = pl.read_parquet(tmp_path / "shared" / "rows.parquet")
    clocks = [name for name in rows.columns if name.endswith("_us")] + ["wall_s", "deadline_misses", "timing_shared"]
    assert other.drop(clocks, strict=False).equals(rows.drop(clocks, strict=False))
