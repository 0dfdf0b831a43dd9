"""Trials of a study."""

from typing import Any

import numpy as np
import pytest

from moc_opt.planning.elbow import in_transient
from moc_opt.robots import load_data
from moc_opt.scenario import Scenario, Setup
from moc_opt.study import trials as study
from moc_opt.study.engine import Failed
from moc_opt.study.trials import BASELINE, BASELINES, DAMPED, OWN, Trial, run_trial, variant
from moc_opt.trace.metrics import summarize
from moc_opt.vision.board import BOARD_TASKS

SHORT = Scenario(judge=False, bound_samples=0, duration_s=0.3, control={"preset": "tuned"})


@pytest.fixture(scope="module")
def case() -> Scenario:
    return study.placed(study.trials(SHORT, ["circle"], [5], virtual=True)[0])


def test_each_seed_has_its_own_scenario() -> None:
    own = study.seeds(0, 0, 6)
    drawn = study.trials(SHORT, list(BOARD_TASKS), own, virtual=True)
    assert [scene.seed for scene in drawn] == own
    assert [scene.name for scene in drawn] == [f"{task}/{s}" for task, s in zip([*BOARD_TASKS] * 2, own, strict=True)]
    for scene in drawn:
        task = BOARD_TASKS[scene.name.partition("/")[0]]
        assert (scene.task.path, scene.task.sizes) == (task.kind, dict(task.sizes))
        assert (scene.trocar.depth_m, scene.start.swivel) == (task.depth_m, "random")
    plain = study.trials(SHORT, ["line", "circle"], own[:3])
    assert [scene.task.path for scene in plain] == ["line", "circle", "line"]


def test_placed_trial_starts_in_the_pose_that_the_search_found() -> None:
    (drawn,) = study.trials(SHORT.change(start={"pose": "random"}), ["circle"], [9])
    found = study.placed(drawn)
    assert (found.seed, found.name, found.start.pose) == (9, drawn.name, "home")
    np.testing.assert_allclose(Setup(found).q_start, Setup(drawn).q_start, atol=1e-12)


def test_all_controllers_run_the_same_trial(case: Scenario) -> None:
    first, *others = [Setup(variant(case, name)) for name in (*BASELINES, "exact", "rnn-printed")]
    for other in others:
        np.testing.assert_array_equal(other.q_start, first.q_start)
        np.testing.assert_array_equal(other.trocar.point, first.trocar.point)
        assert other.plant.mismatch.mass_scale == first.plant.mismatch.mass_scale
        np.testing.assert_array_equal(other.plant.measure().q, first.plant.measure().q)


@pytest.mark.parametrize("preset", ["paper", "tuned"])
def test_baselines_differ_from_moc_only_in_law_and_gains(case: Scenario, preset: str) -> None:
    given = case.change(control={"preset": preset})
    tables = load_data("lwr4").gains
    moc = variant(given, "rnn", {"steps": 5})
    assert (moc.solver.name, moc.solver.settings, moc.control) == ("rnn", {"steps": 5}, given.control)
    ours = moc.control.resolve_gains(tables, 7)
    for name in BASELINES:
        dcac = variant(given, name).control
        assert (dcac.law, dcac.observer_rate_per_s) == ("dcac", moc.control.observer_rate_per_s)
        assert (dcac.feedforward, dcac.projector) == (moc.control.feedforward, moc.control.projector)
        theirs = dcac.resolve_gains(tables, 7)._asdict()
        for key in ("K_X", "D_X", "K_N", "D_N"):
            np.testing.assert_array_equal(theirs[key], tables["dcac"][key] if name == OWN else getattr(ours, key))
    assert variant(given, BASELINE).control.dcac_damping == variant(given, OWN).control.dcac_damping == 0.0
    np.testing.assert_allclose(variant(given, DAMPED).control.dcac_damping, ours.K_N2 + ours.D_N2)
    dcac = given.change(control={"law": "dcac", "K_X": 77.0})
    assert variant(dcac, BASELINE) == dcac, "a scenario with DCAC keeps its gains"
    assert variant(dcac, OWN).control.K_X is None


@pytest.fixture(scope="module")
def ran(case: Scenario) -> dict[str, Any]:
    asked = [Trial(case, name, tags={"group": "g"}, keep="curves") for name in (BASELINE, "exact")]
    return {one.controller: study.run_and_trace(one) for one in asked}


def test_run_keeps_the_requested_columns(case: Scenario, ran: dict[str, Any]) -> None:
    run, trace = ran["exact"]
    about = {"trial": case.name, "seed": 5, "robot": "lwr4", "task": "circle", "controller": "exact", "group": "g"}
    assert run.row.items() >= {**about, "ended": "completed", "whole": True, "error": None, "ticks": 150}.items()
    metrics = {name: value for name, value in summarize(trace).items() if name in run.row}
    assert metrics["mu_mean"] == trace.mu.mean()
    assert run.row.items() >= metrics.items()
    assert run.row["asked"] == 150
    np.testing.assert_array_equal(run.columns["travelling"], in_transient(case.robot.arm(), trace.t_s, trace.q_rad))
    np.testing.assert_array_equal(run.columns["trocar_force_N"], trace.trocar_force_N)
    assert "travelling" not in ran[BASELINE][0].columns, "DCAC does not move the elbow to an optimum"


def test_only_timed_runs_report_times(case: Scenario, ran: dict[str, Any]) -> None:
    asked = Trial(case, "exact", timed=True)
    run = run_trial(asked)
    timed = run.row
    assert run.load["times_calls"] == 150
    assert 0.0 < run.load["times_cpu_s"] <= 1.1 * run.load["times_wall_s"]
    assert ran["exact"][0].load == {}
    for name in ("solve_p50_us", "tick_p99_us", "deadline_misses"):
        assert timed[name] >= 0.0
        assert name not in ran["exact"][0].row
    assert asked.job.alone
    assert not Trial(case, "exact").job.alone
    assert Trial(case.change(duration_s=None), "exact").job.limit_s > asked.job.limit_s


@pytest.mark.parametrize(("change", "solver", "ended", "error"), [
    ({"guard": {"rcm_error_m": 1e-6, "rcm_warning_m": 1e-6}}, "exact", "stopped: the RCM error", None),
    ({"plant": {"trocar_stiffness_N_per_m": 1e6, "trocar_damping_Ns_per_m": 1e4}}, "exact", "ran away", None),
    ({"start": {"q_rad": (0.0,) * 7}}, "exact", "failed", "ScenarioError: [start] q_rad"),
    ({}, "no-such-solver", "failed", "UnknownNameError: unknown solver"),
])  # fmt: skip
def test_row_of_an_incomplete_run_has_the_reason(case, change, solver, ended, error):
    run = run_trial(Trial(case.change(**change), solver, tags={"group": "g"}, keep="curves"))
    assert run.row["whole"] is False
    assert run.row["ended"].startswith(ended)
    assert run.row["error"].startswith(error or ended)
    assert (run.row["trial"], run.row["controller"], run.row["group"]) == (case.name, solver, "g")
    assert run.columns == {}
    hung = study.outcome(Trial(case, solver, tags={"group": "g"}), Failed("hung", "no answer within 30 s")).row
    assert hung == {**hung, "ended": "failed", "whole": False, "group": "g", "error": "hung: no answer within 30 s"}


def test_row_reports_the_solvers_exceptions(case: Scenario) -> None:
    row = run_trial(Trial(case.change(faults={"solver": "raise", "solver_share": 0.2}), "exact")).row
    assert (row["ended"], row["error"]) == ("completed", None)
    assert row["raised"].startswith(f"{row['fault_raised']} ticks, first at ")
    assert row["fault_raised"] > 0
