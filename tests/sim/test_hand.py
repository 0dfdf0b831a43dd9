"""The hand pulls with a bounded force, towards its goal, and corrects what stops short."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.errors import PlantError, UnknownNameError
from moc_opt.sim.hand import Hand, HandSettings

PERIOD = 0.002
VECTOR = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)


@given(st.lists(st.tuples(VECTOR, VECTOR), min_size=1, max_size=30), st.floats(0.5, 30.0))
def test_the_force_is_bounded_whatever_happens(moments, most):
    hand = Hand(HandSettings(force_max_N=most), PERIOD)
    for place, velocity in moments:
        assert np.linalg.norm(hand.pull(place, velocity, np.zeros(3))) <= most * (1 + 1e-12)


def test_near_the_goal_it_is_a_spring_and_a_damper():
    hand = Hand(HandSettings(stiffness_N_per_m=500.0, damping_Ns_per_m=50.0, correction_per_s=0.0), PERIOD)
    goal, velocity = np.array([0.002, 0.0, 0.0]), np.array([0.0, 0.01, 0.0])
    np.testing.assert_allclose(hand.pull(np.zeros(3), velocity, goal), [1.0, -0.5, 0.0], atol=1e-12)


def test_far_away_it_wants_its_speed_and_no_more():
    hand = Hand(HandSettings(speed_max_m_per_s=0.1), PERIOD)
    goal = np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(hand.pull(np.zeros(3), 0.1 * goal, goal), 0.0, atol=1e-12)
    assert hand.pull(np.zeros(3), np.zeros(3), goal)[1] == pytest.approx(6.0)


def move(settings, load, seconds=6.0):
    """A mass of 4 kg under a steady load; returns how far from the goal it ends [m]."""
    hand, place, velocity = Hand(settings, PERIOD), np.array([0.1, 0.0, 0.0]), np.zeros(3)
    for _ in range(round(seconds / PERIOD)):
        velocity = velocity + PERIOD * (hand.pull(place, velocity, np.zeros(3)) + load) / 4.0
        place = place + PERIOD * velocity
    return float(np.linalg.norm(place)), float(np.linalg.norm(velocity))


def test_a_steady_load_is_corrected_until_the_hand_is_content():
    load = np.array([0.0, 0.0, -5.0])
    without, _ = move(HandSettings(correction_per_s=0.0), load)
    away, speed = move(HandSettings(), load)
    assert without == pytest.approx(5.0 / 600.0, rel=0.05)
    assert away <= 0.0006
    assert speed < 1e-3


def test_a_load_beyond_its_strength_wins():
    away, _ = move(HandSettings(force_max_N=4.0), np.array([0.0, 0.0, -5.0]), seconds=2.0)
    assert away > 0.05


def test_a_tool_that_was_stuck_and_comes_loose_is_not_thrown():
    hand, place, velocity = Hand(HandSettings(), PERIOD), np.array([0.005, 0.0, 0.0]), np.zeros(3)
    for _ in range(10_000):
        hand.pull(place, velocity, np.zeros(3))
    farthest = 0.0
    for _ in range(5_000):
        velocity = velocity + PERIOD * hand.pull(place, velocity, np.zeros(3)) / 4.0
        place = place + PERIOD * velocity
        farthest = max(farthest, -place[0])
    assert farthest < 0.03
    assert np.linalg.norm(place) < 0.001


def test_settings_and_runaways_are_refused():
    with pytest.raises(PlantError, match=r"\[hand\] force_max_N = -1"):
        HandSettings(force_max_N=-1.0)
    with pytest.raises(UnknownNameError, match="stiffness_N_per_m"):
        HandSettings(stiffness=600)
    with pytest.raises(PlantError, match="lost the tool"):
        Hand(HandSettings(), PERIOD).pull(np.full(3, np.nan), np.zeros(3), np.zeros(3))
