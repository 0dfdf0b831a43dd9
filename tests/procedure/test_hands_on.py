"""A hand guides the tip to the incision on a realistic arm, and the trocar is registered where it rests."""

import numpy as np
import pytest

from moc_opt.errors import TaskError
from moc_opt.procedure.hands_on import HandsOnSettings, HandsOnStatus, guide_to
from moc_opt.sim import Plant, PlantSettings
from moc_opt.sim.hand import HandSettings


def incision(robot, seed):
    rng = np.random.default_rng(seed)
    return robot.state(robot.data.q_home).tip + rng.uniform([-0.1, -0.15, 0.05], [0.1, 0.15, 0.2])


def guided(robot, seed=0, plant_settings=None, **settings):
    plant = Plant(robot.data, plant_settings or PlantSettings.realistic(), seed=seed)
    return guide_to(incision(robot, seed), plant, robot, HandsOnSettings(**settings), seed=seed), plant


@pytest.mark.parametrize("seed", range(5))
def test_the_trocar_is_registered_on_the_realistic_arm(robot, seed):
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


@pytest.mark.parametrize("error", [0.0, 0.001, 0.005])
def test_the_registration_error_is_the_one_asked_for(robot, error):
    exact, _ = guided(robot, 1, registration_error_m=0.0)
    off, _ = guided(robot, 1, registration_error_m=error)
    assert np.linalg.norm(off.registered - exact.registered) == pytest.approx(error, abs=1e-12)
    np.testing.assert_array_equal(off.trace.q_rad, exact.trace.q_rad)


def test_true_and_registered_trocar_are_kept_apart(robot):
    found, _ = guided(robot, 2)
    np.testing.assert_array_equal(found.trace.trocar_m[0], incision(robot, 2))
    np.testing.assert_array_equal(found.trace.trocar_registered_m[-1], found.registered)
    assert found.error_m == pytest.approx(np.linalg.norm(found.registered - found.trocar))
    assert found.error_m > 1e-4
    assert found.trace.meta["status"] == "registered"


def test_the_arm_is_held_by_nothing_but_its_own_law(robot):
    found, _ = guided(robot, 3, PlantSettings.nominal())
    trace = found.trace
    for k in range(0, len(trace), 97):
        expected = robot.gravity(trace.q_rad[k]) - 3.0 * trace.v_rad_per_s[k]
        np.testing.assert_allclose(trace.tau_Nm[k], expected, atol=1e-6)


def test_the_same_seed_gives_the_same_guiding(robot):
    one, other = (guided(robot, 4)[0] for _ in range(2))
    np.testing.assert_array_equal(one.registered, other.registered)
    for name, column in one.trace.columns.items():
        np.testing.assert_array_equal(column, other.trace.columns[name])


def test_a_hand_that_is_too_weak_is_told(robot):
    found, _ = guided(robot, 0, hand=HandSettings(force_max_N=0.5), time_limit_s=2.0)
    assert found.status is HandsOnStatus.SHORT
    assert found.registered is None
    assert np.isnan(found.error_m)
    assert np.isnan(found.trace.trocar_registered_m).all()
    assert "force_max_N" in found.status.value
    assert found.trace.t_s[-1] == pytest.approx(2.0, abs=0.005)


def test_a_tip_that_never_rests_is_told(robot):
    """The encoders' noise alone is more than this speed, though not at every tick."""
    found, _ = guided(robot, 0, rest_speed_m_per_s=3e-4, time_limit_s=8.0)
    assert found.status is HandsOnStatus.RESTLESS
    assert "rest_speed_m_per_s" in found.status.value


@pytest.mark.parametrize(
    ("point", "message"),
    [
        ((1.5, 0.0, 0.3), "distance_max_m"),
        ((1.16, 0.05, 0.0), "out of reach"),
        ((0.6, 0.0), "three finite numbers"),
        ((0.6, 0.0, np.nan), "three finite numbers"),
    ],
)
def test_an_impossible_incision_is_refused_before_anything_moves(robot, point, message):
    plant = Plant(robot.data, PlantSettings.realistic())
    before = plant.q
    with pytest.raises(TaskError, match=message):
        guide_to(point, plant, robot)
    assert plant.time == 0.0
    np.testing.assert_array_equal(plant.q, before)


def test_settings_out_of_range_name_the_field():
    with pytest.raises(TaskError, match=r"\[hands_on\] registration_error_m = 0\.01"):
        HandsOnSettings(registration_error_m=0.01)


def test_a_reason_of_the_safety_filter_stops_the_guiding(robot, monkeypatch):
    """A joint whose encoder fails: the brakes close, nothing is registered, and the trace says why."""
    plant = Plant(robot.data, PlantSettings.realistic(), seed=4)
    measure, calls = plant.measure, []

    def broken():
        calls.append(0)
        seen = measure()
        return seen._replace(q=seen.q + np.nan) if len(calls) > 300 else seen

    monkeypatch.setattr(plant, "measure", broken)
    found = guide_to(incision(robot, 4), plant, robot, HandsOnSettings(), seed=4)
    assert found.status is HandsOnStatus.STOPPED
    assert found.registered is None
    assert found.trace.meta["ended"] == "stopped: measurements not believed"
    assert len(found.trace) < 300 + 0.6 / 0.002  # half a second of stop after it
    assert np.isfinite(found.trace.tau_Nm).all()
    assert np.abs(found.trace.v_rad_per_s[-1]).max() < 0.05
