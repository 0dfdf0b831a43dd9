"""The search finds the course with the largest mean mu within the limits."""

import itertools
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from moc_opt.planning.course import Limits, Targets, make_course
from moc_opt.planning.plan import best_course, climb, top_of
from moc_opt.planning.pose_map import PoseMap, map_of
from moc_opt.planning.search import WHOLE_CELL, Value, advance, keeping_shaft, shaft_shares
from tests.planning.arms import at_poses, task


def small(rng, k=4, m=4):
    """A random map of one joint, at k points in time that are 0.5 s apart."""
    arm: Any = SimpleNamespace(v_max=np.full(1, 2.0), state=lambda q: SimpleNamespace(mu=0.4))
    targets = Targets(0.5 * np.arange(k), np.zeros((k, 3)), np.zeros((k, 3)), np.zeros(k))
    q, mu = rng.uniform(0.0, 1.0, (k, 1, m, 1)), rng.uniform(0.1, 1.0, (k, 1, m))
    return PoseMap(arm, targets, q, mu, rng.uniform(-0.2, 1.0, (k, 1, m)))


def every_course(found, step, start, cell=0.0):
    k, _, m = found.mu.shape
    courses, may = [], found.room_rad >= 0.0
    cells = 0.5 * cell * np.maximum(*(np.abs(np.roll(found.q_rad, to, axis=2) - found.q_rad) for to in (1, -1)))[..., 0]
    for indices in itertools.product(range(m), repeat=k if start is None else k - 1):
        at = [(i + k - len(indices), 0, j) for i, j in enumerate(indices)]
        if not all(may[place] for place in at):
            continue
        q, mu, slack = (np.array([of[place] for place in at]) for of in (found.q_rad[..., 0], found.mu, cells))
        if start is not None:
            q, mu, slack = np.append(start, q), np.append(0.4, mu), np.append(0.0, slack)
        if (np.abs(np.diff(q)) <= step + slack[1:] + slack[:-1]).all():
            courses.append((q, mu))
    return courses


@pytest.mark.parametrize(("start", "cell", "price"), [(None, 0, 0), (0.5, 0, 0), (0.5, 0.5, 0), (0.5, 0, 1)])
def test_dynamic_programming_finds_the_best_of_all_courses(start, cell, price):
    """With a price on speed, each of the three steps (dq [rad] in 0.5 s) lowers mean mu by price (dq / 0.5)^2 / 3."""
    rng, none = np.random.default_rng(0), 0
    for _ in range(40):
        found, step = small(rng), float(rng.uniform(0.1, 0.8))
        courses = every_course(found, step, start, cell)
        value = Value(found, Limits(speed_share=step), cell=cell, price=price)
        claimed = value.best()[0] if start is None else value.of(np.array([start]), 0.4)
        q = best_course(value, None if start is None else np.array([start]))
        if not courses:
            none += 1
            assert (q, claimed) == (None, -np.inf)
            continue
        worths = [(np.trapezoid(mu) - price * (np.diff(poses / 0.5) ** 2).sum()) / 3.0 for poses, mu in courses]
        assert price or claimed == pytest.approx(max(worths), abs=1e-12)
        taken = [each for each, (poses, _) in zip(worths, courses, strict=True) if np.array_equal(poses, q[:, 0])]
        assert taken == [pytest.approx(max(worths), abs=1e-12)]
    assert none < 15


@pytest.mark.parametrize(("t_s", "first", "end", "hurry"), [
    (0.0, 1, -1, 1.0), (0.7, 2, -1, 1.2), (0.22, 1, 4, 1.0), (1.3, 3, 3, 1.0),
])  # fmt: skip
def test_course_from_any_time_goes_to_the_best_pose_in_reach(t_s, first, end, hurry):
    rng = np.random.default_rng(2)
    for _ in range(20):
        found, q = small(rng, k=6, m=9), [np.array([0.5])]
        value = Value(found, Limits(speed_share=0.3), price=0.2)
        times = np.append(t_s, 0.5 * np.arange(6)[first : 6 if end < 0 else end + 1])
        for k, dt in enumerate(np.diff(times), start=first):
            away = np.abs(found.q_rad[k, 0, :, 0] - q[-1])
            gain = np.where(away <= hurry * 0.3 * dt / 0.5, value.value[k, 0] - 0.2 * away**2 / dt, -np.inf)
            q.append(found.q_rad[k, 0, int(np.argmax(gain))] if gain.max() > -np.inf else np.full(1, np.nan))
        way = value.way(q[0], t_s, end, hurry)
        assert (way is None) == np.isnan(q[-1][0])
        if way is not None:
            np.testing.assert_equal((way.t_s, way.q_rad), (times, np.array(q)))
            assert found.q_rad[first + len(times) - 2][way.last] == q[-1]


def test_one_step_of_dynamic_programming_tries_every_pose_in_reach():
    rng = np.random.default_rng(3)
    for trial in range(40):
        rounded = (lambda x: np.rint(8.0 * x) / 8.0) if trial % 4 > 1 else np.array
        m, m1, step = int(rng.integers(1, 50)), int(rng.integers(1, 50)), rounded(np.array([0.1, 0.3]))
        q, after = rounded(rng.uniform(0.0, 1.0, (8, m, 2))), rounded(rng.uniform(0.0, 1.0, (8, m1, 2)))
        q[rng.random((8, m)) < 0.2] = np.nan
        slack, slack_after = (rounded(rng.uniform(0.0, 0.1, each.shape)) * (trial % 2) for each in (q, after))
        gain, rest = rng.random((8, m)), np.where(rng.random((8, m1)) < 0.3, -np.inf, rng.random((8, m1)))
        crossing, price = rng.integers(0, 8, m) * (rng.random(m) < 0.4), float(rng.choice([0.0, 2.0]))
        away = np.abs(q[:, :, None, None] - after[None, None])
        bits = np.bitwise_xor.outer(np.arange(8), np.arange(8))
        allowed = (bits[:, None] & ~crossing[None, :, None]) == 0
        near = (away <= step + slack[:, :, None, None] + slack_after[None, None]).all(axis=-1) & allowed[..., None]
        best = np.where(near, rest - price * (away**2).sum(axis=-1), -np.inf).reshape(8, m, -1).max(axis=2)
        value = advance(q, slack, gain, after, slack_after, rest, step, crossing, price)
        np.testing.assert_allclose(value, best + gain, atol=1e-12)


def test_upper_bound_uses_the_largest_mu_within_half_the_distance_to_the_neighbouring_poses():
    angles, mu = 2.0 * np.pi * np.arange(16) / 16, lambda angle: 1.0 + 0.5 * np.cos(angle - 0.1)
    angles[8] = np.nan  # a sample without a pose
    room = np.isin(np.arange(16), (0, 4, 9)) - 0.5
    q, mus, rooms = (np.tile(each, (2, 1, 1)) for each in (angles, mu(angles), room))
    found = replace(small(np.random.default_rng(0), k=2), q_rad=q[..., None], mu=mus, room_rad=rooms)
    bound = 4.0 * Value(found, Limits(), cell=1.0).value[-1, 0]  # trapezoidal rule: the last weight is 0.25 s
    assert np.flatnonzero(np.isfinite(bound)).tolist() == [0, 1, 3, 4, 5, 8, 9, 10, 15]
    most = mu(angles + np.linspace(-0.5, 0.5, 21)[:, None] * angles[1]).max(axis=0)
    assert np.abs((bound - most)[[0, 1, 3, 4, 5, 10, 15]] - 0.01).max() <= 0.01, "at most 0.02 above the largest mu"
    assert bound[8] >= mu(angles[7]) > mu(angles[9])


@pytest.mark.parametrize("j", [0, 77, 199])
def test_the_fitted_parabola_is_exact_for_a_quadratic_value_function(j):
    """200 poses lie on a circle of radius 1 rad. Each has six neighbours within 0.2 rad on either side."""
    at, base = 2.0 * np.pi * np.arange(200) / 200, small(np.random.default_rng(0), 2)
    two: Any = SimpleNamespace(v_max=np.ones(2))
    q, z = np.transpose([0.3 + np.cos(at), np.sin(at)]), np.sin(at - at[j])
    for dead, low, high, bend in (
        ((), -6, 6, -3.0), ((-6, -4, 3, 6), -3, 2, -3.0), ((-2, 3), -1, 2, 3.0), ((-2, 2), -1, 1, 0.0),
    ):  # fmt: skip
        slope, room = 0.4 * bool(bend), np.ones((2, 1, 200))  # bend = 0: only three poses, so no parabola is fitted
        room[..., (j + np.array(dead, dtype=int)) % 200] = -1.0
        mu = 4.0 * np.tile(0.3 + 0.4 * z + 0.5 * bend * z**2, (2, 1, 1))  # the last weight is 0.25 s
        found = replace(base, robot=two, q_rad=np.tile(q, (2, 1, 1, 1)), mu=mu, room_rad=room)
        expected = [*q[j], -q[j, 1], q[j, 0] - 0.3, slope, min(bend, 0.0), *z[(j + np.array([low, high])) % 200]]
        np.testing.assert_allclose(np.hstack(Value(found, Limits()).near(1, (0, j))), expected, atol=1e-9)
    few = np.s_[:, :, j % 10 :: 10]
    sparse = Value(replace(found, q_rad=found.q_rad[few], mu=mu[few], room_rad=room[few]), Limits())
    np.testing.assert_array_equal(np.hstack(sparse.near(1, (0, j // 10))), [*q[j], *6 * [0.0]], "no other pose is near")


def test_climb_of_mu_starts_towards_the_higher_neighbour():
    found = replace(small(np.random.default_rng(0), k=1, m=5), mu=np.array([[[0.2, 0.5, 0.6, 0.1, 0.3]]]))
    found = replace(found, q_rad=0.1 * np.arange(5.0).reshape(1, 1, 5, 1), room_rad=np.ones((1, 1, 5)))
    assert [top_of(found, np.array([at]))[::2] for at in (0.1, 0.2, 0.3)] == [(0.6, False)] * 3
    walled = replace(found, room_rad=np.array([[[1.0, 1.0, -1.0, 1.0, 1.0]]]))  # the pose of largest mu is infeasible
    assert [top_of(walled, np.array([at]))[::2] for at in (0.0, 0.3)] == [(0.5, True), (0.3, False)]


@pytest.fixture(scope="module")
def coarse(robot):
    return map_of(robot, robot.data.q_home, task(robot, robot.data.q_home, 60), 180)


def test_courses_keep_all_limits_and_do_not_exceed_the_bound(robot, coarse):
    q = robot.data.q_home
    value, bound = (Value(coarse, Limits(), cell=cell) for cell in (0.0, WHOLE_CELL))
    for start in (q, None):
        poses = best_course(value, start)
        course = make_course(robot, coarse.targets, poses)
        assert course.violation < 1e-12
        claimed, most = (v.best()[0] if start is None else v.of(q, robot.state(q).mu) for v in (value, bound))
        assert course.mu_mean == pytest.approx(claimed, abs=1e-12)
        assert claimed <= most < claimed + 0.05 * abs(claimed)
        if start is not None:
            np.testing.assert_array_equal(course.q_rad[0], q)
    for share in (0.1, 0.2, 1.0):
        limits = Limits(speed_share=share)
        climbed = make_course(robot, coarse.targets, climb(coarse, q, limits), limits)
        assert (climbed.violation < 1e-12, climbed.q_rad[0].tolist()) == (True, q.tolist())
        assert climbed.mu_mean <= value.of(q, robot.state(q).mu) + 1e-12
        assert (np.diff(climbed.mu[: int(0.2 / coarse.targets.period_s)]) >= -1e-12).all(), "mu falls at the start"


@pytest.mark.parametrize("joint", [1, 5])
def test_search_finds_a_course_as_good_as_one_through_a_singular_pose(robot, joint):
    given = np.tile(np.array([0.3, 0.5, -0.4, 1.2, 0.5, -0.7, 0.0]), (41, 1))
    given[:, joint] = np.linspace(0.45, -0.47, 41) * (1.0 if joint == 1 else -1.0)
    found = map_of(robot, given[0], at_poses(robot, given))
    mean = make_course(robot, found.targets, given).mu_mean
    poses = best_course(Value(found, Limits()), given[0])
    course = make_course(robot, found.targets, poses)
    assert course.violation < 1e-12
    if joint == 1:  # this course passes the singular pose; with joint = 5, a course around that pose is better
        assert np.sign(course.q_rad[0, 1]) != np.sign(course.q_rad[-1, 1])
    assert course.mu_mean > 0.995 * mean
    assert mean <= Value(found, Limits(), cell=WHOLE_CELL).of(given[0], robot.state(given[0]).mu)


def test_mu_is_lowered_at_poses_with_a_shaft_share_below_the_margin(robot, coarse):
    margin = 0.5
    found = map_of(robot, robot.data.q_home, coarse.targets[:10], 90)
    kept, may = keeping_shaft(found, Limits(shaft=margin)), found.feasible()
    states = [robot.state(pose) for pose in found.q_rad[may]]
    share = np.array([state.mu_shaft / state.tool_span**2 for state in states])
    np.testing.assert_allclose(shaft_shares(robot, found.q_rad[may]), share, atol=1e-7)
    price = 10.0 * np.nanmax(found.mu) * np.maximum(1.0 - share / margin, 0.0) ** 2
    np.testing.assert_allclose(found.mu[may] - kept.mu[may], price, atol=1e-5)
    assert (price > 0.0).any()
    assert keeping_shaft(found, Limits()) is found
