"""A hand guides the tip to the incision on a realistic arm, and the trocar is registered where it rests."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.errors import TaskError
from moc_opt.sim import Plant, PlantSettings
from moc_opt.vision.hands_on import Hand, HandSettings, HandsOnSettings, HandsOnStatus, guide_to


def incision(robot, seed):
    rng = np.random.default_rng(seed)
    return robot.state(robot.data.q_home).tip + rng.uniform([-0.1, -0.15, 0.05], [0.1, 0.15, 0.2])


def guided(robot, seed=0, plant_settings=None, **settings):
    plant = Plant(robot.data, plant_settings or PlantSettings(), seed=seed)
    return guide_to(incision(robot, seed), plant, robot, HandsOnSettings(**settings), seed=seed), plant


def test_the_trocar_is_registered_on_the_realistic_arm(robot):
    """The same run again, with an error of registration: it moves the registered trocar by that, and nothing else."""
    seed = 2
    found, plant = guided(robot, seed, registration_error_m=0.0)
    assert found.status is HandsOnStatus.REGISTERED
    # Encoders are that good; what is left is how near the hand stopped.
    assert found.error_m < 0.002
    trace = found.trace
    assert np.linalg.norm(trace.hand_force_N, axis=1).max() <= 15.0 * (1 + 1e-12)
    assert trace.tip_error_m[0] > 0.05
    resting = trace.t_s > trace.t_s[-1] - 0.35
    assert trace.tip_error_m[resting].max() < 0.0025
    assert np.linalg.norm(np.diff(trace.tip_m[resting], axis=0), axis=1).max() / 0.002 < 0.01
    np.testing.assert_allclose(plant.q, found.q, atol=1e-3)
    off, _ = guided(robot, seed, registration_error_m=0.003)
    assert np.linalg.norm(off.registered - found.registered) == pytest.approx(0.003, abs=1e-12)
    np.testing.assert_array_equal(off.trace.q_rad, trace.q_rad)
    np.testing.assert_array_equal(off.trocar, incision(robot, seed))
    assert off.error_m == pytest.approx(np.linalg.norm(off.registered - off.trocar)) != 0.0


@pytest.mark.parametrize(("settings", "status"), [
    ({"hand": HandSettings(force_max_N=0.5), "time_limit_s": 2.0}, HandsOnStatus.SHORT),
    # The encoders' noise alone is more than this speed, though not at every tick.
    ({"rest_speed_m_per_s": 3e-4, "time_limit_s": 4.0}, HandsOnStatus.RESTLESS),
])  # fmt: skip
def test_a_tip_that_does_not_reach_the_incision_or_never_rests_there_registers_nothing(robot, settings, status):
    found, _ = guided(robot, 0, **settings)
    assert found.status is status
    assert found.registered is None
    assert np.isnan(found.error_m)
    assert found.trace.t_s[-1] == pytest.approx(settings["time_limit_s"], abs=0.005)


@pytest.mark.parametrize("point", [(1.5, 0.0, 0.3), (1.16, 0.05, 0.0), (0.6, 0.0, np.nan)])
def test_an_impossible_incision_is_refused_before_anything_moves(robot, point):
    plant = Plant(robot.data, PlantSettings())
    before = plant.q
    with pytest.raises(TaskError):
        guide_to(point, plant, robot)
    assert plant.time == 0.0
    np.testing.assert_array_equal(plant.q, before)


PERIOD = 0.002
VECTOR = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)


@given(st.lists(st.tuples(VECTOR, VECTOR), min_size=1, max_size=30), st.floats(0.5, 30.0))
def test_the_force_is_bounded_whatever_happens(moments, most):
    hand = Hand(HandSettings(force_max_N=most), PERIOD)
    for place, velocity in moments:
        assert np.linalg.norm(hand.pull(place, velocity, np.zeros(3))) <= most * (1 + 1e-12)


def test_it_is_a_spring_and_a_damper_near_the_goal_and_wants_its_speed_far_away():
    hand = Hand(HandSettings(stiffness_N_per_m=500.0, damping_Ns_per_m=50.0, correction_per_s=0.0), PERIOD)
    goal, velocity = np.array([0.002, 0.0, 0.0]), np.array([0.0, 0.01, 0.0])
    np.testing.assert_allclose(hand.pull(np.zeros(3), velocity, goal), [1.0, -0.5, 0.0], atol=1e-12)
    hand, goal = Hand(HandSettings(speed_max_m_per_s=0.1), PERIOD), np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(hand.pull(np.zeros(3), 0.1 * goal, goal), 0.0, atol=1e-12)


def moved(hand, place, load=(0.0, 0.0, 0.0), seconds=6.0):
    """Places and last velocity of a mass of 4 kg under a steady load."""
    place, velocity, places = np.array(place), np.zeros(3), []
    for _ in range(round(seconds / PERIOD)):
        velocity = velocity + PERIOD * (hand.pull(place, velocity, np.zeros(3)) + load) / 4.0
        place = place + PERIOD * velocity
        places.append(place)
    return np.array(places), velocity


def test_a_steady_load_is_corrected_until_the_hand_is_content_if_it_has_the_strength():
    load, start = np.array([0.0, 0.0, -5.0]), (0.1, 0.0, 0.0)
    without, _ = moved(Hand(HandSettings(correction_per_s=0.0), PERIOD), start, load)
    assert np.linalg.norm(without[-1]) == pytest.approx(5.0 / 600.0, rel=0.05)
    away, velocity = moved(Hand(HandSettings(), PERIOD), start, load)
    assert np.linalg.norm(away[-1]) <= 0.0006
    assert np.linalg.norm(velocity) < 1e-3
    weak, _ = moved(Hand(HandSettings(force_max_N=4.0), PERIOD), start, load, seconds=2.0)
    assert np.linalg.norm(weak[-1]) > 0.05
    # A tool that was stuck and comes loose is not thrown.
    hand, place = Hand(HandSettings(), PERIOD), np.array([0.005, 0.0, 0.0])
    for _ in range(10_000):
        hand.pull(place, np.zeros(3), np.zeros(3))
    places, _ = moved(hand, place, seconds=10.0)
    assert places[:, 0].min() > -0.03
    assert np.linalg.norm(places[-1]) < 0.001
