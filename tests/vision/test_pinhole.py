"""The drawn picture shows the board, what covers it, and the tool, where the projection puts them."""

import numpy as np
import pytest

from moc_opt.vision.board import Board
from moc_opt.vision.camera import Camera, Scene
from moc_opt.vision.markers import BoardFinder
from moc_opt.vision.pinhole import COVER, STEEL, TISSUE, DrawnView
from moc_opt.vision.pose import Pose
from moc_opt.vision.settings import CameraSettings

BOARD = Board()
PHANTOM = Pose((np.eye(3)), (0.6, 0.0, 0.05))
CAMERA = Camera.above(CameraSettings(source="drawn"), PHANTOM)
CLEAN = Camera.above(CameraSettings(source="drawn", noise=0.0, blur_px=0.0), PHANTOM)


def at(picture, camera, point):
    u, v = np.rint(camera.project(point)[0]).astype(int)
    return picture[v, u].astype(int)


def test_covered_markers_and_no_others_are_gone():
    hidden = frozenset({0, 7, 13})
    picture = DrawnView(CLEAN, BOARD).picture(Scene(PHANTOM, hidden))
    assert set(BoardFinder(BOARD, CLEAN).corners(picture)) == set(BOARD.ids) - hidden
    for marker in hidden:
        middle = PHANTOM.apply(BOARD.corners(marker).mean(axis=0))
        np.testing.assert_allclose(at(picture, CLEAN, middle), COVER, atol=1)


def test_the_tool_is_drawn_and_hides_what_is_behind_it():
    tip = PHANTOM.apply([0.0, 0.0, 0.005])
    other = tip + np.array([0.0, 0.0, 0.3])
    view = DrawnView(CLEAN, BOARD, shaft=lambda q: (tip, other))
    picture = view.picture(Scene(PHANTOM, q=np.zeros(7)))
    np.testing.assert_allclose(at(picture, CLEAN, tip + np.array([0, 0, 0.01])), STEEL, atol=2)
    seen = BoardFinder(BOARD, CLEAN).corners(picture)
    assert 12 <= len(seen) < 20
    without = view.picture(Scene(PHANTOM))
    assert len(BoardFinder(BOARD, CLEAN).corners(without)) == 20


def test_a_dark_or_turned_board_is_not_there():
    view, finder = DrawnView(CLEAN, BOARD), BoardFinder(BOARD, CLEAN)
    turned = Pose(np.diag([1.0, -1.0, -1.0]), PHANTOM.t)
    behind = Pose(np.eye(3), CLEAN.camera_in_base.apply([0.0, 0.0, -0.2]))
    for scene in (Scene(PHANTOM, dark=True), Scene(turned), Scene(behind)):
        picture = view.picture(scene)
        assert finder.find(picture) is None
        assert np.abs(picture.reshape(-1, 3).astype(int) - TISSUE).max() == 0


def test_the_same_seed_gives_the_same_picture():
    one, other, third = (DrawnView(CAMERA, BOARD, seed=seed).picture(Scene(PHANTOM)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, other)
    assert (one != third).any()
    assert one.shape == (480, 640, 3)


def test_a_tool_that_passes_the_lens_is_cut_off_and_one_behind_it_is_not_drawn():
    near = CLEAN.camera_in_base.apply([0.0, 0.02, 0.05])
    beyond = CLEAN.camera_in_base.apply([0.0, 0.0, -0.2])
    picture = DrawnView(CLEAN, BOARD, shaft=lambda q: (near, beyond)).picture(
        Scene(PHANTOM, dark=True, q=np.zeros(7))
    )
    assert (picture != np.array(TISSUE)).any()
    nothing = DrawnView(CLEAN, BOARD, shaft=lambda q: (beyond, near)).picture(
        Scene(PHANTOM, dark=True, q=np.zeros(7))
    )
    np.testing.assert_array_equal(np.unique(nothing.reshape(-1, 3), axis=0), [TISSUE])


@pytest.mark.parametrize("fraction", [0.0, 0.5])
def test_pose_accuracy_of_the_drawn_picture(fraction):
    rng = np.random.default_rng(4)
    view, finder = DrawnView(CAMERA, BOARD), BoardFinder(BOARD, CAMERA)
    truth = CAMERA.camera_in_base.inverse() @ PHANTOM
    hidden = frozenset(rng.permutation(20)[: round(20 * fraction)].tolist())
    errors = [finder.find(view.picture(Scene(PHANTOM, hidden))).pose.distance(truth) for _ in range(10)]
    way, turn = np.median(errors, axis=0)
    assert way < 1.5e-4
    assert np.degrees(turn) < 0.1
