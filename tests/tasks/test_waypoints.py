"""Paths through waypoints: through every point, smooth, by arc length."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import TaskError
from moc_opt.tasks import Reference, Waypoints, curves

AXES = {"normal": [0.0, 0.0, 1.0], "heading": [1.0, 0.0, 0.0]}
START = [0.5, -0.1, 0.2]
STEPS = st.lists(st.tuples(*[st.floats(-0.01, 0.01)] * 3), min_size=1, max_size=8)


def walk(steps):
    """Points that go ahead by 1 to 3 cm a step: no cusp."""
    return np.cumsum(np.add(steps, (0.02, 0.0, 0.0)), axis=0)


@settings(max_examples=20)
@given(STEPS)
def test_it_goes_through_every_point_at_unit_speed_and_bends_smoothly(steps):
    points = walk(steps)
    path = Waypoints(points, START, **AXES)
    s = np.linspace(0.0, path.length, 1001)
    p, tangent, bend = path.at(s)
    np.testing.assert_allclose(p[0], START, atol=1e-12)
    np.testing.assert_allclose(p[-1], START + points[-1], atol=1e-9)
    for point in points:
        assert np.linalg.norm(p - (START + point), axis=1).min() < path.length / 1000
    np.testing.assert_allclose(np.linalg.norm(tangent, axis=1), 1.0, atol=1e-9)
    step = s[1] - s[0]
    np.testing.assert_allclose((p[2:] - p[:-2]) / (2 * step), tangent[1:-1], atol=1e-3)
    np.testing.assert_allclose((tangent[2:] - tangent[:-2]) / (2 * step), bend[1:-1], atol=5e-2 * (1 + abs(bend).max()))
    np.testing.assert_allclose(np.sum(tangent * bend, axis=1), 0.0, atol=1e-9 * (1 + abs(bend).max()))
    assert abs(np.diff(bend, axis=0)).max() < 0.2 * (1 + abs(bend).max())  # no corner in the curvature


def test_points_are_in_the_axes_of_the_path_and_one_is_a_straight_line():
    path = Waypoints([[0.01, 0.02, 0.03]], np.zeros(3), normal=[1, 0, 0], heading=[0, 0, 2])
    end, _, bend = path.at(path.length)
    np.testing.assert_allclose(end, [0.03, -0.02, 0.01], atol=1e-12)  # left = normal x heading
    np.testing.assert_allclose(path.at(0.5 * path.length)[0], 0.5 * end, atol=1e-12)
    np.testing.assert_allclose(bend, 0.0, atol=1e-12)


def test_a_circle_s_points_give_almost_the_circle():
    angle = np.linspace(0.0, 2 * np.pi, 41)
    path = Waypoints(0.03 * np.stack([np.sin(angle), 1 - np.cos(angle), 0 * angle], axis=1), START, **AXES)
    assert path.length == pytest.approx(2 * np.pi * 0.03, rel=1e-4)
    assert path.curvature(path.length / 2) == pytest.approx(1 / 0.03, rel=1e-2)


def test_the_time_law_keeps_its_limits():
    path = Waypoints(walk([[0.0, 0.01, 0.0], [0.0, -0.01, 0.01], [0.0, 0.01, 0.01]]), START, **AXES)
    reference = Reference(path, 0.05, 0.2)
    _, dx, ddx = reference.at(np.linspace(0.0, reference.duration, 1500))
    assert np.linalg.norm(dx, axis=1).max() <= 0.05 * (1 + 1e-9)
    fastest = np.linalg.norm(ddx, axis=1).max()
    assert fastest <= 0.2 * (1 + 1e-6)
    assert fastest > 0.198 or np.linalg.norm(dx, axis=1).max() > 0.0498


def test_a_table_of_arc_length_does_not_grow_with_the_number_of_points(monkeypatch):
    monkeypatch.setattr(curves, "_MOST_PANELS", 2**10)
    asked = []

    def speed(w):
        asked.append(w.size)
        return 1.0 + 0.5 * np.sign(np.sin(1e9 * w)), np.zeros_like(w)  # no table holds it

    with pytest.raises(TaskError, match="cannot be tabulated"):
        curves.ArcLength(speed, np.linspace(0.0, 1.0, 33), 2**4)
    assert 2**9 < max(asked) <= 10 * 2**10  # ten places a panel
