"""The search is the best of all courses on the map (by enumeration), keeps limits and speeds, and its bound holds."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pytest

from moc_opt.model.robot_model import RobotModel
from moc_opt.planning.climb import climb
from moc_opt.planning.course import OBJECTIVES, Course, Objective, make_course
from moc_opt.planning.pose_map import PoseMap, SphericalMap, spherical_map
from moc_opt.planning.search import half_cells, search
from moc_opt.planning.search_kernels import advance, boxes
from moc_opt.planning.spherical import branch_of, spherical
from moc_opt.planning.targets import Targets, lay_targets
from moc_opt.planning.to_go import spread
from moc_opt.tasks import Reference, Trocar, make_path
from tests.conftest import Array


@dataclass(frozen=True, eq=False)
class Small(PoseMap):
    """A map of a one-joint arm, small enough to try every course."""

    q_rad: Array

    def poses(self, k: int) -> Array:
        return self.q_rad[k]


def small(rng: np.random.Generator, k: int = 5, m: int = 4) -> Small:
    targets = Targets(np.arange(float(k)), np.zeros((k, 3)), np.zeros((k, 3)), np.zeros(k))
    room = rng.uniform(-0.2, 1.0, (k, 2, m))
    return Small(targets, rng.uniform(0.1, 1.0, (k, 2, m)), room, rng.uniform(0.0, 1.0, (k, 2, m, 1)))


def value(mu: Array, objective: Objective) -> float:
    if objective == "worst":
        return float(mu.min())
    gain, weight = (mu if objective == "mean" else np.log(mu)), np.ones(len(mu))
    weight[[0, -1]] = 0.5
    return float(weight @ gain / weight.sum())


def every_course(found: Small, step: float, start: float | None) -> list[Array]:
    """mu of each course that keeps limits and speed, without any dynamic programming."""
    k, branches, m = found.mu.shape
    courses = []
    for b in range(branches):
        for way in itertools.product(range(m), repeat=k):
            q = np.array([found.q_rad[i, b, j, 0] for i, j in enumerate(way)])
            allowed = np.array([found.room_rad[i, b, j] >= 0.0 for i, j in enumerate(way)])
            mu = np.array([found.mu[i, b, j] for i, j in enumerate(way)])
            if start is not None:
                q[0], allowed[0], mu[0] = start, True, 0.4
            if allowed.all() and np.abs(np.diff(q)).max() <= step:
                courses.append(mu)
    return courses


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("start", [None, 0.5])
def test_the_best_of_all_courses_is_found(objective: Objective, start: float | None) -> None:
    rng, none = np.random.default_rng(0), 0
    for _ in range(25):
        found, step = small(rng), float(rng.uniform(0.1, 0.8))
        courses = every_course(found, step, start)
        begin = None if start is None else (np.array([start]), 0.4)
        answer = search(found, np.array([step]), objective, start=begin)
        if not courses:
            none += 1
            assert answer.q_rad is None
            assert answer.reached < 5
            continue
        best = max(value(mu, objective) for mu in courses)
        assert answer.value == pytest.approx(best, abs=1e-12)
        assert answer.q_rad is not None
        assert np.abs(np.diff(answer.q_rad[:, 0])).max() <= step
        if objective == "worst":  # of those with the best worst mu, the best mean
            rest = [mu for mu in courses if mu.min() >= best - 1e-12]
            mu = _mu_of(found, answer.q_rad, start)
            assert value(mu, "mean") == pytest.approx(max(value(each, "mean") for each in rest), abs=1e-9)
    assert 0 < none < 25


def _mu_of(found: Small, q: Array, start: float | None) -> Array:
    mu = [float(found.mu[k][found.q_rad[k, ..., 0] == each][0]) for k, each in enumerate(q[:, 0]) if k or start is None]
    return np.array(mu if start is None else [0.4, *mu])


# --- on the arm ---


def task(robot: RobotModel, q: Array, count: int, radius: float = 0.03) -> Targets:
    state = robot.state(q)
    path = make_path("circle", state.tip, normal=(0.0, 0.0, 1.0), heading=(1.0, 0.0, 0.0), radius=radius)
    trocar = Trocar(state.tip - 0.15 * state.tool_direction)
    return lay_targets(Reference(path, 0.05, 0.2, t_start=0.2), trocar, state.tool_span, 5.0, count)


def map_of(robot: RobotModel, q: Array, count: int = 60, swivels: int = 180) -> tuple[SphericalMap, Array]:
    arm, targets = spherical(robot), task(robot, q, count)
    assert arm is not None
    return spherical_map(robot, arm, targets, swivels=swivels), robot.v_max * targets.period_s


def course_of(robot: RobotModel, found: SphericalMap, q: Array | None) -> Course:
    assert q is not None
    return make_course(robot, found.targets, q)


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_a_course_keeps_the_task_limits_and_speeds_and_lies_below_its_bound(
    robot: RobotModel, objective: Objective
) -> None:
    q = robot.data.q_home
    found, step = map_of(robot, q)
    for start in ((q, robot.state(q).mu), None):
        answer = search(found, step, objective, start=start)
        course = course_of(robot, found, answer.q_rad)
        assert course.violation < 1e-12
        assert course.value(objective) == pytest.approx(answer.value, abs=1e-12)
        bound = search(found, step, objective, start=start, generous=True)
        assert answer.value <= bound.value < answer.value + 0.05 * abs(answer.value)
        if start is not None:
            np.testing.assert_array_equal(course.q_rad[0], q)


def test_courses_of_finer_maps_stay_below_the_coarse_bound(robot: RobotModel) -> None:
    """The bound is one on every course, also on those whose poses the map does not have."""
    q = robot.data.q_home
    start = (q, robot.state(q).mu)
    coarse, step = map_of(robot, q, swivels=90)
    fine, _ = map_of(robot, q, swivels=1440)
    for begin in (start, None):
        bound = search(coarse, step, "mean", start=begin, generous=True).value
        best = search(fine, step, "mean", start=begin).value
        assert best <= bound
        assert best >= search(coarse, step, "mean", start=begin).value - 1e-4


def test_halving_the_grid_moves_the_course_by_less_than_half_a_percent(robot: RobotModel) -> None:
    q = robot.data.q_home
    values = []
    for count, swivels in ((61, 360), (121, 720)):
        found, step = map_of(robot, q, count, swivels)
        values.append(search(found, step, "mean", start=(q, robot.state(q).mu)).value)
    assert values[1] == pytest.approx(values[0], rel=0.005)


def test_ways_into_other_branches_are_those_of_the_bits_that_each_pose_has() -> None:
    """Random bits, so that poses of one block differ in them; and what is told leads to the value."""
    rng = np.random.default_rng(3)
    for _ in range(60):
        m, m0, step = int(rng.integers(1, 50)), int(rng.integers(1, 50)), np.array([0.1, 0.3])
        q, before = rng.uniform(0.0, 1.0, (8, m, 2)), rng.uniform(0.0, 1.0, (8, m0, 2))
        q[rng.random((8, m)) < 0.2] = np.nan
        gain, value_before = rng.random((8, m)), rng.random((8, m0))
        crossing, price = rng.integers(0, 8, m) * (rng.random(m) < 0.4), float(rng.choice([0.0, 2.0]))
        away = np.abs(q[:, :, None, None] - before[None, None])
        bits = np.bitwise_xor.outer(np.arange(8), np.arange(8))
        allowed = (bits[:, None] & ~crossing[None, :, None]) == 0
        near = (away <= step).all(axis=-1) & allowed[..., None]
        ways = np.where(near, value_before + gain[:, :, None, None] - price * (away**2).sum(axis=-1), -np.inf)
        ways = ways.reshape(8, m, -1)
        slacks = [np.zeros_like(each) for each in (before, q)]
        value, back = np.empty((8, m)), np.empty((8, m), dtype=np.int32)
        low, high = boxes(q, slacks[1])
        spread(before, slacks[0], value_before, q, slacks[1], low, high, gain, step, crossing, price, value, back)
        np.testing.assert_allclose(value, ways.max(axis=2), atol=1e-12)
        led = np.take_along_axis(ways, np.maximum(back, 0)[..., None].astype(np.int64), axis=2)[..., 0]
        np.testing.assert_allclose(led[back >= 0], value[back >= 0], atol=1e-12)


@pytest.mark.parametrize("generous", [False, True])
def test_passing_over_whole_blocks_leaves_no_way_out(robot: RobotModel, generous: bool) -> None:
    """Every pose against every other, in branches of its own and next to it, without boxes."""
    rng, reached, crossed = np.random.default_rng(7), 0, 0
    for q_start in [robot.data.q_home, *(robot.random_regular_pose(rng, margin=0.2) for _ in range(3))]:
        found, step = map_of(robot, q_start, count=30, swivels=90)
        for k in (1, 15, 29):
            before, q, crossing = found.poses(k - 1), found.poses(k), found.crossing(k, step)
            slacks = [half_cells(each) if generous else np.zeros_like(each) for each in (before, q)]
            value_before, gain = (np.where(rng.random((8, 90)) < 0.3, -np.inf, rng.random((8, 90))) for _ in range(2))
            ways = np.full((8, 90, 8, 90), -np.inf)  # into branch and swivel, from branch and swivel
            for b, b0 in itertools.product(range(8), range(8)):
                apart = np.abs(q[b][:, None] - before[b0][None])
                near = (apart <= step + slacks[1][b][:, None] + slacks[0][b0][None]).all(axis=2)
                near &= ((b ^ b0) & ~crossing == 0)[:, None]
                crossed += near.sum() if b != b0 else 0
                ways[b, :, b0] = np.where(near, value_before[b0] + gain[b][:, None], -np.inf)
            best = ways.reshape(8, 90, -1).max(axis=2)
            given, boxed = (before, slacks[0], value_before, q, slacks[1]), boxes(q, slacks[1])
            kernels = (advance, (gain, step, crossing, False)), (spread, (*boxed, gain, step, crossing, 0.0))
            for kernel, more in kernels:
                value, back = np.empty((8, 90)), np.empty((8, 90), dtype=np.int32)
                kernel(*given, *more, value, back)
                np.testing.assert_array_equal(value, best)
                np.testing.assert_array_equal(back >= 0, np.isfinite(best))
            reached += np.isfinite(best).sum()
    assert reached > 1000
    assert crossed > 0


def test_a_margin_costs_mu_and_is_kept(robot: RobotModel) -> None:
    q = robot.data.q_home
    found, step = map_of(robot, q)
    free, kept = (search(found, step, margin=margin) for margin in (0.0, 0.4))
    assert kept.q_rad is not None
    room = np.minimum(kept.q_rad - robot.q_min, robot.q_max - kept.q_rad)[:, :6].min()
    assert room >= 0.4 - 1e-9
    assert kept.value <= free.value


def test_the_climb_is_a_course_and_no_better_than_the_best(robot: RobotModel) -> None:
    rng = np.random.default_rng(11)
    seen = 0
    for q in [robot.data.q_home, *(robot.random_regular_pose(rng, margin=0.2) for _ in range(14))]:
        found, step = map_of(robot, q)
        best = search(found, step, start=(q, robot.state(q).mu))
        if best.q_rad is None:
            continue
        climbed = course_of(robot, found, climb(found, step, q))
        assert climbed.violation < 1e-12
        np.testing.assert_array_equal(climbed.q_rad[0], q)
        if len(climbed.mu) == len(found.targets):
            seen += 1
            assert climbed.mu_mean <= best.value + 1e-12
            # where the path rests (0.2 s) it only goes uphill
            assert (np.diff(climbed.mu[: int(0.2 / found.targets.period_s)]) >= -1e-12).all()
    assert seen > 2


@pytest.mark.parametrize("joint", [1, 5])
def test_a_course_goes_through_a_singular_pose_into_the_next_branch(robot: RobotModel, joint: int) -> None:
    """The targets are those of a joint turning through zero: that motion itself is a course."""
    arm = spherical(robot)
    assert arm is not None
    t = 0.025 * np.arange(41)
    way = np.tile(np.array([0.3, 0.5, -0.4, 1.2, 0.5, -0.7, 0.0]), (41, 1))
    way[:, joint] = np.linspace(0.45, -0.47, 41) * (1.0 if joint == 1 else -1.0)
    tips, wrists = robot.tool_along(way)
    targets = Targets(t, tips, wrists, np.linalg.norm(tips - tips[0], axis=1))
    found = spherical_map(robot, arm, targets, swivels=720)
    start, step = (way[0], float(robot.state(way[0]).mu)), robot.v_max * 0.025
    answer, climbed = search(found, step, start=start), climb(found, step, way[0])
    course = course_of(robot, found, answer.q_rad)
    assert course.violation < 1e-12
    assert course_of(robot, found, climbed).violation < 1e-12
    if joint == 1:  # the other one gains by going round
        assert branch_of(arm, course.q_rad[0]) != branch_of(arm, course.q_rad[-1])
    assert course.mu_mean > 0.995 * make_course(robot, targets, way).mu_mean
    bound = search(found, step, start=start, generous=True)
    assert make_course(robot, targets, way).mu_mean <= bound.value


def test_a_path_that_leaves_the_reach_is_blocked_there(robot: RobotModel) -> None:
    state = robot.state(robot.data.q_home)
    t = 0.05 * np.arange(40)
    away = np.linspace(0.0, 0.8, 40)[:, None] * state.tool_direction
    targets = Targets(t, state.tip - away, state.wrist - away, away[:, 2])
    arm = spherical(robot)
    assert arm is not None
    found = spherical_map(robot, arm, targets, swivels=180)
    answer = search(found, robot.v_max * 0.05)
    first = int(np.argmin(np.isfinite(found.mu[:, 0, 0])))
    assert answer.q_rad is None
    assert 0 < answer.reached <= max(first, 1)
