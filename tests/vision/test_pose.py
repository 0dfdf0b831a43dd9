"""Poses compose, invert and blend as rigid motions do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.errors import TaskError
from moc_opt.vision.pose import Pose, looking_at, rotation_from, rotation_vector

COORDINATE = st.floats(-2.0, 2.0)
VECTOR = st.tuples(COORDINATE, COORDINATE, COORDINATE).map(np.array)
TURN = st.tuples(VECTOR, st.floats(0.0, np.pi)).map(
    lambda pair: pair[1] * pair[0] / max(np.linalg.norm(pair[0]), 1e-3)
)
POSE = st.builds(lambda turn, place: Pose(rotation_from(turn), place), TURN, VECTOR)


@given(POSE, POSE, VECTOR)
def test_a_chain_of_poses_takes_points_from_right_to_left(a, b, point):
    np.testing.assert_allclose((a @ b).apply(point), a.apply(b.apply(point)), atol=1e-12)
    np.testing.assert_allclose((a @ a.inverse()).apply(point), point, atol=1e-12)
    np.testing.assert_allclose(a.apply(np.array([point, 2 * point]))[1], a.apply(2 * point), atol=1e-12)
    np.testing.assert_allclose(a.turn(point), a.apply(point) - a.apply(np.zeros(3)), atol=1e-12)


@given(TURN)
def test_rotation_vector_is_the_inverse_of_rodrigues(turn):
    rotation = rotation_from(turn)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation_from(rotation_vector(rotation)), rotation, atol=1e-7)
    assert np.linalg.norm(rotation_vector(rotation)) == pytest.approx(np.linalg.norm(turn), abs=2e-6)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8)])
def test_half_a_turn_has_an_axis_too(axis):
    found = rotation_vector(rotation_from(np.pi * np.array(axis)))
    assert abs(found @ axis) == pytest.approx(np.pi)


@given(POSE, POSE, st.floats(0.0, 1.0))
def test_blending_goes_straight_from_one_to_the_other(a, b, share):
    way, turn = a.distance(b)
    between = a.towards(b, share)
    moved, turned = a.distance(between)
    assert moved == pytest.approx(share * way, abs=1e-12)
    # At half a turn there are two ways round; either is of the right length.
    assert turned == pytest.approx(share * turn, abs=1e-6)
    assert a.towards(b, 1.0).distance(b) == pytest.approx((0.0, 0.0), abs=2e-6)


@given(VECTOR, VECTOR)
def test_a_camera_looks_at_its_target(eye, target):
    way = target - eye
    if np.linalg.norm(np.cross(way, (0, 0, 1))) < 1e-3:
        return
    camera = looking_at(eye, target, (0.0, 0.0, 1.0))
    np.testing.assert_allclose(camera.inverse().apply(target), [0, 0, np.linalg.norm(way)], atol=1e-12)
    assert camera.R[2, 1] < 0.0  # the picture's y goes down, so up is up


@pytest.mark.parametrize("rotation", [np.eye(2), 2 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan)])
def test_no_rotation_no_pose(rotation):
    with pytest.raises(TaskError):
        Pose(rotation, (0, 0, 0))


def test_bad_views_are_refused():
    with pytest.raises(TaskError):
        looking_at((0, 0, 1), (0, 0, 0), (0, 0, 1))
    with pytest.raises(TaskError):
        looking_at((0, 0, 1), (0, 0, 1), (1, 0, 0))


def test_a_long_chain_stays_a_rotation():
    step, pose = Pose(rotation_from((0.1, 0.2, 0.3)), (0.001, 0.0, 0.0)), Pose()
    for _ in range(2000):
        pose = pose @ step
    assert np.abs(pose.R @ pose.R.T - np.eye(3)).max() < 1e-14
