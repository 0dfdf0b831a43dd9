"""The moving trocar and the distance of the shaft from it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from moc_opt.tasks import Trocar, shaft_distance

POINT = (0.5, 0.1, 0.2)
points = arrays(np.float64, 3, elements=st.floats(-1.0, 1.0))


def test_breathing_goes_there_and_back() -> None:
    trocar = Trocar(POINT, breathing_amplitude_m=0.01, breathing_period_s=5.0, direction=(0.0, 3.0, 4.0))
    away = 0.01 * np.array([0.0, 0.6, 0.8])
    for t, part in ((0.0, 0.0), (1.25, 0.5), (2.5, 1.0), (5.0, 0.0), (7.5, 1.0)):
        np.testing.assert_allclose(trocar.at(t)[0], POINT + part * away, atol=1e-15)
    for t in (0.0, 2.5, 5.0):
        np.testing.assert_allclose(trocar.at(t)[1], 0.0, atol=1e-15)
    np.testing.assert_allclose(trocar.at(1.25)[1], away * math.pi / 5.0, rtol=1e-12, atol=1e-18)


@settings(max_examples=40)
@given(st.floats(-20.0, 20.0), st.floats(0.0, 0.05), st.floats(1.0, 10.0), points.filter(np.any))
def test_velocity_is_the_derivative(t: float, amplitude: float, period: float, direction: np.ndarray) -> None:
    trocar = Trocar(POINT, amplitude, period, direction)
    h = 1e-4
    slope = (trocar.at(t + h)[0] - trocar.at(t - h)[0]) / (2 * h)
    np.testing.assert_allclose(slope, trocar.at(t)[1], atol=1e-8)
    assert np.linalg.norm(trocar.at(t)[0] - POINT) <= amplitude * (1.0 + 1e-12) + 1e-15


@settings(max_examples=40)
@given(points, points, points, points, st.floats(0.01, 3.0))
def test_distance_is_geometry(
    tip: np.ndarray, tool: np.ndarray, p: np.ndarray, shift: np.ndarray, stretch: float
) -> None:
    length = np.linalg.norm(tool)
    if length < 1e-3:
        return
    wrist = tip - tool
    d, u = shaft_distance(tip, wrist, p), tool / length
    assert d == pytest.approx(np.linalg.norm(np.cross(p - tip, u)), abs=1e-12)
    # The distance knows neither where the world's origin is nor where on the shaft the wrist sits.
    assert shaft_distance(tip + shift, tip - stretch * tool + shift, p + shift) == pytest.approx(d, abs=1e-11)
    # A point on the shaft has none.
    assert shaft_distance(tip, wrist, tip - 0.3 * tool) == pytest.approx(0.0, abs=1e-13)


def test_rows_are_single_points() -> None:
    rng = np.random.default_rng(11)
    tip, wrist, p = rng.normal(size=(3, 20, 3))
    rows = shaft_distance(tip, wrist, p)
    singly = [shaft_distance(*each) for each in zip(tip, wrist, p, strict=True)]
    np.testing.assert_allclose(rows, singly, rtol=1e-14)
    np.testing.assert_array_equal(shaft_distance(tip, wrist, p[0]), shaft_distance(tip, wrist, np.tile(p[0], (20, 1))))
