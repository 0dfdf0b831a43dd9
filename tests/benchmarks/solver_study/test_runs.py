"""Runs of the controller for tables: in workers, kept, combined, and broken off with their reason."""

from functools import partial

import numpy as np
import pytest

from benchmarks.solver_study import closed_loop
from benchmarks.solver_study.cases import trials
from benchmarks.solver_study.closed_loop import Asked, Run, by_trial, run_all, run_each, with_steady_errors
from benchmarks.solver_study.combine import combined, summary
from moc_opt.figures.notation import Doubtful
from moc_opt.scenario import Scenario, run
from moc_opt.study import Kept
from moc_opt.study import run as do
from moc_opt.study.timing import Disturbance
from moc_opt.study.trials import BASELINE, placed, variant
from moc_opt.trace.metrics import summarize
from tests import broken_solvers

SHORT = Scenario(duration_s=0.1, bound_samples=2)


STIFF = {"K_X": 3000.0, "D_X": 80.0, "K_N": 800.0, "D_N": 60.0, "K_N2": 80.0, "D_N2": 1.0}


@pytest.fixture(scope="module")
def trial():
    return trials(SHORT, ["circle"], 3, 1)["circle/3"]


def test_every_trial_has_a_seed_of_its_own_and_the_tasks_take_turns():
    cases = trials(SHORT, ["circle", "spiral"], 5, 3)
    assert list(cases) == ["circle/5", "spiral/6", "circle/7"]
    assert [(case.task.path, case.seed) for case in cases.values()] == [("circle", 5), ("spiral", 6), ("circle", 7)]
    assert cases["circle/5"].start.q_rad != cases["circle/7"].start.q_rad
    fewer = trials(SHORT, ["circle", "spiral"], 5, 2)
    assert list(fewer.items()) == list(cases.items())[:2]


def test_a_placed_trial_is_the_run_from_its_random_pose():
    drawn = SHORT.change(seed=5, start={"pose": "random", "swivel": "random"}, solver={"name": "exact"})
    searched, given = run(drawn), run(placed(drawn))
    assert given.meta["start_q_rad"] == searched.meta["start_q_rad"]
    np.testing.assert_array_equal(given.q_rad, searched.q_rad)


def test_the_baseline_has_the_gains_of_the_others(trial):
    base = variant(trial, BASELINE)
    assert (base.control.law, base.control.gains) == ("dcac", "default")
    assert variant(trial, "osqp", {"eps": 1e-3}).solver.settings == {"eps": 1e-3}


ONE = partial(do, workers=1)


def test_a_run_in_a_worker_is_the_run(trial):
    direct = run(variant(trial, "exact"))
    asked = [Asked(BASELINE, variant(trial, BASELINE)), Asked("exact", variant(trial, "exact"), timed=True)]
    base, found = by_trial(run_each(ONE, asked))
    np.testing.assert_array_equal(found.columns["mu"], direct.mu)
    expected = summarize(direct, run(variant(trial, BASELINE)))
    for name in ("mu_mean", "mu_fraction_of_bound", "tip_error_max_mm", "verified_solved"):
        assert found.metrics[name] == expected[name]
    assert found.metrics["mu_gain_percent"] == pytest.approx(expected["mu_gain_percent"])
    assert found.metrics["ticks"] == 50.0
    assert found.trace is not None
    assert found.load.calls == 50
    assert found.load.wall_s > 1e-6 * found.columns["tick_us"].sum()
    assert base.error is None


def test_timed_runs_are_kept_where_their_times_are_trusted(trial, tmp_path, monkeypatch):
    case = variant(trial, "exact")
    asked = [Asked("exact", case, timed=True), Asked("exact", case, whole=False)]
    for trusted, reused in ((False, 0), (True, 1), (True, 2)):
        monkeypatch.setattr(Disturbance, "trusts", lambda *_, trusted=trusted: trusted)
        kept = Kept(tmp_path / "jobs")
        found = run_each(partial(ONE, kept=kept), asked)
        assert kept.reused == reused, "times that are not used are always kept"
        ticks = combined(found[:1])
        assert isinstance(ticks["tick_p50_us"], Doubtful) is not trusted
        assert ticks["times_calls"] == 50


def test_what_breaks_off_is_a_result(trial):
    (found,) = run_each(ONE, [Asked("osqp", variant(trial, "osqp", {"eps": -1.0}), timed=True)])
    assert found.trace is None
    assert "SolverError" in found.error
    counts = {"runs": 1, "broke_off": 1, "timed_runs": 0, "short_runs": 0, "stopped": 0, "oscillated": 0}
    assert combined([found]) == {**counts, "reason": found.error}
    assert found.row()["ended"] == "failed"


def test_a_stopped_run_enters_no_mean_and_an_oscillating_one_is_counted(trial):
    """Both are whole rows of rows.parquet, the part marked as one."""
    whole = trial.change(duration_s=2.0, control=STIFF, plant={"delay_ticks": 2})
    shaken = whole.change(guard={"rcm_error_m": None, "trocar_force_N": None, "tip_error_m": 0.1, "motion": False})
    stopped = trial.change(guard={"rcm_error_m": 1e-6, "rcm_warning_m": 1e-6})
    runs = run_each(ONE, [Asked("a", case) for case in (trial, shaken, stopped)])
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
    runs = run_all(ONE, cases, {"hangs": {"at": 20}, "exact": {}}, timed=2)
    table = summary(runs)
    assert table["hangs"]["broke_off"] == 2
    assert [run.error[:4] for run in runs if run.controller == "hangs"] == ["hung", "not "]
    assert table["exact"]["broke_off"] == 0
    assert len(runs) == 6


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


def traced(controller, travels, tip_mm, trial="t", timed=True, mu=1.0):
    """A run of ten ticks whose elbow travels at the given ones; the tip error [mm] is given for each tick."""
    flags = np.zeros(10, dtype=bool)
    flags[list(travels)] = True
    error = 1e-3 * np.asarray(tip_mm, dtype=float)
    columns = {"t_s": np.arange(10) * 0.002, "mu": np.full(10, mu), "tip_error_model_m": error, "rcm_error_m": error,
               "rcm_error_model_m": 0.5 * error, "solve_us": np.full(10, 5.0 if timed else 500.0),
               "travelling": flags}  # fmt: skip
    metrics = {"mu_mean": mu, "tip_error_model_mean_mm": 1e3 * error.mean(), "deadline_misses": 0.0 if timed else 9.0}
    return Run(controller, trial, metrics, columns, timed=timed)


def test_settled_ticks_are_one_set_for_all_controllers_of_a_trial():
    """Each masked by its own motion, DCAC would have 2.0 mm, `a` 3.5 and `b` 4.0."""
    ramp = np.arange(10.0)
    runs = [traced(BASELINE, range(5, 10), ramp), traced("a", range(0, 3), ramp), traced("b", range(2, 6), ramp),
            Run("broken", "t", {}, error="ran away")]  # fmt: skip
    found = {run.controller: run.metrics for run in with_steady_errors(runs)}
    assert {name: metrics.get("settled_ticks") for name, metrics in found.items()} == {
        BASELINE: 4.0, "a": 4.0, "b": 4.0, "broken": None
    }  # fmt: skip
    for name in (BASELINE, "a", "b"):
        assert found[name]["tip_error_model_settled_mean_mm"] == pytest.approx(7.5)  # ticks 6 to 9
        assert found[name]["rcm_error_model_settled_mean_mm"] == pytest.approx(3.75)


def test_where_no_tick_is_settled_there_is_no_figure():
    runs = with_steady_errors([traced(BASELINE, [], np.ones(10)), traced("a", range(10), np.ones(10))])
    assert all(run.metrics["settled_ticks"] == 0.0 for run in runs)
    assert not any("tip_error_model_settled_mean_mm" in run.metrics for run in runs)
    others = [traced(BASELINE, [], np.ones(10), "u"), traced("a", [0], 2.0 * np.ones(10), "u")]
    both = [*runs, *with_steady_errors(others)]
    assert summary(both)["a"]["tip_error_model_settled_mean_mm"] == pytest.approx(2.0)
    assert summary(both)["a"]["settled_ticks"] == 9.0


def test_trials_count_by_their_settled_ticks():
    one = with_steady_errors([traced("a", range(9), np.ones(10), "t")])  # one settled tick at 1 mm
    other = with_steady_errors([traced("a", [], 4.0 * np.ones(10), "u")])  # ten at 4 mm
    assert combined([*one, *other])["tip_error_model_settled_mean_mm"] == pytest.approx(41.0 / 11.0)


def test_a_change_is_a_ratio_of_means_with_an_interval():
    """Gains of 100 % at a small mu and of 10 % at a large one: 18.2 % of the mean, and not 55 %."""
    runs = []
    for trial, (mu, gain) in {"t": (0.1, 2.0), "u": (1.0, 1.1), "v": (0.1, 2.0), "w": (1.0, 1.1)}.items():
        runs += [traced(BASELINE, [], np.ones(10), trial, mu=mu), traced("a", [], np.ones(10), trial, mu=mu * gain)]
    found = summary(runs)["a"]
    assert found["mu_gain_percent"] == pytest.approx(100.0 * (1.3 / 1.1 - 1.0))
    assert found["mu_gain_percent_low"] < found["mu_gain_percent"] < found["mu_gain_percent_high"]
    assert found["tip_change_percent"] == 0.0
    assert found["runs"] == 4
    broken = [run if run.controller == BASELINE else Run("a", run.trial, {}, error="no") for run in runs]
    assert "mu_gain_percent" not in summary(broken)["a"]


def test_times_are_those_of_the_runs_that_ran_alone():
    runs = [traced("a", [], np.ones(10)), traced("a", [], np.ones(10), "u", timed=False)]
    found = combined(runs)
    assert found["solve_p50_us"] == found["solve_p99_us"] == 5.0
    assert found["deadline_misses"] == 0.0
    assert (found["runs"], found["timed_runs"]) == (2, 1)
    assert found["mu_mean"] == 1.0


def test_trials_beside_each_other_give_what_they_give_alone():
    cases = trials(SHORT, ["circle"], 0, 3)
    alone = run_all(ONE, cases, {"exact": {}}, timed=3)
    beside = run_all(partial(do, workers=2), cases, {"exact": {}}, timed=1)
    assert [(run.trial, run.controller) for run in alone] == [(run.trial, run.controller) for run in beside]
    for one, other in zip(alone, beside, strict=True):
        np.testing.assert_array_equal(one.columns["mu"], other.columns["mu"])
        assert one.metrics["settled_ticks"] == other.metrics["settled_ticks"]
    assert [run.timed for run in beside] == [True, True, False, False, False, False]
    starts = [tuple(run.columns["q_rad"][0]) for run in alone if run.controller == "exact"]
    assert len(set(starts)) == 3  # three poses
