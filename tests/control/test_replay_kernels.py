"""Recordings: what is played once more is counted, what never came before is not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.control.replay_kernels import JOINT_SLOTS, SLOTS, count_lagging, count_replayed


def fed(readings):
    """The hits after each of the readings (k, 20): q, v, wrench."""
    seen, count = np.zeros((2, SLOTS)), np.zeros(3)
    return [
        count_replayed(np.array(r[:7]), np.array(r[7:14]), np.array(r[14:]), seen, count) for r in readings
    ]


def noisy(seed, ticks, still=True):
    """Readings of an arm whose encoders count in steps and whose wrench sensor has noise."""
    rng = np.random.default_rng(seed)
    readings = np.zeros((ticks, 20))
    readings[:, :7] = 0.5 if still else 0.5 + 1e-4 * np.arange(ticks)[:, None]
    readings[:, 14:] = rng.normal(scale=0.05, size=(ticks, 6))
    return readings


@given(st.integers(0, 1000), st.integers(2, 300), st.integers(0, 400), st.booleans())
@settings(deadline=None, max_examples=40)
def test_a_recording_is_counted_from_its_second_turn_on(seed, turn, before, still):
    sound = noisy(seed, before + turn, still)
    hits = fed([*sound, *np.tile(sound[before:], (60, 1))[:60]])
    assert max(hits[: len(sound)]) == 0.0
    # A slot that another reading took costs a hit; of 700 readings in 4096 slots few do.
    assert hits[-1] >= 45


@pytest.mark.parametrize("ticks", [20_000])
def test_readings_with_noise_never_came_before(ticks):
    assert max(fed(noisy(3, ticks))) == 0.0


def test_one_number_changed_in_the_last_bit_is_another_reading():
    sound = noisy(5, 50)
    for column in range(14, 20):
        other = sound.copy()
        other[:, column] = np.nextafter(np.abs(other[:, column]) + 1.0, np.inf)
        assert fed([*sound, *other])[-1] == 0.0


def test_a_frozen_reading_is_no_recording():
    sound = noisy(7, 50)
    assert fed([*sound, *[sound[-1]] * 100])[-1] == 0.0


def test_two_readings_that_changed_places_are_no_recording():
    """Hits count only with one and the same lag."""
    sound = noisy(9, 100)
    order = np.random.default_rng(1).permutation(100)
    assert max(fed([*sound, *sound[order]])) < 10


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_what_is_no_number_is_left_out(value):
    readings = noisy(11, 30)
    readings[:, 15] = value
    assert fed([*readings, *readings])[-1] == 0.0


def lagging(q, v):
    """The most readings of one encoder that came before, after each of the readings (k, n)."""
    seen, counts = np.zeros((2 * q.shape[1], JOINT_SLOTS)), np.zeros((q.shape[1], 3))
    return [count_lagging(*reading, seen, counts) for reading in zip(q, v, strict=True)]


@given(st.integers(0, 1000), st.integers(2, 60), st.integers(0, 6))
@settings(deadline=None, max_examples=40)
def test_an_encoder_that_begins_to_lag_shows_its_last_readings_once_more(seed, ticks, joint):
    rng = np.random.default_rng(seed)
    q, v = 0.5 + 1e-5 * rng.integers(-2, 3, size=(400, 7)), 1e-3 * rng.normal(size=(400, 7))
    late_q, late_v = q.copy(), v.copy()
    late_q[300:, joint], late_v[300:, joint] = q[300 - ticks : -ticks, joint], v[300 - ticks : -ticks, joint]
    assert max(lagging(q, v)) == 0.0
    hits = lagging(late_q, late_v)
    assert max(hits[:300]) == 0.0
    # A slot that another reading took costs a hit: of 60 readings in 256 slots one in nine, on average.
    assert 0.6 * ticks - 1.0 <= hits[-1] <= ticks
