"""A drive that loses its torque, or turns it round, is stopped before the tip has gone far."""

import numpy as np
import pytest

from moc_opt.scenario import Scenario, run
from moc_opt.sim.plant import Plant

AT_S = 1.0


@pytest.mark.parametrize("gain", [-1.0, 0.0])
@pytest.mark.parametrize(
    ("arm", "joint", "seed"),
    [("lwr4", 4, 3), ("iiwa14", 4, 4), ("panda", 4, 3), ("gen3", 2, 0), ("xarm7", 2, 0), ("xarm7", 4, 3),
     ("lwr4_rail", 3, 4)],
)  # fmt: skip
def test_a_broken_drive_is_stopped_and_the_brakes_hold_the_arm(arm, joint, seed, gain, monkeypatch):
    """Of all joints and five seeds of each arm, these went farthest while the stop used the drives."""
    sound = Plant.step

    def step(plant, tau, trocar=None):
        tau = np.array(tau)
        if plant.time >= AT_S - 1e-9:
            tau[joint - 1] *= gain
        sound(plant, tau, trocar)

    monkeypatch.setattr(Plant, "step", step)
    start = {"pose": "random"}
    trace = run(Scenario(robot={"name": arm}, seed=seed, start=start, bound_samples=0, judge=False, duration_s=3.0))
    assert trace.meta["ended"].startswith("stopped")
    after = trace.tip_m[trace.t_s >= AT_S]
    assert np.linalg.norm(after - after[0], axis=1).max() < 0.05
