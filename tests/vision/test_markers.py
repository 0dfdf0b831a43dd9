"""The board is found in its own picture, and its pose with it."""

import cv2
import numpy as np
import pytest

from moc_opt.vision.board import Board
from moc_opt.vision.camera import Camera, Scene
from moc_opt.vision.markers import BoardFinder, board_picture, texture_matrix
from moc_opt.vision.pinhole import DrawnView
from moc_opt.vision.pose import Pose, rotation_from
from moc_opt.vision.settings import CameraSettings

BOARD = Board()
CLEAN = CameraSettings(source="drawn", noise=0.0, blur_px=0.0)
EYE = Camera(CLEAN, Pose(np.diag([1.0, -1.0, -1.0]), (0.6, 0.0, 0.4)))
TILTED = Pose(rotation_from((0.4, 0.2, 0.0)) @ np.diag([1.0, -1.0, -1.0]), (0.005, -0.005, 0.15))
FINDER = BoardFinder(BOARD, EYE)
SHOT = DrawnView(EYE, BOARD).picture(Scene(EYE.camera_in_base @ TILTED))


@pytest.mark.parametrize("gap_m", [0.005, 0.00437])
def test_the_printed_markers_are_where_the_geometry_says(gap_m):
    board = Board(gap_m=gap_m)
    page = cv2.copyMakeBorder(board_picture(board), 20, 20, 20, 20, cv2.BORDER_CONSTANT, value=255)
    found = BoardFinder(board, EYE).corners(page)
    assert sorted(found) == list(board.ids)
    for marker, pixels in found.items():
        there = np.column_stack([board.corners(marker)[:, :2], np.ones(4)]) @ texture_matrix(board).T
        np.testing.assert_allclose(pixels, there[:, :2] + 20, atol=0.3)


def test_the_pose_is_found():
    sighting = FINDER.find(SHOT)
    way, turn = sighting.pose.distance(TILTED)
    assert way < 1e-4
    assert turn < 1e-3
    assert sighting.markers == 20
    assert sighting.error_px < 0.4


def test_corners_are_those_of_the_projection_on_average():
    """A camera whose middle is half a pixel off would shift them all by as much."""
    found = FINDER.corners(SHOT)
    off = [
        pixels - EYE.project((EYE.camera_in_base @ TILTED).apply(BOARD.corners(m)))
        for m, pixels in found.items()
    ]
    np.testing.assert_allclose(np.mean(off, axis=(0, 1)), 0.0, atol=0.03)


def test_grey_and_colour_pictures_give_the_same():
    grey = cv2.cvtColor(SHOT, cv2.COLOR_BGR2GRAY)
    assert FINDER.find(grey).pose.distance(FINDER.find(SHOT).pose) == pytest.approx((0.0, 0.0), abs=1e-12)


def test_no_board_no_sighting():
    assert FINDER.find(np.full((480, 640, 3), 90, dtype=np.uint8)) is None
    noise = np.random.default_rng(0).integers(0, 255, (480, 640, 3)).astype(np.uint8)
    assert FINDER.find(noise) is None


def test_one_marker_is_enough_for_a_pose_though_a_poorer_one():
    scene = Scene(EYE.camera_in_base @ TILTED, frozenset(BOARD.ids) - {7})
    sighting = FINDER.find(DrawnView(EYE, BOARD).picture(scene))
    assert sighting.markers == 1
    assert sighting.pose.distance(TILTED)[0] < 3e-3


def test_markers_of_another_board_are_not_taken():
    other = BoardFinder(Board(first_id=100), EYE)
    assert other.corners(SHOT) == {}


def test_a_tool_across_a_marker_does_not_pull_the_pose():
    """A white stripe over half the corners of two markers: they are left out."""
    picture, corners = SHOT.copy(), FINDER.corners(SHOT)
    for marker in (6, 13):
        a, b = corners[marker][0], corners[marker][3]
        start, end = (np.rint(16 * (point + np.array([-1.5, 0.0]))).astype(int).tolist() for point in (a, b))
        cv2.line(picture, start, end, (0, 0, 0), 4, cv2.LINE_AA, 4)
    sighting = FINDER.find(picture)
    way, turn = sighting.pose.distance(TILTED)
    assert way < 1.5e-4
    assert turn < 1.5e-3
    assert sighting.error_px < 0.4
