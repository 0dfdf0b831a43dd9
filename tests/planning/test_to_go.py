"""V is what the best course from a pose on is worth (by enumeration), and the way to its end keeps to it."""

from __future__ import annotations

import gc
import weakref
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.model.robot_model import RobotModel
from moc_opt.planning.to_go import ToGo
from tests.conftest import Array
from tests.planning.test_search import Small, map_of, small

SEEDS = st.integers(0, 2**32 - 1)
PRICE = 0.05


def worth(found: Small, cell: Array, step: float, k: int, b: int, j: int, price: float) -> float:
    """Best sum from a pose to the end, by trying every course."""
    count, _, m = found.mu.shape
    gain = (0.5 if k in (0, count - 1) else 1.0) * found.mu[k, b, j]
    if not found.room_rad[k, b, j] >= 0.0:
        return -np.inf
    if k == count - 1:
        return float(gain)
    best = -np.inf
    for i in range(m):
        away = abs(float(found.q_rad[k + 1, b, i, 0] - found.q_rad[k, b, j, 0]))
        if away <= step + cell[k, b, j] + cell[k + 1, b, i]:
            best = max(best, worth(found, cell, step, k + 1, b, i, price) - price * away**2)
    return float(gain + best)


def cells(to_go: ToGo) -> Array:
    return np.array([to_go._poses(k).slack[..., 0] for k in range(len(to_go.map.targets))])


@given(SEEDS, st.floats(0.05, 0.6), st.sampled_from([0.0, PRICE]))
def test_no_course_from_a_pose_is_worth_more(seed: int, step: float, price: float) -> None:
    found = small(np.random.default_rng(seed), k=4, m=3)
    to_go = ToGo(found, np.array([step]), price=price)
    expected = np.array([
        [[worth(found, cells(to_go), step, k, b, j, price) for j in range(3)] for b in range(2)] for k in range(4)
    ])  # fmt: skip
    np.testing.assert_allclose(to_go.value, expected, atol=1e-12)


def test_poses_within_the_margin_are_worth_nothing() -> None:
    found = small(np.random.default_rng(1), k=4, m=6)
    to_go = ToGo(found, np.array([2.0]), margin=0.4)
    np.testing.assert_array_equal(np.isfinite(to_go.value), found.room_rad >= 0.4)
    assert 0.2 < np.isfinite(to_go.value).mean() < 0.8


@given(SEEDS, st.floats(0.3, 0.9), st.floats(0.0, 2.0), st.floats(0.1, 0.9))
def test_the_first_step_of_a_way_has_the_time_that_is_left(seed: int, step: float, price: float, late: float) -> None:
    """From within a period a joint turns by less, and the same turn is dearer: price (q' - q)^2 over the time."""
    found = small(np.random.default_rng(seed), k=4, m=6)
    to_go = ToGo(found, np.array([step]), price=price)
    way, end = to_go.way(np.array([0.5]), late, 2), 2 if late > 0.5 else 1
    poses, cell, left = found.q_rad[end, ..., 0], cells(to_go)[end], end - late
    away = np.abs(poses - 0.5)
    reached = away <= left * step + cell
    first = np.where(reached, to_go._gain[end] - price / left * away**2, -np.inf)
    if end == 2:
        total = np.where(reached, to_go.value[2] - price / left * away**2, -np.inf)
    else:
        ahead, ahead_cell = found.q_rad[2, ..., 0], cells(to_go)[2]
        turn = np.abs(ahead[:, None, :] - poses[:, :, None])
        allowed = turn <= step + cell[:, :, None] + ahead_cell[:, None, :]
        total = np.where(allowed, first[:, :, None] - price * turn**2, -np.inf).max(axis=1) + to_go.value[2]
    if not np.isfinite(total).any():
        assert way is None
        return
    assert way is not None
    times, _, b, j = way
    assert times[0] == late
    assert len(times) == 4 - end
    assert total[b, j] == pytest.approx(total.max(), abs=1e-12)


def test_it_goes_with_its_last_user() -> None:
    """A map's poses are tens of megabytes: a study of many runs must not wait for the garbage collector."""
    gc.collect()
    gc.disable()
    try:
        to_go = ToGo(small(np.random.default_rng(0), k=4, m=3), np.array([0.3]))
        gone = weakref.ref(to_go)
        del to_go
        assert gone() is None
    finally:
        gc.enable()


@cache
def on_the_arm() -> tuple[RobotModel, ToGo]:
    from moc_opt.model.robot_model import load_robot

    robot = load_robot("lwr4")
    found, step = map_of(robot, robot.data.q_home, count=40, swivels=180)
    return robot, ToGo(found, step)


@pytest.mark.parametrize("t_s", [0.0, 1.23, 3.3])
def test_a_way_keeps_to_the_map_and_its_speeds(t_s: float) -> None:
    robot, to_go = on_the_arm()
    start = to_go.way(robot.data.q_home, 0.0, 39)
    assert start is not None
    q = np.array([np.interp(t_s, start[0], joint) for joint in start[1].T])
    found = to_go.way(q, t_s, 36)
    assert found is not None
    times, poses, b, j = found
    assert times[0] == t_s
    np.testing.assert_array_equal(poses[0], q)
    np.testing.assert_array_equal(poses[-1], to_go.map.poses(36)[b, j])
    assert to_go.map.room_rad[36, b, j] >= 0.0
    most = np.diff(times)[:, None] / to_go.map.targets.period_s * to_go._step
    assert (np.abs(np.diff(poses, axis=0)) <= most + 4.0 * np.pi / 180.0).all()


def test_out_of_reach_there_is_no_way() -> None:
    robot, to_go = on_the_arm()
    assert to_go.way(robot.data.q_home + 1.0, 0.0, 3) is None


def test_near_a_pose_the_parabola_is_v() -> None:
    _, to_go = on_the_arm()
    b, j = np.unravel_index(int(np.argmax(to_go.value[20])), to_go.value.shape[1:])
    end = to_go.near(20, int(b), int(j))
    assert end.bend < 0.0, "a top is round"
    for i in range(-4, 5):
        pose, value = to_go.map.poses(20)[b, (j + i) % 180], to_go.value[20, b, (j + i) % 180]
        z = float(end.along @ (pose - end.q_rad))
        near = to_go.value[20, b, j] + end.slope * z + 0.5 * end.bend * z**2
        assert near == pytest.approx(value, rel=2e-3)
