"""Gravity compensation with damping: it holds an arm it knows, takes energy out of a moving one, and yields."""

import numpy as np
import pytest

from moc_opt.control.hand_guiding import HandGuiding
from moc_opt.errors import ControlError
from moc_opt.sim import Plant, PlantSettings


def test_the_torque_is_gravity_less_damping(robot, regular_poses):
    rng = np.random.default_rng(0)
    law = HandGuiding(robot, np.arange(1.0, 8.0))
    for q in regular_poses(10):
        v = rng.uniform(-1, 1, 7)
        expected = robot.state(q).h - np.arange(1.0, 8.0) * v  # at rest, h is gravity alone
        np.testing.assert_allclose(law.tick(robot.state(q, v)), expected, atol=1e-9)


def test_a_moving_arm_loses_its_energy(robot):
    plant, law = Plant(robot.data, PlantSettings.nominal()), HandGuiding(robot)
    plant.reset(robot.data.q_home, np.random.default_rng(1).uniform(-0.5, 0.5, 7))
    energy = []
    for _ in range(1000):
        state = robot.state(plant.q, plant.v)
        energy.append(0.5 * state.v @ state.M @ state.v)
        plant.step(law.tick(robot.state(*plant.measure()[:2])))
    # Ten times a second: within a tick the torque is held, and the energy of one step may rise a little.
    assert (np.diff(energy[::50]) < 0.0).all()
    assert energy[-1] < 0.01 * energy[0]


def test_torque_limits_are_kept(robot):
    law = HandGuiding(robot, 1000.0)
    tau = law.tick(robot.state(robot.data.q_home, np.full(7, 1.0)))
    np.testing.assert_array_equal(tau, -robot.tau_max)


@pytest.mark.parametrize("damping", [-1.0, np.nan, np.ones(6)])
def test_bad_damping_is_refused(robot, damping):
    with pytest.raises(ControlError, match="damping_Nm_s_per_rad"):
        HandGuiding(robot, damping)
