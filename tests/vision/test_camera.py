"""The camera: projection, place, calibration, its pictures of board, covers and tool, and its settings."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.vision.board import Board, Pose, rotation_from
from moc_opt.vision.camera import COVER, STEEL, TISSUE, Camera, CameraSettings, View, expose
from moc_opt.vision.tracking import BoardFinder

PHANTOM = Pose(rotation_from((0.1, 0.2, 0.3)), (0.6, 0.1, 0.05))
CAMERA = Camera.above(CameraSettings(), PHANTOM)


def test_it_stands_where_the_settings_say_and_looks_at_the_middle_of_the_phantom():
    np.testing.assert_allclose(CAMERA.project(PHANTOM.t), [[319.5, 239.5]], atol=1e-9)
    eye = PHANTOM.inverse().apply(CAMERA.camera_in_base.t)
    assert np.linalg.norm(eye) == pytest.approx(0.16)
    assert np.degrees(np.arccos(eye[2] / 0.16)) == pytest.approx(25.0)
    assert eye[1] < 0.0
    # The board's y is upwards in the picture, its x to the right.
    middle, right, up = CAMERA.project(PHANTOM.apply([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]]))
    assert right[0] > middle[0]
    assert up[1] < middle[1]


@given(st.tuples(*[st.floats(-0.5, 0.5)] * 2), st.floats(0.05, 1.0))
def test_projection_is_the_pinhole(direction, depth):
    point = CAMERA.camera_in_base.apply(depth * np.array([*direction, 1.0]))
    expected = 240 / np.tan(np.radians(25.0)) * np.array(direction) + [319.5, 239.5]
    np.testing.assert_allclose(CAMERA.project(point)[0], expected, atol=1e-6)
    assert np.isnan(CAMERA.project(CAMERA.camera_in_base.apply([0.0, 0.0, -depth]))).all()


def test_calibration_is_off_by_what_was_asked_for():
    camera = Camera.above(CameraSettings(calibration_error_m=0.002, calibration_error_deg=0.5), PHANTOM)
    one, other = (camera.miscalibrated(seed).camera_in_base for seed in (3, 4))
    assert camera.camera_in_base.distance(one) == pytest.approx((0.002, np.radians(0.5)))
    assert one.distance(other)[0] > 1e-4


def test_the_sensor_blurs_and_adds_noise():
    def exposed(picture, **settings):
        return expose(picture, CameraSettings(**settings), np.random.default_rng(0))

    picture = np.full((200, 200, 3), 128, dtype=np.uint8)
    grey = exposed(picture, noise=5.0, blur_px=0.0).astype(float)
    assert grey.std() == pytest.approx(5.0, rel=0.05)
    assert grey.mean() == pytest.approx(128.0, abs=0.2)
    picture[:, 100:] = 228
    edge = exposed(picture, noise=0.0, blur_px=2.0)[100, :, 0].astype(float)
    slope = np.diff(edge) / 100
    place = np.arange(len(slope)) - 99
    assert np.sqrt((slope * place**2).sum()) == pytest.approx(2.0, rel=0.05)
    np.testing.assert_array_equal(exposed(picture, noise=0.0, blur_px=0.0), picture)


# --- its pictures ---

BOARD = Board()
FLAT = Pose(np.eye(3), (0.6, 0.0, 0.05))
CLEAN = Camera.above(CameraSettings(noise=0.0, blur_px=0.0), FLAT)


def at(picture, camera, point):
    u, v = np.rint(camera.project(point)[0]).astype(int)
    return picture[v, u].astype(int)


def test_covered_markers_and_no_others_are_gone():
    hidden = frozenset({0, 7, 13})
    picture = View(CLEAN, BOARD).picture(FLAT, hidden)
    assert set(BoardFinder(BOARD, CLEAN).corners(picture)) == set(BOARD.ids) - hidden
    for marker in hidden:
        middle = FLAT.apply(BOARD.corners(marker).mean(axis=0))
        np.testing.assert_allclose(at(picture, CLEAN, middle), COVER, atol=1)


def test_the_tool_is_drawn_and_hides_what_is_behind_it():
    tip = FLAT.apply([0.0, 0.0, 0.005])
    other = tip + np.array([0.0, 0.0, 0.3])
    view = View(CLEAN, BOARD, shaft=lambda q: (tip, other))
    picture = view.picture(FLAT, q=np.zeros(7))
    np.testing.assert_allclose(at(picture, CLEAN, tip + np.array([0, 0, 0.01])), STEEL, atol=2)
    seen = BoardFinder(BOARD, CLEAN).corners(picture)
    assert 12 <= len(seen) < 20
    assert len(BoardFinder(BOARD, CLEAN).corners(view.picture(FLAT))) == 20


def test_a_board_is_lost_at_its_times_and_a_dark_or_turned_one_is_not_there():
    lost = Board(lost_s=((1.0, 2.0), (3.0, 4.0)))
    assert [lost.is_lost(t) for t in (0.5, 1.0, 1.99, 2.0, 3.5)] == [False, True, True, False, True]
    view, finder = View(CLEAN, BOARD), BoardFinder(BOARD, CLEAN)
    turned = Pose(np.diag([1.0, -1.0, -1.0]), FLAT.t)
    behind = Pose(np.eye(3), CLEAN.camera_in_base.apply([0.0, 0.0, -0.2]))
    for board in (None, turned, behind):
        picture = view.picture(board)
        assert finder.find(picture) is None
        assert np.abs(picture.reshape(-1, 3).astype(int) - TISSUE).max() == 0
