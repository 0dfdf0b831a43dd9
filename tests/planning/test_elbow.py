"""The elbow is in its transient where its poses are made to move to the optimum, not where they follow it or rest."""

import numpy as np
import pytest

from moc_opt.planning.elbow import distance_to_go, in_transient
from moc_opt.planning.self_motion import self_motion

T = np.arange(0.0, 4.0, 0.02)


@pytest.fixture(scope="module")
def curve(robot):
    return self_motion(robot, robot.data.q_home)


@pytest.fixture(scope="module")
def place(curve):
    """Poses at arc lengths from the top of the curve."""
    top = curve.s[np.argmax(curve.mu)] - curve.s[0]
    return lambda s: np.array([curve.at((top + each) / (curve.s[-1] - curve.s[0])) for each in np.atleast_1d(s)])


def test_distance_is_the_arc_length_along_the_self_motion(robot, curve, place):
    offsets = np.array([-0.6, -0.3, -0.1, 0.1, 0.3, 0.6])
    distance = distance_to_go(robot, [*place(offsets), curve.best, np.zeros(7)])
    np.testing.assert_allclose(distance[:6], np.abs(offsets), atol=0.02)
    assert distance[6] < 1e-3
    assert np.isnan(distance[7]), "a straight arm is singular"


@pytest.mark.parametrize(("way", "speed", "before", "after"), [(1.0, 0.5, 1.7, 1.9), (0.4, 0.1, 2.8, 3.2)])
def test_an_elbow_at_speed_travels_until_it_is_within_a_tenth_of_a_radian(robot, place, way, speed, before, after):
    flags = in_transient(robot, T, place(np.minimum(speed * T - way, 0.0)))
    assert flags[before > T].all()
    assert not flags[after < T].any()


def test_an_elbow_that_rests_or_is_slow_or_follows_its_moving_optimum_is_in_no_transient(robot, curve, place):
    """Turning the base carries arm and optimum along at any speed; turning the last joint turns the tool alone."""
    far, turns = np.tile(place(-0.5), (100, 1)), np.linspace(0.0, 1.0, 100)
    base, last = (np.outer(turns, axis) for axis in np.eye(7)[[0, 6]])
    for q in (far, curve.best + base, far + last):
        assert not in_transient(robot, 0.01 * np.arange(100), q).any()
    assert not in_transient(robot, T, place(0.03 * T - 0.4)).any()


def test_one_tick_is_no_journey(robot):
    assert not in_transient(robot, [0.0], [robot.data.q_home]).any()
