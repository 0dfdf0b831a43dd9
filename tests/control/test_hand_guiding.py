"""Gravity compensation with damping."""

import numpy as np
import pytest

from moc_opt.control.hand_guiding import HandGuiding
from moc_opt.errors import ControlError


def test_the_torque_is_gravity_less_damping(robot, regular_poses):
    rng = np.random.default_rng(0)
    law = HandGuiding(robot, np.arange(1.0, 8.0))
    for q in regular_poses(10):
        v = rng.uniform(-1, 1, 7)
        expected = robot.state(q).h - np.arange(1.0, 8.0) * v  # at rest, h is gravity alone
        np.testing.assert_allclose(law.tick(robot.state(q, v)), expected, atol=1e-9)


def test_torque_limits_are_kept(robot):
    law = HandGuiding(robot, 1000.0)
    tau = law.tick(robot.state(robot.data.q_home, np.full(7, 1.0)))
    np.testing.assert_array_equal(tau, -robot.tau_max)


@pytest.mark.parametrize("damping", [-1.0, np.nan, np.ones(6)])
def test_bad_damping_is_refused(robot, damping):
    with pytest.raises(ControlError, match="damping_Nm_s_per_rad"):
        HandGuiding(robot, damping)
