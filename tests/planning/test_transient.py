"""When the elbow counts as travelling: told from poses made to travel, to follow, and to rest."""

import numpy as np
import pytest

from moc_opt.errors import RobotError
from moc_opt.planning.elbow import distance_to_go, in_transient, uphill
from moc_opt.planning.self_motion import self_motion


@pytest.fixture(scope="module")
def curve(robot):
    return self_motion(robot, robot.data.q_home)


def place(curve, s):
    """Pose at arc length s of a curve."""
    return curve.at((s - curve.s[0]) / (curve.s[-1] - curve.s[0]))


def test_distance_to_the_best_pose_is_zero(robot, curve):
    distance, mu = distance_to_go(robot, [curve.best])
    assert distance[0] < 1e-3
    assert mu[0] == pytest.approx(curve.mu_best, rel=1e-5)


def test_distance_is_the_arc_length_along_the_self_motion(robot, curve):
    top = float(curve.s[np.argmax(curve.mu)])
    offsets = np.array([-0.6, -0.3, -0.1, 0.1, 0.3, 0.6])
    distance, mu = distance_to_go(robot, np.array([place(curve, top + offset) for offset in offsets]))
    np.testing.assert_allclose(distance, np.abs(offsets), atol=0.02)
    np.testing.assert_allclose(mu, curve.mu_best, rtol=1e-4)


def test_uphill_climbs_to_the_nearest_maximum_and_not_to_the_largest(robot, regular_poses):
    for q in regular_poses(10):
        curve = self_motion(robot, q)
        distance, mu = uphill(curve)
        assert mu >= robot.state(q).mu - 1e-9
        assert mu <= curve.mu_best + 1e-9
        assert 0.0 <= distance <= curve.s[-1] - curve.s[0]


def test_an_idle_joint_does_not_count(robot, curve):
    """The last joint turns the tool about itself: neither a distance nor a journey."""
    q = np.tile(place(curve, float(curve.s[0]) + 0.5), (100, 1))
    q[:, 6] += np.linspace(0.0, 1.0, 100)
    t = 0.01 * np.arange(100)
    assert not in_transient(robot, t, q).any()


def test_an_elbow_at_speed_travels_until_it_is_there(robot, curve):
    top = float(curve.s[np.argmax(curve.mu)])
    t = np.arange(0.0, 4.0, 0.01)
    s = top - np.maximum(1.0 - 0.5 * t, 0.0)  # 0.5 rad/s, there at t = 2
    flags = in_transient(robot, t, np.array([place(curve, each) for each in s]))
    assert flags[t < 1.7].all()
    assert not flags[t > 1.9].any()


def test_an_elbow_at_rest_far_away_does_not_travel(robot, curve):
    q = np.tile(place(curve, float(curve.s[0]) + 0.5), (50, 1))
    assert not in_transient(robot, 0.02 * np.arange(50), q).any()


def test_an_elbow_that_follows_its_moving_optimum_does_not_travel(robot, curve):
    """Turning the base carries arm and optimum along, at any speed."""
    q = np.tile(curve.best, (100, 1))
    q[:, 0] += np.linspace(0.0, 1.0, 100)
    assert not in_transient(robot, 0.01 * np.arange(100), q).any()


def test_settings_move_the_border(robot, curve):
    top = float(curve.s[np.argmax(curve.mu)])
    t = np.arange(0.0, 1.0, 0.01)
    q = np.array([place(curve, top - 0.5 + 0.1 * each) for each in t])  # 0.1 rad/s
    assert in_transient(robot, t, q).all()
    assert not in_transient(robot, t, q, still_rad_per_s=0.2).any()
    assert not in_transient(robot, t, q, near_rad=0.6).any()


def test_no_ticks_and_another_arms_are_refused_and_one_tick_is_no_journey(robot):
    for t, q in (([], np.empty((0, 7))), ([0.0, 0.1], np.zeros((2, 3)))):
        with pytest.raises(RobotError, match="q_rad shape"):
            in_transient(robot, t, q)
    assert not in_transient(robot, [0.0], [robot.data.q_home]).any()


def test_singular_poses_are_left_out(robot, curve):
    straight = np.zeros(7)
    distance, _ = distance_to_go(robot, [straight, curve.best])
    assert np.isnan(distance[0])
    assert distance[1] < 1e-3
