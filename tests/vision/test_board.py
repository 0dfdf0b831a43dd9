"""Poses compose as rigid motions do; tasks on a board are the same path wherever the board lies."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import TaskError, UnknownNameError
from moc_opt.vision.board import BOARD_TASKS, Board, BoardTask, Pose, board_below, board_task, rotation_from

BOARD = Board()
VECTOR = st.tuples(*[st.floats(-2.0, 2.0)] * 3).map(np.array)
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


@given(POSE, POSE, st.floats(0.0, 1.0))
def test_blending_goes_straight_from_one_to_the_other(a, b, share):
    way, turn = a.distance(b)
    moved, turned = a.distance(a.towards(b, share))
    assert moved == pytest.approx(share * way, abs=1e-12)
    # At half a turn there are two ways round; either is of the right length.
    assert turned == pytest.approx(share * turn, abs=1e-6)
    assert a.towards(b, 1.0).distance(b) == pytest.approx((0.0, 0.0), abs=2e-6)


def test_markers_are_squares_in_rows_from_the_top_left():
    assert len(BOARD.ids) == 20
    assert BOARD.size_m == pytest.approx((0.130, 0.105))
    corners = np.array([BOARD.corners(marker) for marker in BOARD.ids])
    sides = np.linalg.norm(np.diff(corners, axis=1, append=corners[:, :1]), axis=2)
    np.testing.assert_allclose(sides, 0.020, atol=1e-15)
    # Clockwise as seen from the printed side.
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 1])[:, 2] < 0.0).all()
    first, second, below = corners[[0, 1, 5], 0]
    np.testing.assert_allclose(second - first, [0.025, 0, 0], atol=1e-15)
    np.testing.assert_allclose(below - first, [0, -0.025, 0], atol=1e-15)
    np.testing.assert_allclose(corners.mean(axis=(0, 1)), 0.0, atol=1e-15)
    np.testing.assert_allclose(BOARD.outline()[0] + [0.005, -0.005, 0], first, atol=1e-15)


@given(POSE, st.sampled_from(list(BOARD_TASKS)))
@settings(max_examples=30)
def test_a_task_is_small_enough_and_moves_with_its_board(pose, name):
    task, own = board_task(name), board_task(name).on_board()
    s = np.linspace(0.0, own.length, 200)
    places = own.at(s)[0]
    assert 0.02 <= np.ptp(places[:, :2], axis=0).max() <= 0.041
    assert 0.12 <= task.depth_m <= 0.20
    np.testing.assert_allclose(places[:, 2], task.height_m, atol=1e-15)
    carried = BOARD.task_in_base(task, pose)
    np.testing.assert_allclose(carried.at(s)[0], pose.apply(places), atol=1e-9)
    np.testing.assert_allclose(carried.at(s)[1], pose.turn(own.at(s)[1]), atol=1e-9)
    np.testing.assert_allclose(carried.normal, pose.R[:, 2], atol=1e-12)


def test_what_is_beyond_the_board_or_unknown_is_refused():
    with pytest.raises(TaskError):
        BOARD.task_in_base(BoardTask("line", {"length": 0.076}), Pose(np.eye(3), np.zeros(3)))
    with pytest.raises(UnknownNameError):
        board_task("cirle")


def test_a_phantom_lies_below_the_trocar_and_faces_it():
    trocar, shaft = np.array([0.6, 0.1, 0.2]), np.array([0.0, 0.1, -1.0])
    pose = board_below(trocar, shaft, 0.15)
    into = shaft / np.linalg.norm(shaft)
    np.testing.assert_allclose(pose.t, trocar + 0.15 * into)
    np.testing.assert_allclose(pose.R[:, 2], -into)
    np.testing.assert_allclose(pose.R[:, 0], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(pose.R.T @ pose.R, np.eye(3), atol=1e-15)
    with pytest.raises(TaskError):
        board_below(trocar, (1, 0, 0), 0.15)
