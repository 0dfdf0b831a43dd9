"""The elbow is in its transient where its poses are made to move to the optimum, not where they follow it or rest."""

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


def test_distance_is_the_arc_length_along_the_self_motion(robot, curve):
    top = float(curve.s[np.argmax(curve.mu)])
    offsets = np.array([-0.6, -0.3, -0.1, 0.1, 0.3, 0.6])
    poses = [*(place(curve, top + offset) for offset in offsets), curve.best, np.zeros(7)]
    distance, mu = distance_to_go(robot, poses)
    np.testing.assert_allclose(distance[:6], np.abs(offsets), atol=0.02)
    np.testing.assert_allclose(mu[:7], curve.mu_best, rtol=1e-4)
    assert distance[6] < 1e-3
    assert np.isnan(distance[7]), "a straight arm is singular"


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


def test_an_elbow_at_rest_far_away_or_at_its_moving_optimum_is_in_no_transient(robot, curve):
    """Turning the base carries arm and optimum along, at any speed."""
    t = 0.01 * np.arange(100)
    rest, follow = (np.tile(q, (100, 1)) for q in (place(curve, float(curve.s[0]) + 0.5), curve.best))
    follow[:, 0] += np.linspace(0.0, 1.0, 100)
    assert not in_transient(robot, t, rest).any()
    assert not in_transient(robot, t, follow).any()


def test_speed_and_distance_decide_at_their_borders(robot, curve):
    """0.1 rad/s is a transient up to a tenth of a radian from the top; 0.03 rad/s is none anywhere."""
    top = float(curve.s[np.argmax(curve.mu)])
    t = np.arange(0.0, 4.0, 0.02)
    flags = in_transient(robot, t, np.array([place(curve, top - 0.4 + 0.1 * each) for each in t]))
    assert flags[t < 2.8].all()
    assert not flags[t > 3.2].any()
    slow = np.array([place(curve, top - 0.4 + 0.03 * each) for each in t])
    assert not in_transient(robot, t, slow).any()


def test_no_ticks_and_another_arms_are_refused_and_one_tick_is_no_journey(robot):
    for t, q in (([], np.empty((0, 7))), ([0.0, 0.1], np.zeros((2, 3)))):
        with pytest.raises(RobotError, match="q_rad shape"):
            in_transient(robot, t, q)
    assert not in_transient(robot, [0.0], [robot.data.q_home]).any()
