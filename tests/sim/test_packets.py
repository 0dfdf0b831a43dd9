"""Faults of measurements in time: what arrives, with which number, and what leaves the readings as they are."""

import numpy as np
import pytest

from moc_opt.errors import PlantError
from moc_opt.sim import Measurement
from moc_opt.sim.faults import Faults, FaultSettings

PERIOD, N = 0.002, 7


def arrived(ticks=60, seed=0, **changes):
    """Numbers (ticks,), first positions and velocities of what arrives of readings q = number, v = 0.1 number."""
    faults = Faults(FaultSettings(**changes), N, PERIOD, seed)
    seen = [
        faults.sense(Measurement(np.full(N, float(k)), np.full(N, 0.1 * k), np.zeros(6), k), k) for k in range(ticks)
    ]
    return np.array([s.stamp for s in seen]), np.array([s.q for s in seen]), np.array([s.v for s in seen])


def test_numbers_travel_with_their_readings():
    replay = {"replay_at_s": 0.06, "replay_ticks": 7}
    for changes in ({}, {"late_ticks": 3}, {"drop_share": 0.4}, {"lag_at_s": 0.04}, replay):
        stamps, q, v = arrived(**changes)
        np.testing.assert_array_equal(q[:, 0], stamps)
        np.testing.assert_allclose(v[:, 0], 0.1 * stamps)
    np.testing.assert_array_equal(arrived()[0], np.arange(60))


def test_frozen_for_so_many_ticks():
    stamps, _, _ = arrived(frozen_at_s=0.04, frozen_ticks=10)
    expected = np.arange(60)
    expected[20:30] = 19
    np.testing.assert_array_equal(stamps, expected)
    forged, q, v = arrived(frozen_at_s=0.04, frozen_ticks=10, forged_stamps=True, frozen_velocity="zero")
    np.testing.assert_array_equal(forged, np.arange(60))
    np.testing.assert_array_equal(q[:, 0], expected)
    assert not v[20:30].any()
    assert v[30:].all()


@pytest.mark.parametrize("joint", [0, 6])
def test_one_encoder_is_stuck_and_the_others_are_not(joint):
    stamps, q, v = arrived(frozen_at_s=0.04, frozen_joint=joint, frozen_velocity="zero")
    others = np.arange(N) != joint
    np.testing.assert_array_equal(stamps, np.arange(60))
    np.testing.assert_array_equal(q[:, others], np.tile(np.arange(60.0)[:, None], N - 1))
    assert (q[20:, joint] == 19.0).all()
    assert not v[20:, joint].any()


@pytest.mark.parametrize("growth", [0.1, 1.0])
def test_the_lag_grows_from_its_delay(growth):
    stamps, _, _ = arrived(lag_at_s=0.04, lag_growth=growth, late_ticks=2)
    k = np.arange(60)
    late = 2 + np.floor(growth * np.maximum(k - 19, 0) + 1e-9)
    np.testing.assert_array_equal(stamps, np.maximum(k - late, 0))
    assert (np.diff(stamps) >= 0).all()


def test_the_past_comes_once_more():
    stamps, _, _ = arrived(replay_at_s=0.04, replay_ticks=8)
    np.testing.assert_array_equal(stamps[:20], np.arange(20))
    np.testing.assert_array_equal(stamps[20:], np.resize(np.arange(13, 21), 40))


def test_a_drift_is_in_position_and_velocity_alike():
    clean, drifting = arrived(), arrived(drift_rad_per_s=0.5, drift_at_s=0.02, seed=3)
    moved, faster = drifting[1] - clean[1], drifting[2] - clean[2]
    assert not moved[:11].any()
    np.testing.assert_allclose(np.abs(faster[11:]), 0.5)
    np.testing.assert_allclose(np.diff(moved[11:], axis=0) / PERIOD, faster[12:], atol=1e-9)
    assert {-1.0, 1.0} == set(np.sign(faster[-1]))


@pytest.mark.parametrize(
    "changes",
    [{"lag_growth": 0.0}, {"frozen_ticks": 0}, {"frozen_joint": -1}, {"frozen_velocity": "none"}, {"replay_ticks": 0}],
)
def test_wrong_settings_name_the_field(changes):
    with pytest.raises(PlantError, match=next(iter(changes))):
        FaultSettings(**changes)


def test_a_joint_that_is_not_there_is_refused():
    with pytest.raises(PlantError, match="frozen_joint = 7"):
        Faults(FaultSettings(frozen_at_s=0.0, frozen_joint=7), N, PERIOD, 0)
