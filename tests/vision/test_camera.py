"""The camera, and how the board is found and tracked."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import TaskError, UnknownNameError
from moc_opt.vision.board import BOARD_TASKS, Board, BoardTask, Pose, board_below, board_task, rotation_from
from moc_opt.vision.camera import STEEL, TISSUE, Camera, CameraSettings, View, expose, hide
from moc_opt.vision.tracking import BoardFinder, BoardTracker, Sighting, TrackerSettings

PHANTOM = Pose(rotation_from((0.1, 0.2, 0.3)), (0.6, 0.1, 0.05))
CAMERA = Camera.above(CameraSettings(), PHANTOM)


def test_camera_looks_at_the_middle_of_the_phantom():
    np.testing.assert_allclose(CAMERA.project(PHANTOM.t), [[319.5, 239.5]], atol=1e-9)
    eye = PHANTOM.inverse().apply(CAMERA.camera_in_base.t)
    assert np.linalg.norm(eye) == pytest.approx(0.16)
    assert np.degrees(np.arccos(eye[2] / 0.16)) == pytest.approx(25.0)
    assert eye[1] < 0.0
    # The board's x points to the right, and its y upwards.
    middle, right, up = CAMERA.project(PHANTOM.apply([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]]))
    assert right[0] > middle[0]
    assert up[1] < middle[1]


@given(st.tuples(*[st.floats(-0.5, 0.5)] * 2), st.floats(0.05, 1.0))
def test_projection_is_that_of_a_pinhole_camera(direction, depth):
    point = CAMERA.camera_in_base.apply(depth * np.array([*direction, 1.0]))
    expected = 240 / np.tan(np.radians(25.0)) * np.array(direction) + [319.5, 239.5]
    np.testing.assert_allclose(CAMERA.project(point)[0], expected, atol=1e-6)
    assert np.isnan(CAMERA.project(CAMERA.camera_in_base.apply([0.0, 0.0, -depth]))).all()


def test_calibration_error_has_the_size_in_the_settings():
    camera = Camera.above(CameraSettings(calibration_error_m=0.002, calibration_error_deg=0.5), PHANTOM)
    one, other = (camera.miscalibrated(seed).camera_in_base for seed in (3, 4))
    assert camera.camera_in_base.distance(one) == pytest.approx((0.002, np.radians(0.5)))
    assert one.distance(other)[0] > 1e-4


def test_sensor_blurs_and_adds_noise():
    picture = np.full((200, 200, 3), 128, dtype=np.uint8)
    noisy, blurred = CameraSettings(noise=5.0, blur_px=0.0), CameraSettings(noise=0.0, blur_px=2.0)
    grey = expose(picture, noisy, np.random.default_rng(0)).astype(float)
    assert (grey.std(), grey.mean()) == pytest.approx((5.0, 128.0), rel=0.05)
    picture[:, 100:] = 228
    slope = np.diff(expose(picture, blurred, np.random.default_rng(0))[100, :, 0].astype(float)) / 100
    assert np.sqrt((slope * (np.arange(len(slope)) - 99) ** 2).sum()) == pytest.approx(2.0, rel=0.05)


BOARD = Board()
FLAT = Pose(np.eye(3), (0.6, 0.0, 0.05))
CLEAN = Camera.above(CameraSettings(noise=0.0, blur_px=0.0), FLAT)


def test_tool_hides_what_is_behind_it():
    tip, up, finder = FLAT.apply([0.0, 0.0, 0.005]), np.array([0.0, 0.0, 1.0]), BoardFinder(BOARD, CLEAN)
    view = View(CLEAN, BOARD, shaft=lambda q: (tip, tip + 0.3 * up))
    picture = view.picture(FLAT, q=np.zeros(7))
    u, v = np.rint(CLEAN.project(tip + 0.01 * up)[0]).astype(int)
    np.testing.assert_allclose(picture[v, u].astype(int), STEEL, atol=2)
    assert 12 <= len(finder.corners(picture)) < len(finder.corners(view.picture(FLAT))) == 20


def test_board_is_lost_at_the_times_in_its_settings():
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
TURN = st.tuples(VECTOR, st.floats(0.0, np.pi)).map(lambda pair: pair[1] * pair[0] / max(np.linalg.norm(pair[0]), 1e-3))
POSE = st.builds(lambda turn, place: Pose(rotation_from(turn), place), TURN, VECTOR)


@given(POSE, POSE, VECTOR)
def test_a_product_of_poses_applies_the_second_pose_first(a, b, point):
    np.testing.assert_allclose((a @ b).apply(point), a.apply(b.apply(point)), atol=1e-12)
    np.testing.assert_allclose((a @ a.inverse()).apply(point), point, atol=1e-12)
    np.testing.assert_allclose(a.apply(np.array([point, 2 * point]))[1], a.apply(2 * point), atol=1e-12)
    np.testing.assert_allclose(a.turn(point), a.apply(point) - a.apply(np.zeros(3)), atol=1e-12)


@given(POSE, POSE, st.floats(0.0, 1.0))
def test_blending_two_poses_goes_straight_from_one_to_the_other(a, b, share):
    way, turn = a.distance(b)
    moved, turned = a.distance(a.towards(b, share))
    assert moved == pytest.approx(share * way, abs=1e-12)
    # Half a turn can go in either direction.
    assert turned == pytest.approx(share * turn, abs=1e-6)
    assert a.towards(b, 1.0).distance(b) == pytest.approx((0.0, 0.0), abs=2e-6)


def test_markers_are_squares_in_rows():
    assert (len(BOARD.ids), BOARD.size_m) == (20, pytest.approx((0.130, 0.105)))
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


def test_task_beyond_the_board_is_refused():
    with pytest.raises(TaskError):
        BOARD.task_in_base(BoardTask("line", {"length": 0.076}), Pose(np.eye(3), np.zeros(3)))
    with pytest.raises(UnknownNameError):
        board_task("cirle")


def test_phantom_faces_the_trocar():
    trocar, shaft = np.array([0.6, 0.1, 0.2]), np.array([0.0, 0.1, -1.0])
    pose = board_below(trocar, shaft, 0.15)
    into = shaft / np.linalg.norm(shaft)
    np.testing.assert_allclose(pose.t, trocar + 0.15 * into)
    np.testing.assert_allclose(pose.R[:, 2], -into)
    np.testing.assert_allclose(pose.R[:, 0], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(pose.R.T @ pose.R, np.eye(3), atol=1e-15)
    with pytest.raises(TaskError):
        board_below(trocar, (1, 0, 0), 0.15)


EYE = Camera(CLEAN.settings, Pose(np.diag([1.0, -1.0, -1.0]), (0.6, 0.0, 0.4)))
TILTED = Pose(rotation_from((0.4, 0.2, 0.0)) @ np.diag([1.0, -1.0, -1.0]), (0.005, -0.005, 0.15))
FINDER = BoardFinder(BOARD, EYE)
SHOT = View(EYE, BOARD).picture(EYE.camera_in_base @ TILTED)


def test_pose_and_corners_are_found():
    sighting = FINDER.find(SHOT)
    assert (np.array(sighting.pose.distance(TILTED)) < [1e-4, 1e-3]).all()
    assert sighting.markers == 20
    assert sighting.error_px < 0.4
    there = EYE.camera_in_base @ TILTED
    off = [pixels - EYE.project(there.apply(BOARD.corners(m))) for m, pixels in FINDER.corners(SHOT).items()]
    np.testing.assert_allclose(np.mean(off, axis=(0, 1)), 0.0, atol=0.03)


def test_pose_is_accurate_with_hidden_markers():
    """The median errors of these poses are 0.06 mm and 0.03 degrees."""
    rng, eye = np.random.default_rng(1), Camera(CameraSettings(), EYE.camera_in_base)
    view, finder, found = View(eye, BOARD, seed=1), BoardFinder(BOARD, eye), []
    for k in range(15):
        turn = rotation_from((*rng.uniform(-0.4, 0.4, 2), 0.0)) @ np.diag([1.0, -1.0, -1.0])
        spin = rotation_from((0.0, 0.0, rng.uniform(-0.8, 0.8)))
        truth = Pose(turn @ spin, (*rng.uniform(-0.01, 0.01, 2), rng.uniform(0.12, 0.20)))
        sighting = finder.find(view.picture(eye.camera_in_base @ truth, hide(BOARD.ids, 0.6, k)))
        assert sighting.markers <= 8
        found.append(sighting.pose.distance(truth))
    assert (np.median(found, axis=0) < [1e-4, np.radians(0.06)]).all()
    assert np.max(found, axis=0)[0] < 5e-4


def test_pose_from_one_marker_is_accurate_to_3_mm():
    one = FINDER.find(View(EYE, BOARD).picture(EYE.camera_in_base @ TILTED, frozenset(BOARD.ids) - {7}))
    assert one.markers == 1
    assert one.pose.distance(TILTED)[0] < 3e-3


DT = 1 / 30
HERE = Pose(rotation_from((0.3, -0.2, 0.1)), (0.0, 0.0, 0.15))
THERE = Pose(HERE.R, HERE.t + np.array([0.02, 0.0, 0.0]))


def sight(pose=HERE, markers=20, error_px=0.2):
    return Sighting(pose, markers, error_px)


def feed(tracker, sightings, start=0.0):
    return [tracker.update(start + DT * k, sighting) for k, sighting in enumerate(sightings)]


def test_board_is_found_after_several_agreeing_sightings():
    tracker = BoardTracker()
    found = feed(tracker, [None, sight(THERE), sight(), sight(), sight(), sight()])
    assert [tracked.seen for tracked in found] == [False] * 4 + [True] * 2
    assert tracker.pose.distance(HERE)[0] < 1e-12


def test_sightings_of_a_resting_board_are_averaged():
    rng = np.random.default_rng(0)
    draws = ((1e-3 * rng.standard_normal(3), 1e-4 * rng.standard_normal(3)) for _ in range(300))
    sightings = [sight(HERE @ Pose(rotation_from(turn), shift)) for turn, shift in draws]
    raw = np.median([sighting.pose.distance(HERE) for sighting in sightings], axis=0)
    smooth, last = BoardTracker(), BoardTracker(TrackerSettings(smoothing_s=0.0))
    for tracker in (smooth, last):
        feed(tracker, sightings)
    assert (np.array(smooth.pose.distance(HERE)) < 0.5 * raw).all()
    assert last.pose.distance(sightings[-1].pose) == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(
    "bad", [None, sight(markers=2), sight(error_px=5.0), sight(error_px=float("nan")), sight(THERE)]
)
def test_refused_sighting_does_not_change_the_pose(bad):
    tracker = BoardTracker()
    before = feed(tracker, [sight()] * 5)[-1].pose
    tracked = tracker.update(5 * DT, bad)
    assert tracked.seen
    assert tracked.refused
    assert tracker.pose is before


def test_pose_of_a_lost_board_is_kept():
    tracker = BoardTracker(TrackerSettings(lost_after_s=0.12))
    answers = feed(tracker, [sight()] * 5 + [None] * 6 + [sight()] * 3)
    assert [tracked.seen for tracked in answers[4:]] == [True] * 4 + [False] * 5 + [True]
    assert answers[10].pose.distance(HERE)[0] < 1e-12


def test_moved_board_is_followed_after_agreeing_sightings():
    tracker, wild = BoardTracker(), BoardTracker()
    for each in (tracker, wild):
        feed(each, [sight()] * 5)
    after = feed(tracker, [sight(THERE)] * 3, start=5 * DT)
    assert [tracked.pose.distance(THERE)[0] < 1e-9 for tracked in after] == [False, False, True]
    places = HERE.t + 0.02 * np.outer(1 + np.random.default_rng(2).permutation(20), [1, 0, 0])
    states = feed(wild, [sight(Pose(HERE.R, place)) for place in places], start=5 * DT)
    assert not states[-1].seen
    assert wild.pose.distance(HERE)[0] < 1e-12


@given(st.lists(st.sampled_from(["good", "none", "far", "bad"]), max_size=60))
def test_tracking_is_only_claimed_while_sightings_were_accepted_lately(kinds):
    limits = TrackerSettings()
    tracker, last_good = BoardTracker(limits), -np.inf
    table = {"good": sight(), "none": None, "far": sight(THERE), "bad": sight(error_px=9.0)}
    for k, kind in enumerate(kinds):
        tracked = tracker.update(DT * k, table[kind])
        last_good = DT * k if tracked.refused is None else last_good
        assert not tracked.seen or DT * k - last_good <= limits.lost_after_s
        assert tracked.pose is None or min(tracked.pose.distance(p)[0] for p in (HERE, THERE)) < 1e-9
