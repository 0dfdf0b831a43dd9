"""The quintic time law, shortest durations, references that wait, and the moving trocar."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from moc_opt.tasks import CURVES, Path, Reference, Trocar, duration, quintic, shaft_distance
from moc_opt.tasks.timelaw import WaitingReference, flags_at
from tests.tasks.test_paths import START, build, size

# The curvature changes slowly, so that dense samples come close to its maximum.
curved = st.one_of(
    st.builds(lambda r: build("circle", radius=r), size),
    st.builds(lambda a, w, n: build("sinusoid", amplitude=a * w, wavelength=w, periods=n),
              st.floats(0.01, 0.6), size, st.floats(0.2, 6.0)),
    st.builds(lambda n, r: build("spiral", turns=n, radius=r), st.floats(0.1, 8.0), size),
)  # fmt: skip


@given(st.floats(0.01, 0.99))
@settings(max_examples=40)
def test_the_quintic_starts_and_ends_at_rest_and_its_derivatives_are_finite_differences(u: float) -> None:
    assert [quintic(x) for x in (0.0, 0.5, 1.0)] == [(0.0, 0.0, 0.0), (0.5, 1.875, 0.0), (1.0, 0.0, 0.0)]
    h = 1e-5
    (s0, ds0, _), (s1, ds1, _) = quintic(u - h), quintic(u + h)
    _, ds, dds = quintic(u)
    assert (s1 - s0) / (2.0 * h) == pytest.approx(ds, abs=1e-8)
    assert (ds1 - ds0) / (2.0 * h) == pytest.approx(dds, abs=1e-7)


@settings(max_examples=40)
@given(st.floats(1e-4, 10.0), st.floats(1e-3, 10.0), st.floats(1e-3, 100.0))
@example(0.1, 0.05, 100.0)
@example(0.1, 10.0, 0.05)
def test_the_duration_of_a_line_is_the_closed_form(length: float, v_max: float, a_max: float) -> None:
    expected = max(15.0 * length / (8.0 * v_max), math.sqrt(10.0 * length / (math.sqrt(3.0) * a_max)))
    assert duration(build("line", length=length), v_max, a_max) == pytest.approx(expected, rel=1e-14)


def extremes(reference: Reference, count: int) -> tuple[float, float]:
    t = reference.t_start + np.linspace(0.0, reference.duration, count)
    _, dx, ddx = reference.at(t)
    speed, acceleration = np.linalg.norm(dx, axis=1).max(), np.linalg.norm(ddx, axis=1).max()
    return float(speed) / reference.v_max, float(acceleration) / reference.a_max


@settings(max_examples=30)
@given(curved, st.floats(0.01, 1.0), st.floats(0.01, 10.0))
def test_the_duration_of_a_curve_reaches_one_limit_and_exceeds_none(path: Path, v_max: float, a_max: float) -> None:
    used = extremes(Reference(path, v_max, a_max), 20_001)
    assert max(used) <= 1.0 + 1e-9
    assert max(used) >= 1.0 - 1e-2


@pytest.mark.parametrize(("kind", "sizes"), [
    ("sinusoid", {"amplitude": 0.1, "wavelength": 0.01, "periods": 1.5}), ("sinusoid", {"periods": 60.0}),
    ("spiral", {"turns": 50.0, "radius": 0.05}),
])  # fmt: skip
def test_duration_keeps_the_limits_at_sharp_bends(kind: str, sizes: dict[str, float]) -> None:
    used = extremes(Reference(build(kind, **sizes), 100.0, 0.5), 30_001)
    assert 1.0 - 5e-3 <= max(used) <= 1.0 + 1e-9


@pytest.mark.parametrize("kind", CURVES)
def test_velocity_and_acceleration_are_derivatives(kind: str) -> None:
    path = build(kind)
    reference = Reference(path, 0.1, 0.3, t_start=0.5)
    end, h = 0.5 + reference.duration, 1e-5 * reference.duration
    t = 0.5 + reference.duration * np.linspace(0.02, 0.98, 60)
    (x0, v0, _), (x1, v1, _), (_, v, a) = reference.at(t - h), reference.at(t + h), reference.at(t)
    np.testing.assert_allclose((x1 - x0) / (2.0 * h), v, atol=1e-6 * 0.1)
    np.testing.assert_allclose((v1 - v0) / (2.0 * h), a, atol=1e-5 * 0.3)
    for times, place in (((-5.0, 0.0, 0.5), 0.0), ((end, 1e6, math.inf), path.length)):
        for time in times:
            x, dx, ddx = reference.at(time)
            np.testing.assert_allclose(x, path.at(place)[0], atol=1e-15)
            np.testing.assert_allclose(np.concatenate((dx, ddx)), 0.0, atol=1e-12)


PERIOD = 0.01
REFERENCES = {kind: Reference(build(kind), 0.05, 0.2) for kind in CURVES}
CIRCLE = Reference(build("circle", radius=0.02), 0.05, 0.2)
BRAKE_S = 0.05 / 0.2  # shortest braking time


def flags(seconds, losses):
    """Return for each tick whether the camera sees the marker board. `losses`: (start, duration) of the gaps [s]."""
    t = PERIOD * np.arange(round(seconds / PERIOD))
    seen = np.ones(len(t), dtype=bool)
    for start, length in losses:
        seen[(t >= start) & (t < start + length)] = False
    return seen


LOSSES = st.lists(st.tuples(st.floats(0.0, 5.0), st.floats(0.0, 1.5)), max_size=4)


@given(st.sampled_from(list(REFERENCES)), LOSSES)
@settings(max_examples=30)
def test_position_speed_and_acceleration_are_continuous_and_bounded(kind, losses):
    waiting = WaitingReference(original := REFERENCES[kind], PERIOD)
    v_bound, a_bound = original.v_max, 2.0 * original.a_max
    rows, times = waiting.play(flags(6.0, losses))
    x, dx, ddx = rows[:, 0], rows[:, 1], rows[:, 2]
    slack = 1 + 1e-9
    assert np.linalg.norm(dx, axis=1).max() <= v_bound * slack
    assert np.linalg.norm(ddx, axis=1).max() <= a_bound * slack
    assert np.linalg.norm(np.diff(x, axis=0), axis=1).max() <= v_bound * PERIOD * slack
    second = np.diff(x, 2, axis=0) / PERIOD**2
    assert np.linalg.norm(second, axis=1).max() <= a_bound * (1 + 1e-4)
    # `steps` is about the largest change of `ddx` from one tick to the next [m/s^2].
    steps = v_bound * PERIOD / (0.5 * BRAKE_S**2)
    assert np.abs(second - ddx[1:-1]).max() < 0.01 + 1.2 * steps
    middle = np.diff(x, axis=0) / PERIOD - 0.5 * (dx[1:] + dx[:-1])
    assert np.abs(middle).max() < 5e-4
    assert (np.diff(times) >= 0.0).all()
    assert (np.diff(times) <= PERIOD * slack).all()


@given(LOSSES)
@settings(max_examples=15)
def test_a_waiting_reference_stays_on_the_path_and_arrives(losses):
    waiting, seen = WaitingReference(CIRCLE, PERIOD), flags(16.0, losses)
    rows, times = waiting.play(seen)
    np.testing.assert_allclose(rows[::50, 0], CIRCLE.at(times[::50])[0], atol=1e-12)
    assert times[-1] >= 16.0 - PERIOD * (~seen).sum() - waiting.settle_s - 2 * PERIOD
    assert times[-1] >= CIRCLE.t_start + CIRCLE.duration
    np.testing.assert_allclose(rows[-1, 0], START, atol=1e-9)
    np.testing.assert_array_equal(rows[-1, 1:], 0.0)


def test_reference_rests_while_no_board_is_seen():
    waiting = WaitingReference(CIRCLE, PERIOD)
    rows, times = waiting.play(np.zeros(200, dtype=bool))
    np.testing.assert_array_equal(rows[:, 0], np.broadcast_to(START, (200, 3)))
    np.testing.assert_array_equal(rows[:, 1:], 0.0)
    np.testing.assert_array_equal(times, 0.0)
    _, times = waiting.play(np.arange(600) % 2 == 0)  # seen at every second tick: half the speed
    rate = np.diff(times[100:]) / PERIOD
    assert 0.45 < rate.min() <= rate.max() < 0.55


def test_tick_has_the_flag_of_the_latest_picture():
    found = flags_at([0.0, 0.05, 0.1, 0.15, 0.2, 0.3], [0.1, 0.2], [True, False])
    np.testing.assert_array_equal(found, [False, False, True, True, False, False])
    np.testing.assert_array_equal(flags_at([0.0, 1.0], [], []), [False, False])


POINT = (0.5, 0.1, 0.2)
points = arrays(np.float64, 3, elements=st.floats(-1.0, 1.0))


def test_breathing_moves_the_trocar_back_and_forth() -> None:
    given = np.array(POINT)
    trocar = Trocar(given, breathing_amplitude_m=0.01, breathing_period_s=5.0, direction=(0.0, 3.0, 4.0))
    given[:] = 0.0  # the trocar has a copy
    away = 0.01 * np.array([0.0, 0.6, 0.8])
    for t, part in ((0.0, 0.0), (1.25, 0.5), (2.5, 1.0), (5.0, 0.0), (7.5, 1.0)):
        np.testing.assert_allclose(trocar.at(t)[0], POINT + part * away, atol=1e-15)


@settings(max_examples=40)
@given(st.floats(-20.0, 20.0), st.floats(0.0, 0.05), st.floats(1.0, 10.0), points.filter(np.any))
def test_trocar_velocity_is_the_derivative(t: float, amplitude: float, period: float, direction: np.ndarray) -> None:
    trocar = Trocar(POINT, amplitude, period, direction)
    h = 1e-4
    slope = (trocar.at(t + h)[0] - trocar.at(t - h)[0]) / (2 * h)
    np.testing.assert_allclose(slope, trocar.at(t)[1], atol=1e-8)
    assert np.linalg.norm(trocar.at(t)[0] - POINT) <= amplitude * (1.0 + 1e-12) + 1e-15


@settings(max_examples=40)
@given(points, points, points, points, st.floats(0.01, 3.0))
def test_shaft_distance_is_the_distance_of_a_point_from_a_line(tip, tool, p, shift, stretch):
    length = np.linalg.norm(tool)
    if length < 1e-3:
        return
    wrist = tip - tool
    d, u = shaft_distance(tip, wrist, p), tool / length
    assert d == pytest.approx(np.linalg.norm(np.cross(p - tip, u)), abs=1e-12)
    # The distance depends on neither shift nor stretch.
    assert shaft_distance(tip + shift, tip - stretch * tool + shift, p + shift) == pytest.approx(d, abs=1e-11)
    rows = shaft_distance([tip, tip + shift], [wrist, wrist + shift], p)
    np.testing.assert_allclose(rows, [d, shaft_distance(tip + shift, wrist + shift, p)], rtol=1e-14)
    assert shaft_distance(tip, wrist, tip - 0.3 * tool) == pytest.approx(0.0, abs=1e-13)
