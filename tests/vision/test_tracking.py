"""The board is found in its own picture; the tracker averages it, refuses outliers, tells losses and follows a move."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.vision.board import Board, Pose, rotation_from
from moc_opt.vision.camera import Camera, CameraSettings, View, hide
from moc_opt.vision.tracking import BoardFinder, BoardTracker, Sighting, TrackerSettings

BOARD = Board()
CLEAN = CameraSettings(noise=0.0, blur_px=0.0)
EYE = Camera(CLEAN, Pose(np.diag([1.0, -1.0, -1.0]), (0.6, 0.0, 0.4)))
TILTED = Pose(rotation_from((0.4, 0.2, 0.0)) @ np.diag([1.0, -1.0, -1.0]), (0.005, -0.005, 0.15))
FINDER = BoardFinder(BOARD, EYE)
SHOT = View(EYE, BOARD).picture(EYE.camera_in_base @ TILTED)


def test_the_pose_and_the_corners_are_found():
    """A camera whose middle is half a pixel off would shift the corners all by as much."""
    sighting = FINDER.find(SHOT)
    way, turn = sighting.pose.distance(TILTED)
    assert way < 1e-4
    assert turn < 1e-3
    assert sighting.markers == 20
    assert sighting.error_px < 0.4
    there = EYE.camera_in_base @ TILTED
    off = [pixels - EYE.project(there.apply(BOARD.corners(m))) for m, pixels in FINDER.corners(SHOT).items()]
    np.testing.assert_allclose(np.mean(off, axis=(0, 1)), 0.0, atol=0.03)


def test_single_pictures_are_accurate_with_six_of_ten_markers_hidden():
    """0.07 mm and 0.03 degrees are what such a board is good for, tilted, turned, and 12 to 20 cm away."""
    rng, eye = np.random.default_rng(1), Camera(CameraSettings(), EYE.camera_in_base)
    view, finder, found = View(eye, BOARD, seed=1), BoardFinder(BOARD, eye), []
    for k in range(15):
        turn = rotation_from((*rng.uniform(-0.4, 0.4, 2), 0.0)) @ np.diag([1.0, -1.0, -1.0])
        spin = rotation_from((0.0, 0.0, rng.uniform(-0.8, 0.8)))
        truth = Pose(turn @ spin, (*rng.uniform(-0.01, 0.01, 2), rng.uniform(0.12, 0.20)))
        sighting = finder.find(view.picture(eye.camera_in_base @ truth, hide(BOARD.ids, 0.6, k)))
        assert sighting.markers <= 8
        found.append(sighting.pose.distance(truth))
    way, angle = np.array(found).T
    assert np.median(way) < 1e-4
    assert np.median(np.degrees(angle)) < 0.06
    assert way.max() < 5e-4


def test_without_a_marker_there_is_no_sighting_and_one_is_enough_for_a_poorer_pose():
    assert FINDER.find(np.full((480, 640, 3), 90, dtype=np.uint8)) is None
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


def noisy(rng, pose=HERE, way=1e-4, turn=1e-3):
    return sight(pose @ Pose(rotation_from(turn * rng.standard_normal(3)), way * rng.standard_normal(3)))


def test_it_takes_several_sightings_that_agree_to_find_a_board():
    tracker = BoardTracker()
    found = feed(tracker, [None, sight(THERE), sight(), sight(), sight(), sight()])
    assert [tracked.seen for tracked in found] == [False] * 4 + [True] * 2
    assert tracker.pose.distance(HERE)[0] < 1e-12


def test_a_resting_board_is_averaged_and_without_smoothing_every_sighting_is_taken():
    rng = np.random.default_rng(0)
    sightings = [noisy(rng) for _ in range(300)]
    raw = np.median([sighting.pose.distance(HERE) for sighting in sightings], axis=0)
    smooth, last = BoardTracker(), BoardTracker(TrackerSettings(smoothing_s=0.0))
    for tracker in (smooth, last):
        feed(tracker, sightings)
    assert (np.array(smooth.pose.distance(HERE)) < 0.5 * raw).all()
    assert last.pose.distance(sightings[-1].pose) == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(
    "bad", [None, sight(markers=2), sight(error_px=5.0), sight(error_px=float("nan")), sight(THERE)]
)
def test_outliers_change_nothing(bad):
    tracker = BoardTracker()
    feed(tracker, [sight()] * 5)
    before = tracker.pose
    tracked = tracker.update(5 * DT, bad)
    assert tracked.seen
    assert tracked.refused
    assert tracker.pose is before


def test_a_lost_board_is_told_after_a_while_and_its_pose_is_kept():
    tracker = BoardTracker(TrackerSettings(lost_after_s=0.12))
    feed(tracker, [sight()] * 5)
    last = 4 * DT
    answers = {k: tracker.update(last + DT * k, None) for k in range(1, 7)}
    assert [answers[k].seen for k in range(1, 7)] == [True] * 3 + [False] * 3
    assert answers[6].pose.distance(HERE)[0] < 1e-12
    again = feed(tracker, [sight()] * 3, start=last + 7 * DT)
    assert [tracked.seen for tracked in again] == [False, False, True]


def test_a_moved_board_is_followed_once_enough_sightings_agree_and_never_where_they_disagree():
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
