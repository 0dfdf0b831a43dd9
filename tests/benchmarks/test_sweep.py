"""Sweeps: which runs a configuration makes, and what the command leaves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import sweep
from benchmarks.common.output import default_config
from benchmarks.sweeps.config import Config
from benchmarks.sweeps.fields import check_path, paths, random_draws
from benchmarks.sweeps.plan import Plan
from moc_opt.errors import MocOptError, SolverError, UnknownNameError
from tests import first_screens
from tests.sweeps import TINY, config


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
        Plan(config(grid={path: [1.0]}))
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
        ({"grid": {"control.damping": [1.0], "control.regularization": [2.0]}}, "given twice"),
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
        Plan(config(**changes)).number_runs()


def test_names_in_values_and_settings_are_checked_before_anything_runs() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'circle'"):
        Plan(config(grid={"task.path": ["circle", "circel"]})).check_names()
    with pytest.raises(UnknownNameError, match="did you mean 'eps'"):
        Plan(config(solvers=["osqp"], grid={"solver.settings.epss": [1e-6]})).check_names()
    with pytest.raises(UnknownNameError, match="did you mean 'osqp'"):
        Plan(config(solvers=["osqpp"]))
    with pytest.raises(UnknownNameError, match=r"\[settings\]"):
        Plan(config(settings={"osqp": {}}))


def test_solver_that_cannot_run_here_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "benchmarks.common.config.available", lambda: {"exact": None, "osqp": "pip install osqp"}
    )
    with pytest.raises(SolverError, match="pip install osqp"):
        Plan(config(solvers=["osqp"]))
    assert Plan(config(solvers="all")).solvers == ["dcac", "exact"]


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
    plan = Plan(config(solvers=["exact", "osqp"]))
    assert len(plan) == 24
    assert [plan.point(i).solver for i in range(3)] == ["exact", "osqp", "exact"]
    assert [plan.point(i).seed for i in range(5)] == [0, 0, 1, 1, 0]
    last = plan.scenario(23)
    assert (last.control.regularization, last.plant.mass_error, last.seed, last.solver.name) == (
        1e-4,
        0.1,
        1,
        "osqp",
    )
    assert last.duration_s == 0.05
    with pytest.raises(IndexError):
        plan.point(24)


def test_ids_belong_to_scenarios_not_to_places() -> None:
    plan, other = Plan(config()), Plan(config(grid={"plant.mass_error": [0.1]}, seeds=[1]))
    assert len({plan.run_id(i) for i in range(len(plan))}) == 12
    here = {plan.run_id(i): plan.scenario(i) for i in range(12)}
    assert here[other.run_id(0)] == other.scenario(0)  # regularization 1e-5 is the default
    assert plan.digest == Plan(config()).digest != other.digest
    assert Plan(config(scenario={**TINY, "duration_s": 0.06})).run_id(0) not in here


def test_the_same_run_is_done_once() -> None:
    axes = {"solver.settings.eps": [1e-6, 1e-8], "control.k0_per_s": [1.0, 2.0]}
    plan = Plan(config(solvers=["dcac", "osqp"], grid=axes, seeds=1))
    assert (plan.combinations, len(plan)) == (8, 6)  # dcac asks no solver
    points = [plan.point(i) for i in range(6)]
    assert [p.values["solver.settings.eps"] for p in points if p.solver == "dcac"] == [None, None]
    assert plan.scenario(0).control.law == "dcac"
    assert plan.scenario(0).control.gains == "default"
    assert plan.scenario(1).solver.settings == {"eps": 1e-6}
    drawn = {"samples": 50, "fields": {"task.path": {"choice": ["circle", "spiral"]}}}
    assert len(Plan(config(random=drawn, grid={}, seeds=1))) == 2


def test_without_solvers_the_scenarios_own_is_taken() -> None:
    own = {**TINY, "solver": {"name": "osqp", "settings": {"eps": 1e-7}}, "control": {"law": "moc"}}
    plan = Plan(Config(scenario=own, seeds=1))
    assert plan.solvers == ["osqp"]
    assert plan.scenario(0).solver.settings == {"eps": 1e-7}
    dcac = Plan(Config(scenario={**TINY, "control": {"law": "dcac"}}))
    assert dcac.point(0).solver == "dcac"
    assert dcac.scenario(0).control.gains == "default"


def test_quick_is_the_same_sweep_on_less() -> None:
    full = Config.load(default_config("sweep"))
    small = Plan(full.quick())
    assert 0 < len(small) <= 8 < len(Plan(full))
    assert small.fields == Plan(full).fields
    assert small.config.scenario.duration_s == 0.2


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
        "all": 4, "failed": 0, "stopped": 0, "oscillated": 0, "lost": 0, "timed_alone": 4, "timed_shared": 0,
    }  # fmt: skip
    assert summary["latency"]["exact"]["tick_p50_us"]["count"] == 2
    assert summary["by control.regularization"]["exact, 0.0001"]["runs"] == 1
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Manipulability against control.regularization" in page
    first_screens.check(page, pictures=2)
    assert (tmp_path / "out" / "environment.json").exists()

    whole = (tmp_path / "out" / "rows.parquet").read_bytes()
    shared = [str(file), "--out", str(tmp_path / "shared"), "--workers", "2", "--json"]
    assert sweep.main(shared) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["sweep"]["runs"]["timed_shared"] == 4
    assert summary["latency"] == {}
    assert pq.read_table(tmp_path / "shared" / "clock.parquet")["timing_shared"].to_pylist() == [True] * 4
    assert (tmp_path / "shared" / "rows.parquet").read_bytes() == whole

    assert sweep.main([*command, "--seed", "3"]) == 2
    assert "StoreError" in capsys.readouterr().err
