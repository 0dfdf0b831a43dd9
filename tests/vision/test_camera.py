"""The camera: projection, place, calibration, its pictures of board, covers and tool, and its settings."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import TaskError, UnknownNameError
from moc_opt.vision.board import BOARD_TASKS, Board, BoardTask, Pose, board_below, board_task, rotation_from
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
    picture = np.full((200, 200, 3), 128, dtype=np.uint8)
    noisy, blurred = ({"noise": 5.0, "blur_px": 0.0}, {"noise": 0.0, "blur_px": 2.0})
    grey = expose(picture, CameraSettings(**noisy), np.random.default_rng(0)).astype(float)
    assert (grey.std(), grey.mean()) == pytest.approx((5.0, 128.0), rel=0.05)
    picture[:, 100:] = 228
    slope = np.diff(expose(picture, CameraSettings(**blurred), np.random.default_rng(0))[100, :, 0].astype(float)) / 100
    assert np.sqrt((slope * (np.arange(len(slope)) - 99) ** 2).sum()) == pytest.approx(2.0, rel=0.05)


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
