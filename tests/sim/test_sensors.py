"""Encoders, and the force/torque sensor."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.sim import PlantSettings
from moc_opt.sim.sensors import Encoders, longest_repetition, repeats_no_reading

PERIOD = 0.002


def encoders(seed=0, n=7, *, noise_rad=0.0, resolution_rad=0.0, cutoff_Hz=0.0):
    plant = PlantSettings.nominal(
        period_s=PERIOD, encoder_noise_rad=noise_rad, encoder_resolution_rad=resolution_rad,
        velocity_cutoff_Hz=cutoff_Hz,
    )  # fmt: skip
    return Encoders(plant, np.zeros(n), np.random.default_rng(seed))


@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1e-2))
@settings(max_examples=50)
def test_resolution_rounds_to_its_steps(seed, step):
    q = np.random.default_rng(seed).uniform(-3, 3, 7)
    position, _ = encoders(resolution_rad=step).start(q, np.zeros(7))
    assert np.abs(position - q).max() <= step / 2 + 1e-12
    steps = position / step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_noise_has_its_deviation_and_its_seed():
    runs = []
    for seed in (3, 3, 4):
        sensor = encoders(seed, noise_rad=1e-4)
        sensor.start(np.zeros(7), np.zeros(7))
        runs.append(np.array([sensor.read(np.zeros(7), np.zeros(7))[0] for _ in range(3000)]))
    np.testing.assert_allclose(runs[0][:200], 1e-4 * np.random.default_rng(3).standard_normal((256, 7))[1:201])
    assert runs[0].std() == pytest.approx(1e-4, rel=0.03)
    assert abs(runs[0].mean()) < 3e-6
    assert np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])


def test_velocity_is_the_low_passed_difference_quotient():
    """A first-order low-pass reaches 1 - 1/e of a step after 1 / (2 pi cutoff), and has no steady error."""
    cutoff = 5.0
    sensor = encoders(cutoff_Hz=cutoff)
    q, speed = np.zeros(7), np.linspace(-1, 1, 7)
    sensor.start(q, np.zeros(7))
    estimates = []
    for _ in range(500):
        q = q + PERIOD * speed
        position, velocity = sensor.read(q, speed)
        np.testing.assert_array_equal(position, q)
        estimates.append(velocity)
    rise = 1.0 - np.exp(-2 * np.pi * cutoff * PERIOD * np.arange(1, 501))
    np.testing.assert_allclose(estimates, rise[:, None] * speed, atol=1e-9)


def test_velocity_starts_at_the_true_one_and_is_bare_without_cutoff():
    sensor = encoders(noise_rad=1e-5)
    first, velocity = sensor.start(np.zeros(7), np.full(7, 0.3))
    np.testing.assert_array_equal(velocity, 0.3)
    second, velocity = sensor.read(np.zeros(7), np.zeros(7))
    np.testing.assert_allclose(velocity, (second - first) / PERIOD, rtol=1e-12, atol=1e-15)


@given(st.floats(2e-6, 1e-4), st.just(0.0) | st.floats(1e-9, 3.0), st.floats(-0.5, 0.5), st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_an_encoder_at_rest_never_repeats_itself_for_longer_than_its_noise_lets_it(noise, steps, phase, seed):
    """Wherever it stands within a step of its reading."""
    step = steps * noise
    longest = longest_repetition(noise, step)
    assert longest is not None
    assert longest >= 10
    sensor = encoders(seed, N := 16, noise_rad=noise, resolution_rad=step)
    q = np.full(N, (1000.0 + phase) * max(step, noise))
    sensor.start(q, 0.0 * q)
    read = np.array([sensor.read(q, 0.0 * q)[0] for _ in range(1500)])
    changes = np.flatnonzero(np.vstack([np.ones((1, N), bool), np.diff(read, axis=0) != 0.0]).T)
    assert np.diff(changes).max() <= longest


@given(st.floats(0.3, 10.0), st.floats(5.0, 400.0), st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_an_encoder_with_noise_and_a_filter_repeats_no_reading(steps, cutoff, seed):
    """Once its velocity has been other than zero; where that is promised."""
    noise, step = 1e-5, steps * 1e-5
    sensor = encoders(seed, N := 16, noise_rad=noise, resolution_rad=step, cutoff_Hz=cutoff)
    q = np.full(N, 1000.0 * step)
    sensor.start(q, np.full(N, 1e-3))
    positions, velocities = np.swapaxes([sensor.read(q, 0.0 * q) for _ in range(800)], 0, 1)
    twice = (np.diff(positions, axis=0) == 0.0) & (np.diff(velocities, axis=0) == 0.0)
    if repeats_no_reading(noise, step, cutoff, PERIOD):
        assert not twice.any()


def test_an_encoder_with_next_to_no_noise_or_no_filter_may_repeat_itself():
    given = [(0.0, 2.4e-5), (3e-6, 2.4e-5), (1e-5, 2.4e-5), (1e-5, 0.0)]
    assert [longest_repetition(noise, step) for noise, step in given] == [None, None, 89, 10]
    # No filter: the same position twice is no velocity twice; one of 10 kHz is next to none.
    filters = [(1e-5, 50.0), (1e-5, 0.0), (1e-5, 1e4), (0.0, 50.0)]
    promised = [repeats_no_reading(noise, 2.4e-5, cutoff, PERIOD) for noise, cutoff in filters]
    assert promised == [True, False, False, False]
