"""Short runs of every arm of the package at the default preset, in the realistic plant."""

from __future__ import annotations

import numpy as np
import pytest

from moc_opt.robots import available_robots
from moc_opt.scenario import Scenario, run
from moc_opt.trace.metrics import summarize


@pytest.mark.parametrize("name", available_robots())
def test_every_arm_does_the_default_task(name: str) -> None:
    """The whole circle under both laws: it completes, stays precise, and the third level finds what there is."""
    asked = Scenario(robot={"name": name}, bound_samples=0)
    moc, dcac = run(asked), run(asked.change(control=asked.control.matched_dcac()))
    assert (moc.meta["ended"], dcac.meta["ended"]) == ("completed", "completed")
    found = summarize(moc, dcac)
    assert found["tip_error_max_mm"] < 1.0
    assert found["rcm_error_max_mm"] < 2.0
    assert found["verified_solved"] == len(moc)
    assert found["mu_gain_percent"] > 10.0
    baseline = summarize(dcac)
    assert baseline["tip_error_max_mm"] < 1.0
    assert baseline["rcm_error_max_mm"] < 2.0


@pytest.mark.parametrize("preset", ["tuned", "robust"])
@pytest.mark.parametrize("name", available_robots())
def test_every_preset_is_for_every_arm(name: str, preset: str) -> None:
    """Also where the loop has another tick of delay and no friction that would hide a joint that swings."""
    asked = Scenario(robot={"name": name}, control={"preset": preset}, bound_samples=0, judge=False, duration_s=3.0)
    asked = asked.change(plant={"friction": 0.0, "delay_ticks": asked.plant.delay_ticks + 1})
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
