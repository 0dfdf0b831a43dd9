"""A reference that waits never jumps: speed and acceleration keep their bounds through every loss and recovery."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.tasks import Reference, make_path
from moc_opt.tasks.waiting import WaitingReference, flags_at

PERIOD = 0.01
START = np.array([0.58, 0.0, 0.05])
PATHS = {
    "line": {"length": 0.04}, "circle": {"radius": 0.02}, "spiral": {"turns": 1.0, "radius": 0.015},
    "sinusoid": {"amplitude": 0.01, "wavelength": 0.02, "periods": 1.0},
}  # fmt: skip
REFERENCES = {
    kind: Reference(make_path(kind, START, normal=(0, 0, 1), heading=(1, 0, 0), **sizes), 0.05, 0.2)
    for kind, sizes in PATHS.items()
}
CIRCLE = REFERENCES["circle"]


def flags(seconds, losses):
    t = PERIOD * np.arange(round(seconds / PERIOD))
    seen = np.ones(len(t), dtype=bool)
    for start, length in losses:
        seen[(t >= start) & (t < start + length)] = False
    return seen


LOSSES = st.lists(st.tuples(st.floats(0.0, 5.0), st.floats(0.0, 1.5)), max_size=4)


@given(st.sampled_from(list(PATHS)), LOSSES, st.sampled_from([None, 0.05, 1.0]))
@settings(max_examples=30)
def test_position_speed_and_acceleration_are_continuous_and_bounded(kind, losses, brake):
    waiting = WaitingReference(original := REFERENCES[kind], PERIOD, brake_m_per_s2=brake)
    v_bound, a_bound = original.v_max, original.a_max + original.v_max / waiting.brake_s
    rows, times = waiting.play(flags(6.0, losses))
    x, dx, ddx = rows[:, 0], rows[:, 1], rows[:, 2]
    slack = 1 + 1e-9
    assert np.linalg.norm(dx, axis=1).max() <= v_bound * slack
    assert np.linalg.norm(ddx, axis=1).max() <= a_bound * slack
    assert a_bound <= 0.2 + (0.2 if brake is None else brake) * slack
    # What it says is what it does, judged by the positions alone.
    assert np.linalg.norm(np.diff(x, axis=0), axis=1).max() <= v_bound * PERIOD * slack
    second = np.diff(x, 2, axis=0) / PERIOD**2
    assert np.linalg.norm(second, axis=1).max() <= a_bound * (1 + 1e-4)
    # A tick's acceleration is that of its start; until the next one it changes by the slope's own steps.
    steps = v_bound * PERIOD / (0.5 * waiting.brake_s**2)
    assert np.abs(second - ddx[1:-1]).max() < 0.01 + 1.2 * steps
    middle = np.diff(x, axis=0) / PERIOD - 0.5 * (dx[1:] + dx[:-1])
    assert np.abs(middle).max() < 5e-4
    assert (np.diff(times) >= 0.0).all()
    assert (np.diff(times) <= PERIOD * slack).all()


@given(LOSSES)
@settings(max_examples=15)
def test_it_stays_on_the_path_and_arrives(losses):
    waiting, seen = WaitingReference(CIRCLE, PERIOD), flags(16.0, losses)
    rows, times = waiting.play(seen)
    np.testing.assert_allclose(rows[::50, 0], CIRCLE.at(times[::50])[0], atol=1e-12)
    assert times[-1] >= 16.0 - PERIOD * (~seen).sum() - waiting.settle_s - 2 * PERIOD
    assert times[-1] >= CIRCLE.t_start + CIRCLE.duration
    np.testing.assert_allclose(rows[-1, 0], START, atol=1e-9)
    np.testing.assert_array_equal(rows[-1, 1:], 0.0)


def test_a_lost_board_stops_the_tip_dead_and_it_goes_on_later():
    waiting = WaitingReference(CIRCLE, PERIOD)
    rows, times = waiting.play(flags(8.0, [(2.0, 2.0)]))
    stop, go = round((2.0 + waiting.settle_s) / PERIOD), round(4.0 / PERIOD)
    held = rows[stop + 1 : go]
    np.testing.assert_array_equal(held[:, 1:], 0.0)
    np.testing.assert_array_equal(held[:, 0], np.broadcast_to(held[0, 0], held[:, 0].shape))
    assert 0.0 < times[go] < CIRCLE.duration
    assert times[-1] > times[go] + 1.0


def test_seen_all_along_it_is_the_reference_a_little_later():
    waiting = WaitingReference(CIRCLE, PERIOD)
    rows, times = waiting.play(flags(8.0, []))
    late = PERIOD * np.arange(len(times)) - times
    settled = round(waiting.settle_s / PERIOD) + 1
    np.testing.assert_allclose(late[settled:], late[settled], atol=1e-12)
    assert late[settled] < waiting.settle_s
    assert waiting.brake_s == pytest.approx(0.05 / 0.2)
    np.testing.assert_allclose(rows[settled:, 0], CIRCLE.at(times[settled:])[0], atol=1e-15)


def test_never_seen_it_never_moves_and_flags_that_chatter_only_slow_it_down():
    waiting = WaitingReference(CIRCLE, PERIOD)
    rows, times = waiting.play(np.zeros(200, dtype=bool))
    np.testing.assert_array_equal(rows[:, 0], np.broadcast_to(START, (200, 3)))
    np.testing.assert_array_equal(rows[:, 1:], 0.0)
    np.testing.assert_array_equal(times, 0.0)
    _, times = waiting.play(np.arange(600) % 2 == 0)
    rate = np.diff(times[100:]) / PERIOD
    assert 0.45 < rate.min() <= rate.max() < 0.55


def test_step_and_play_agree_and_start_again():
    waiting, seen = WaitingReference(CIRCLE, PERIOD), flags(1.5, [(0.7, 0.3)])
    rows, _ = waiting.play(seen)
    waiting.start()
    np.testing.assert_array_equal(rows, [waiting.step(flag) for flag in seen.tolist()])


def test_answers_of_the_camera_hold_until_the_next_picture():
    found = flags_at([0.0, 0.05, 0.1, 0.15, 0.2, 0.3], [0.1, 0.2], [True, False])
    np.testing.assert_array_equal(found, [False, False, True, True, False, False])
    np.testing.assert_array_equal(flags_at([0.0, 1.0], [], []), [False, False])
