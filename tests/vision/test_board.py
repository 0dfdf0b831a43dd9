"""The board's geometry, and tasks that are the same path wherever the board lies."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import TaskError, UnknownNameError
from moc_opt.vision.board import BOARD_TASKS, Board, BoardTask, board_below, board_task
from moc_opt.vision.pose import Pose, rotation_from

BOARD = Board()
SMALL = st.floats(-1.0, 1.0)
POSE = st.builds(
    lambda w, t: Pose(rotation_from(w), t), st.tuples(SMALL, SMALL, SMALL), st.tuples(SMALL, SMALL, SMALL)
)


def test_markers_are_squares_in_rows_from_the_top_left():
    assert len(BOARD.ids) == 20
    assert BOARD.size_m == pytest.approx((0.130, 0.105))
    for marker in BOARD.ids:
        corners = BOARD.corners(marker)
        sides = np.linalg.norm(np.diff(corners, axis=0, append=corners[:1]), axis=1)
        np.testing.assert_allclose(sides, 0.020, atol=1e-15)
        # Clockwise as seen from the printed side.
        assert np.cross(corners[1] - corners[0], corners[2] - corners[1])[2] < 0.0
    first, second, below = (BOARD.corners(marker)[0] for marker in (0, 1, 5))
    np.testing.assert_allclose(second - first, [0.025, 0, 0], atol=1e-15)
    np.testing.assert_allclose(below - first, [0, -0.025, 0], atol=1e-15)
    everything = np.concatenate([BOARD.corners(marker) for marker in BOARD.ids])
    np.testing.assert_allclose(everything.mean(axis=0), 0.0, atol=1e-15)
    np.testing.assert_allclose(BOARD.outline()[0] + [0.005, -0.005, 0], first, atol=1e-15)


@pytest.mark.parametrize("name", list(BOARD_TASKS))
def test_presets_fit_the_abdomen(name):
    task = board_task(name)
    path = task.on_board()
    places = path.at(np.linspace(0, path.length, 500))[0]
    extent = np.ptp(places[:, :2], axis=0)
    assert 0.02 <= extent.max() <= 0.041
    assert 0.12 <= task.depth_m <= 0.20
    np.testing.assert_allclose(places[:, 2], task.height_m, atol=1e-15)


@given(POSE, st.sampled_from(list(BOARD_TASKS)))
@settings(max_examples=30)
def test_a_task_moves_with_its_board(pose, name):
    own = board_task(name).on_board()
    carried = BOARD.task_in_base(name, pose)
    s = np.linspace(0.0, own.length, 20)
    np.testing.assert_allclose(carried.at(s)[0], pose.apply(own.at(s)[0]), atol=1e-9)
    np.testing.assert_allclose(carried.at(s)[1], pose.turn(own.at(s)[1]), atol=1e-9)
    np.testing.assert_allclose(carried.normal, pose.R[:, 2], atol=1e-12)


def test_a_heading_turns_the_task_on_the_board():
    straight = BoardTask("line", {"length": 0.03}, heading_deg=90.0)
    np.testing.assert_allclose(straight.on_board().at(0.03)[0], [0.0, 0.03, 0.005], atol=1e-15)


def test_a_task_beyond_its_board_is_refused():
    with pytest.raises(TaskError):
        BOARD.task_in_base(BoardTask("line", {"length": 0.076}), Pose())


def test_an_unknown_task_is_refused():
    with pytest.raises(UnknownNameError):
        board_task("cirle")


def test_a_phantom_lies_below_the_trocar_and_faces_it():
    trocar, shaft = np.array([0.6, 0.1, 0.2]), np.array([0.1, 0.0, -1.0])
    pose = board_below(trocar, shaft, 0.15, x_axis=(0, 1, 0))
    into = shaft / np.linalg.norm(shaft)
    np.testing.assert_allclose(pose.t, trocar + 0.15 * into)
    np.testing.assert_allclose(pose.R[:, 2], -into)
    np.testing.assert_allclose(pose.R[:, 0], [0, 1, 0], atol=1e-15)
    with pytest.raises(TaskError):
        board_below(trocar, (1, 0, 0), 0.15)
