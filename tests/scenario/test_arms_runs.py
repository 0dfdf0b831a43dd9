"""Short runs of every arm of the package at the default preset, in the realistic plant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from moc_opt.qp.problem import compute_residuals
from moc_opt.robots import available_robots
from moc_opt.scenario import Scenario, run
from moc_opt.trace.metrics import summarize
from tests.planning.arms import build


@pytest.mark.parametrize("name", available_robots())
def test_every_arm_does_the_default_task(name: str) -> None:
    """The whole circle under both laws: it completes, stays precise, and the third level finds what there is."""
    asked = Scenario(robot={"name": name}, bound_samples=0)
    moc, dcac = run(asked), run(asked.change(control=asked.control.matched_dcac()))
    assert (moc.meta["ended"], dcac.meta["ended"]) == ("completed", "completed")
    found = summarize(moc, dcac)
    # The gen3 passes close to the loss of its shaft, where the box opens to the joints' whole speed: for half a second.
    assert found["tip_error_max_mm"] < (1.2 if name == "gen3" else 1.0)
    assert found["rcm_error_max_mm"] < 2.0
    assert found["verified_solved"] == len(moc)
    assert found["mu_gain_percent"] > 10.0
    baseline = summarize(dcac)
    assert baseline["tip_error_max_mm"] < 1.0
    assert baseline["rcm_error_max_mm"] < 2.0


@pytest.mark.parametrize(("preset", "more"), [(None, 2), ("tuned", 1), ("robust", 1)])
@pytest.mark.parametrize("name", available_robots())
def test_every_preset_is_for_every_arm(name: str, preset: str | None, more: int) -> None:
    """Also where the loop has more ticks of delay, three in all under the default gains from a random
    pose, and no friction that would hide a joint that swings.
    """
    asked = Scenario(
        seed=1, robot={"name": name}, control={"preset": preset} if preset else {}, bound_samples=0, judge=False,
        duration_s=3.0, start={"pose": "home" if preset else "random"},
    )  # fmt: skip
    asked = asked.change(plant={"friction": 0.0, "delay_ticks": asked.plant.delay_ticks + more})
    trace = run(asked)
    assert trace.meta["ended"] == "completed"
    assert summarize(trace)["tip_error_max_mm"] < 1.5


@pytest.mark.parametrize("name", available_robots())
def test_idle_joints_come_to_rest_without_friction(name: str) -> None:
    """What moves neither tip nor wrist is damped: nothing keeps it swinging."""
    asked = Scenario(robot={"name": name}, bound_samples=0, judge=False)
    asked = asked.change(
        plant={"friction": 0.0}, task={"path": "line", "sizes": {"length": 0.005}, "hold_s": 2.0}
    )
    trace = run(asked)
    assert trace.meta["ended"] == "completed"
    late = trace.t_s > trace.t_s[-1] - 1.0
    assert np.abs(trace.v_rad_per_s[late, -1]).max() < 0.02  # the last joint turns about the tool


def test_sixteen_joints_run_and_are_judged(tmp_path: Path) -> None:
    """Ten real freedoms: every answer of `exact` verifies, and one moved along the self-motion does not."""
    turns = [((0, 0, 0.1), (0, 0, 0)), *[((0, 0, 0.08), (sign * np.pi / 2, 0, 0)) for sign in 7 * (1, -1) + (1,)]]
    home = np.random.default_rng(2).uniform(-0.7, 0.7, 16)
    robot = build(tmp_path, {
        "joints": turns, "q_max": np.full(16, 1.8), "v_max": np.full(16, 2.0), "wrist": (0, 0, 0),
        "mount": (0, 0, 0.05), "home": home,
    })  # fmt: skip
    trace = run(Scenario(robot={"name": str(tmp_path / "arm.toml")}, duration_s=0.4, bound_samples=2))
    assert trace.meta["ended"] == "completed"
    assert trace.verified.all()
    assert trace.meta["mu_bound_method"].startswith("best found of ")
    rows = slice(50, None, 25)  # past the ramp
    rng, x = np.random.default_rng(0), np.array(trace.x_rad_per_s[rows])
    for k, q in enumerate(trace.q_rad[rows]):
        Z = np.linalg.svd(robot.state(q).A)[2][5:]
        x[k] += 0.05 * Z.T @ rng.normal(size=len(Z))
    assert not compute_residuals(trace.subproblem[rows], x).verified().any()
