"""Runs of every arm, of an arm with sixteen joints, and of a law written in Python."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from moc_opt.qp.problem import compute_residuals
from moc_opt.robots import available_robots
from moc_opt.scenario import Scenario, run
from moc_opt.trace.metrics import summarize
from tests.planning.arms import sixteen_joints

BARE = {"bound_samples": 0, "judge": False}


@pytest.mark.parametrize("name", available_robots())
def test_every_arm_completes_the_default_task(name):
    asked = Scenario(robot={"name": name}, bound_samples=0, task={"sizes": {"radius": 0.02}, "hold_s": 0.1})
    moc, dcac = run(asked), run(asked.change(control=asked.control.matched_dcac(), judge=False))
    assert (moc.meta["ended"], dcac.meta["ended"]) == ("completed", "completed")
    found = summarize(moc, dcac)
    assert found["verified_solved"] == len(moc)
    assert found["mu_gain_percent"] > 10.0
    for law, figures in {"moc": found, "dcac": summarize(dcac)}.items():
        # The gen3's shaft can hardly turn in some poses.
        assert figures["tip_error_max_mm"] < (1.2 if (name, law) == ("gen3", "moc") else 1.0)
        assert figures["rcm_error_max_mm"] < 2.2


@pytest.mark.parametrize(("preset", "more"), [(None, 2), ("tuned", 1), ("robust", 1)])
@pytest.mark.parametrize("name", available_robots())
def test_every_preset_works_on_every_arm(name, preset, more):
    """Friction is off, because it would hide oscillation."""
    asked = Scenario(
        seed=1, robot={"name": name}, control={"preset": preset} if preset else {}, duration_s=2.5, **BARE,
        start={"pose": "home" if preset else "random"},
    )  # fmt: skip
    trace = run(asked.change(plant={"friction": 0.0, "delay_ticks": asked.plant.delay_ticks + more}))
    assert trace.meta["ended"] == "completed"
    assert summarize(trace)["tip_error_max_mm"] < 1.5


def test_answers_for_sixteen_joints_are_verified(tmp_path):
    """An answer shifted along the self-motion is not verified."""
    robot = sixteen_joints(tmp_path, np.random.default_rng(2).uniform(-0.7, 0.7, 16))
    trace = run(Scenario(robot={"name": str(tmp_path / "arm.toml")}, duration_s=0.3, bound_samples=1))
    assert trace.meta["ended"] == "completed"
    assert trace.verified.all()
    assert trace.meta["mu_bound_method"].startswith("best found of ")
    rows = slice(50, None, 25)
    rng, x = np.random.default_rng(0), np.array(trace.x_rad_per_s[rows])
    for k, q in enumerate(trace.q_rad[rows]):
        Z = np.linalg.svd(robot.state(q).A)[2][5:]
        x[k] += 0.05 * Z.T @ rng.normal(size=len(Z))
    assert not compute_residuals(trace.subproblem[rows], x).verified().any()


def test_law_written_in_python_follows_the_path_and_raises_mu():
    setup = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "own_law.py"))["OwnSetup"]
    scenario = Scenario(duration_s=1.5, start={"swivel": 0.2}, **BARE)
    own, dcac = setup(scenario).trace(), run(scenario.change(control=scenario.control.matched_dcac()))
    assert own.meta["ended"] == "completed"
    assert 1e3 * own.tip_error_m.mean() < 3.0
    assert own.mu.mean() > 1.01 * dcac.mu.mean()
