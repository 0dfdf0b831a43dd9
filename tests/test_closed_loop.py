"""Runs of the controller for tables: in workers, kept, combined, and broken off with their reason."""

import numpy as np
import pytest

from benchmarks.study import closed_loop
from benchmarks.study.closed_loop import BASELINE, Run, combined, run_all, run_one, summary, trials, variant
from benchmarks.study.store import Store
from benchmarks.study.worker import Worker
from moc_opt.metrics import summarize
from moc_opt.scenario import Scenario, run
from tests import broken_solvers

SHORT = Scenario(duration_s=0.1, bound_samples=2)


STIFF = {"K_X": 3000.0, "D_X": 80.0, "K_N": 800.0, "D_N": 60.0, "K_N2": 80.0, "D_N2": 1.0}


@pytest.fixture(scope="module")
def trial():
    return trials(SHORT, ["circle"], [3])["circle/3"]


def test_trials_are_one_per_task_and_seed():
    cases = trials(SHORT, ["circle", "spiral"], [0, 1])
    assert list(cases) == ["circle/0", "circle/1", "spiral/0", "spiral/1"]
    assert {(case.task.path, case.seed, case.start.swivel) for case in cases.values()} == {
        (task, seed, "random") for task in ("circle", "spiral") for seed in (0, 1)
    }


def test_the_baseline_has_the_gains_of_the_others(trial):
    base = variant(trial, BASELINE)
    assert (base.control.law, base.control.gains) == ("dcac", "moc")
    assert variant(trial, "osqp", {"eps": 1e-3}).solver.settings == {"eps": 1e-3}


def test_a_run_in_a_worker_is_the_run(trial, tmp_path):
    direct = run(variant(trial, "exact"))
    with Worker() as worker:
        base = run_one(Store(tmp_path), worker, variant(trial, BASELINE), BASELINE, None)
        found = run_one(Store(tmp_path), worker, variant(trial, "exact"), "exact", base)
    np.testing.assert_array_equal(found.columns["mu"], direct.mu)
    expected = summarize(direct, run(variant(trial, BASELINE)))
    for name in ("mu_mean", "mu_gain_percent", "mu_fraction_of_bound", "tip_error_max_mm", "verified_solved"):
        assert found.metrics[name] == expected[name]
    assert found.metrics["ticks"] == 50.0
    assert found.trace is not None
    assert base.error is None


def test_a_kept_run_is_not_run_again(trial, tmp_path):
    store = Store(tmp_path)
    with Worker() as worker:
        first = run_one(store, worker, variant(trial, "exact"), "exact", None)
    second = run_one(store, None, variant(trial, "exact"), "other name", None)  # no worker: nothing may run
    assert second.metrics == first.metrics
    assert second.controller == "other name"
    np.testing.assert_array_equal(second.columns["solve_us"], first.columns["solve_us"])


def test_what_breaks_off_is_a_result(trial):
    with Worker() as worker:
        found = run_one(Store(None), worker, variant(trial, "osqp", {"eps": -1.0}), "osqp", None)
    assert found.trace is None
    assert "SolverError" in found.error
    counts = {"runs": 1, "broke_off": 1, "stopped": 0, "oscillated": 0}
    assert combined([found]) == {**counts, "reason": found.error}
    assert found.row()["ended"] == "failed"


def test_a_stopped_run_enters_no_mean_and_an_oscillating_one_is_counted(trial):
    """Both are whole rows of rows.parquet, the part marked as one."""
    whole = trial.change(duration_s=2.0, control={"damping": 0.0, **STIFF})
    shaken = whole.change(guard={"rcm_error_m": None, "trocar_force_N": None})
    stopped = trial.change(guard={"rcm_error_m": 1e-6, "rcm_warning_m": 1e-6})
    with Worker() as worker:
        runs = [run_one(Store(None), worker, case, "a", None) for case in (trial, shaken, stopped)]
    assert [run.ended.split(":")[0] for run in runs] == ["completed", "oscillated", "stopped"]
    assert [run.row()["ended"] for run in runs] == [run.ended for run in runs]
    assert runs[2].error.startswith("stopped: the RCM error")
    assert runs[2].metrics["completed"] == 0.0
    found = combined(runs)
    assert (found["runs"], found["broke_off"], found["stopped"], found["oscillated"]) == (3, 1, 1, 1)
    assert found["completed"] == 1.0
    assert found["share_of_run"] == 1.0
    assert found["tip_error_mean_mm"] == pytest.approx(np.mean([run.metrics["tip_error_mean_mm"] for run in runs[:2]]))


def test_a_solver_that_hangs_breaks_its_run_off_and_is_not_asked_again(trial, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(broken_solvers.install(tmp_path / "plugin")))
    monkeypatch.setattr(closed_loop, "PATIENCE_S", 4.0)
    cases = {name: trial.change(name=name) for name in ("first", "second")}
    seen = []
    runs = run_all(cases, {"hangs": {"at": 20}, "exact": {}}, seen.append)
    table = summary(runs)
    assert table["hangs"]["broke_off"] == 2
    assert [run.error[:4] for run in runs if run.controller == "hangs"] == ["hung", "not "]
    assert table["exact"]["broke_off"] == 0
    assert len(seen) == len(runs) == 6


def made(metrics, times):
    columns = {"t_s": np.arange(len(times)) * 0.002, "mu": np.ones(len(times)), "solve_us": np.array(times)}
    return Run("a", "t", metrics, columns)


def test_combining_averages_means_sums_counts_and_pools_times():
    runs = [
        made(
            {"mu_mean": 0.2, "tip_error_max_mm": 1.0, "silently_wrong": 3.0, "solve_p50_us": 9.0}, [1.0] * 10
        ),
        made(
            {"mu_mean": 0.4, "tip_error_max_mm": 5.0, "silently_wrong": 4.0, "solve_p50_us": 9.0}, [3.0] * 30
        ),
    ]
    found = combined(runs)
    assert found["mu_mean"] == pytest.approx(0.3)
    assert found["tip_error_max_mm"] == 5.0
    assert found["silently_wrong"] == 7.0
    assert found["solve_p50_us"] == 3.0  # of all forty, no mean of medians
