"""The tracker averages a board at rest, refuses outliers, tells losses, and finds a moved board."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.errors import PlantError, TaskError
from moc_opt.vision.pose import Pose, rotation_from
from moc_opt.vision.settings import TrackerSettings
from moc_opt.vision.tracking import BoardTracker, Sighting, TrackingState

DT = 1 / 30
HERE = Pose(rotation_from((0.3, -0.2, 0.1)), (0.0, 0.0, 0.15))
THERE = Pose(HERE.R, HERE.t + np.array([0.02, 0.0, 0.0]))


def sight(pose=HERE, markers=20, error_px=0.2):
    return Sighting(pose, markers, error_px)


def feed(tracker, sightings, start=0.0):
    return [tracker.update(start + DT * k, sighting) for k, sighting in enumerate(sightings)]


def noisy(rng, pose=HERE, way=1e-4, turn=1e-3):
    return sight(pose @ Pose(rotation_from(turn * rng.standard_normal(3)), way * rng.standard_normal(3)))


def test_it_takes_several_sightings_to_find_a_board():
    states = [tracked.state for tracked in feed(BoardTracker(), [None, sight(), sight(), sight(), sight()])]
    assert [state.value for state in states] == ["searching"] * 3 + ["tracking"] * 2


def test_a_single_wrong_sighting_finds_nothing():
    tracker = BoardTracker()
    seen = feed(tracker, [sight(THERE), sight(HERE), sight(HERE), sight(HERE)])
    assert [tracked.seen for tracked in seen] == [False, False, False, True]
    assert tracker.pose.distance(HERE)[0] < 1e-12


def test_a_resting_board_is_averaged():
    rng = np.random.default_rng(0)
    tracker, single = BoardTracker(), []
    for k in range(300):
        sighting = noisy(rng)
        single.append(sighting.pose.distance(HERE))
        tracker.update(DT * k, sighting)
    raw_way, raw_turn = np.median(single, axis=0)
    way, turn = tracker.pose.distance(HERE)
    assert way < 0.5 * raw_way
    assert turn < 0.5 * raw_turn


def test_without_smoothing_every_sighting_is_taken():
    tracker = BoardTracker(TrackerSettings(smoothing_s=0.0))
    rng = np.random.default_rng(1)
    sightings = [noisy(rng) for _ in range(6)]
    feed(tracker, sightings)
    assert tracker.pose.distance(sightings[-1].pose) == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (None, "no marker"),
        (sight(markers=2), "2 markers seen, 3 needed"),
        (sight(error_px=5.0), r"fit 5\.00 px"),
        (sight(error_px=float("nan")), "fit nan"),
        (sight(THERE), "far from the estimate"),
    ],
)
def test_outliers_change_nothing(bad, reason):
    tracker = BoardTracker()
    feed(tracker, [sight()] * 5)
    before = tracker.pose
    tracked = tracker.update(5 * DT, bad)
    assert tracked.seen
    assert reason.replace("\\", "") in tracked.refused
    assert tracker.pose is before


def test_a_lost_board_is_told_after_a_while_and_its_pose_is_kept():
    tracker = BoardTracker(TrackerSettings(lost_after_s=0.12))
    feed(tracker, [sight()] * 5)
    last = 4 * DT
    answers = {k: tracker.update(last + DT * k, None) for k in range(1, 7)}
    assert [answers[k].state is TrackingState.TRACKING for k in range(1, 7)] == [True] * 3 + [False] * 3
    assert answers[6].state is TrackingState.LOST
    assert answers[6].pose.distance(HERE)[0] < 1e-12
    again = feed(tracker, [sight()] * 3, start=last + 7 * DT)
    assert [tracked.seen for tracked in again] == [False, False, True]


def test_a_moved_board_is_followed_once_enough_sightings_agree():
    tracker = BoardTracker()
    feed(tracker, [sight()] * 5)
    after = feed(tracker, [sight(THERE)] * 3, start=5 * DT)
    assert [tracked.pose.distance(THERE)[0] < 1e-9 for tracked in after] == [False, False, True]


def test_sightings_that_disagree_never_move_the_estimate():
    tracker = BoardTracker()
    feed(tracker, [sight()] * 5)
    rng = np.random.default_rng(2)
    wild = [sight(Pose(HERE.R, HERE.t + 0.02 * np.array([k, 0, 0]))) for k in 1 + rng.permutation(20)]
    states = feed(tracker, wild, start=5 * DT)
    assert states[-1].state is TrackingState.LOST
    assert tracker.pose.distance(HERE)[0] < 1e-12


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


def test_time_must_rise():
    tracker = BoardTracker()
    tracker.update(1.0, None)
    for t in (1.0, 0.5, float("nan")):
        with pytest.raises(TaskError, match="t = "):
            tracker.update(t, None)


@pytest.mark.parametrize(
    "field",
    [{"min_markers": 0}, {"found_after": 1.5}, {"jump_m": 0.0}, {"smoothing_s": -1.0}, {"lost_after_s": 0.0}],
)
def test_bad_limits_name_the_field(field):
    with pytest.raises(PlantError, match=next(iter(field))):
        TrackerSettings(**field)
