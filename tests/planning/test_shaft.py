"""The shaft's share is the model's own, poses below the margin are left where there is a way, no course is lost."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import TaskError
from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.planning.course import Objective, make_course
from moc_opt.planning.plan import Plan, make_plan, map_of
from moc_opt.planning.refine import refine
from moc_opt.planning.search import gain_of
from moc_opt.planning.shaft import WORTH, keeping_shaft, lowered, shaft_shares
from moc_opt.planning.targets import Targets
from moc_opt.scenario import Scenario
from moc_opt.scenario.planned import layout_of, targets_of
from tests.conftest import Array
from tests.planning.test_search import task

MARGIN = 0.2


@cache
def arm(name: str) -> RobotModel:
    return load_robot(name)


def share_of(robot: RobotModel, q: Array) -> float:
    state = robot.state(q)
    return state.mu_shaft / state.tool_span**2


@given(name=st.sampled_from(["lwr4", "panda", "gen3", "lwr4_rail"]), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_shares_are_the_models_and_the_programs(name: str, seed: int) -> None:
    """Of the compiled kernel, of the model's state, and of the symbolic function that the programs are given."""
    robot = arm(name)
    q = np.random.default_rng(seed).uniform(robot.q_min, robot.q_max)
    wanted = share_of(robot, q)
    assert shaft_shares(robot, np.array([q, np.full(robot.n, np.nan), q])) == pytest.approx(
        [wanted, np.nan, wanted], abs=1e-9, nan_ok=True
    )
    assert float(robot.kinematics().shaft(q)) == pytest.approx(wanted**2, abs=1e-9)


def start(robot: RobotModel, seed: int) -> Array:
    return robot.random_regular_pose(np.random.default_rng(seed))


@cache
def planned(seed: int, margin: float, objective: Objective = "mean", refined: bool = False) -> tuple[Plan, Array]:
    """The plan and the shares along its course."""
    robot = arm("lwr4")
    q = start(robot, seed)
    plan = make_plan(
        robot, q, task(robot, q, 60), objective, swivels=360, shaft_margin=margin, refined=refined, elsewhere=False
    )
    assert plan.from_start is not None
    return plan, shaft_shares(robot, plan.from_start.q_rad)


def test_the_map_is_lowered_below_the_margin_alone_and_the_more_the_further() -> None:
    robot = arm("lwr4")
    q = start(robot, 15)
    found = map_of(robot, q, task(robot, q, 5), 90)
    assert keeping_shaft(found, robot, 0.0) is found
    lowered = keeping_shaft(found, robot, MARGIN)
    off = found.mu - lowered.mu
    for k in range(5):
        for branch in found.poses(k):
            shares = shaft_shares(robot, branch)
            np.testing.assert_array_equal(off[k, 0] == 0.0, ~(shares < MARGIN))
            low = shares < MARGIN
            part = WORTH * np.nanmax(found.mu) * (1.0 - shares[low] / MARGIN) ** 2
            np.testing.assert_allclose(off[k, 0][low], part, rtol=1e-9)
            order = np.argsort(shares)
            assert (np.diff(off[k, 0][order]) <= 1e-12).all()


def test_the_logarithm_is_lowered_by_the_same_price_however_small_mu_is() -> None:
    """Taken off mu itself, the price would leave every pose far below the margin the same smallest logarithm."""
    robot = arm("lwr4")
    q = start(robot, 15)
    found = map_of(robot, q, task(robot, q, 5), 90)
    with np.errstate(invalid="ignore"):
        price = np.log(found.mu) - gain_of(keeping_shaft(found, robot, 1.0, "log").mu, "log")
    for k in range(5):
        for branch in range(found.mu.shape[1]):
            shares = shaft_shares(robot, found.poses(k)[branch])
            there = ~np.isnan(found.mu[k, branch])
            np.testing.assert_allclose(price[k, branch][there], WORTH * (1.0 - shares[there]) ** 2, atol=1e-9)


def test_courses_are_compared_by_the_price_of_their_objective() -> None:
    robot = arm("lwr4")
    course, shares = planned(15, 1.0)[0].from_start, planned(15, 1.0)[1]
    assert course is not None
    price = WORTH * (1.0 - shares) ** 2
    np.testing.assert_allclose(lowered(course, robot, 1.0, 0.3).mu, course.mu - 0.3 * price)
    np.testing.assert_allclose(lowered(course, robot, 1.0, 0.3, "log").mu, course.mu * np.exp(-price))


@pytest.mark.parametrize("seed", [12, 15, 27])
def test_a_course_keeps_the_margin_where_there_is_a_way(seed: int) -> None:
    """From these starts the best course loses the shaft almost, and another stays well above."""
    (free, lost), (kept, held) = planned(seed, 0.0), planned(seed, MARGIN)
    assert free.from_start is not None
    assert kept.from_start is not None
    assert lost.min() < 0.3 * MARGIN
    assert held.min() > 0.95 * MARGIN
    assert kept.from_start.mu_mean < free.from_start.mu_mean


@pytest.mark.parametrize("objective", ["mean", "log"])
def test_a_margin_that_no_course_keeps_leaves_one_that_is_as_little_below_as_can_be(objective: Objective) -> None:
    robot = arm("lwr4")
    (free, below), (kept, less) = planned(15, 0.0, objective), planned(15, 1.0, objective)
    assert kept.executable == free.executable
    assert less.max() < 1.0
    assert ((1.0 - less) ** 2).mean() < ((1.0 - below) ** 2).mean()
    assert less.min() == pytest.approx(min(share_of(robot, start(robot, 15)), less[1:].min()))


def test_the_best_worst_mu_is_found_where_every_pose_near_the_start_is_far_below_the_margin() -> None:
    """There mu less what is taken off is far below zero; it blocks no way that the mean objective has."""
    robot = arm("lwr4")
    q = start(robot, 12)
    found = keeping_shaft(map_of(robot, q, task(robot, q, 5), 90), robot, 1.0)
    assert np.nanmin(found.mu) < -1.0
    for objective in ("mean", "worst"):
        plan = make_plan(
            robot, q, found.targets, objective, swivels=90, shaft_margin=1.0, refined=False, elsewhere=False
        )
        assert plan.executable, objective


@pytest.mark.parametrize("smoothness", [0.0, 1e-4])
def test_refinement_takes_the_margin_as_the_search_does(smoothness: float) -> None:
    """mu is higher below the margin here: without it the program goes there."""
    robot = arm("lwr4")
    plan, shares = planned(10, MARGIN)
    course = plan.from_start
    assert course is not None
    free = refine(robot, plan.targets, course, smoothness=smoothness)
    kept = refine(robot, plan.targets, course, smoothness=smoothness, shaft_margin=MARGIN)
    assert kept is not course
    assert kept.kept
    floor = np.minimum(shares, MARGIN)
    assert (shaft_shares(robot, free.q_rad) - floor).min() < -0.03
    assert (shaft_shares(robot, kept.q_rad) - floor).min() > -0.012, "a little below, where mu rises there"
    most = float(course.mu.max())
    begun, with_it, without = (lowered(each, robot, MARGIN, most).mu_mean for each in (course, kept, free))
    assert with_it > without
    assert with_it > (0.95 if smoothness else 1.0) * begun
    assert kept.mu_mean < free.mu_mean


def held(robot: RobotModel, q: Array, times: int) -> Targets:
    (tip,), (wrist,) = robot.tool_along(q[None])
    return Targets(0.2 * np.arange(times), np.tile(tip, (times, 1)), np.tile(wrist, (times, 1)), np.zeros(times))


@pytest.mark.parametrize("objective", ["worst", "log"])
def test_every_objective_has_the_price(objective: Objective) -> None:
    """mu rises below the margin; without the price the program goes far below, and its answer is not taken."""
    robot, margin = arm("lwr4"), 0.015
    q = np.array([-1.2843, -0.1638, -2.9671, 0.0758, 0.984, -1.449, -1.9038])
    q = np.clip(q, robot.q_min + 1e-6, robot.q_max - 1e-6)
    targets = held(robot, q, 4)
    still = make_course(robot, targets, np.tile(q, (4, 1)))
    found = refine(robot, targets, still, objective, free_start=True, shaft_margin=margin)
    assert found is not still
    assert 0.9 * margin < shaft_shares(robot, found.q_rad).min() < 1.05 * margin


def test_the_worst_objective_leaves_a_start_that_loses_the_shaft() -> None:
    """The start is the worst pose, whatever comes: smoothness must not hold the arm there."""
    robot, margin = arm("lwr4"), 0.04375
    q = start(robot, 20)
    targets = held(robot, q, 10)
    led = refine(robot, targets, make_course(robot, targets, np.tile(q, (10, 1))), shaft_margin=margin)
    calm = refine(robot, targets, led, "worst", shaft_margin=margin, smoothness=1e-4)
    assert shaft_shares(robot, led.q_rad)[-1] > 1.5 * shaft_shares(robot, q[None])[0]
    assert shaft_shares(robot, calm.q_rad)[-1] > 0.9 * shaft_shares(robot, led.q_rad)[-1]


def test_a_course_that_breaks_a_constraint_is_mended_below_the_margin_too() -> None:
    robot = arm("lwr4")
    course = planned(10, MARGIN)[0].from_start
    assert course is not None
    targets = planned(10, MARGIN)[0].targets
    broken = make_course(robot, targets, course.q_rad + 1e-4 * np.sin(np.arange(60.0))[:, None])
    assert not broken.kept
    assert refine(robot, targets, broken, shaft_margin=MARGIN).kept


def test_a_margin_that_the_course_keeps_by_itself_changes_nothing() -> None:
    robot = arm("lwr4")
    plan, shares = planned(10, MARGIN)
    course = plan.from_start
    assert course is not None
    free = refine(robot, plan.targets, course)
    least = min(shares.min(), shaft_shares(robot, free.q_rad).min())
    np.testing.assert_array_equal(refine(robot, plan.targets, course, shaft_margin=0.99 * least).q_rad, free.q_rad)
    assert not np.array_equal(refine(robot, plan.targets, course, shaft_margin=1.5 * least).q_rad, free.q_rad)


def test_a_way_that_only_the_bound_knows_is_taken_though_it_goes_just_below_the_margin() -> None:
    """The grid's steps are too coarse for the way to the higher maximum, which leads 6 % below the margin."""
    sizes = {"amplitude": 0.01, "wavelength": 0.02, "periods": 2.0}
    scenario = Scenario().change(
        seed=3912373839, start={"pose": "random", "swivel": "random"}, trocar={"depth_m": 0.12},
        task={"path": "sinusoid", "sizes": sizes},
    )  # fmt: skip
    robot = arm("lwr4")
    layout = layout_of(scenario, robot)
    targets = targets_of(robot, layout, 128)
    free, kept = (
        make_plan(
            robot, layout.q, targets, swivels=360, margin=0.05, speed_share=0.97, shaft_margin=margin, elsewhere=False
        ).from_start
        for margin in (0.0, 0.0875)
    )
    assert free is not None
    assert kept is not None
    assert shaft_shares(robot, kept.q_rad).min() == pytest.approx(0.083, abs=0.002)
    assert kept.mu_mean > 0.99 * free.mu_mean


@pytest.mark.parametrize("margin", [-0.1, 1.5, float("nan"), True, "half"])
def test_a_margin_out_of_range_is_refused_by_name(margin: object) -> None:
    robot = arm("lwr4")
    q = robot.data.q_home
    with pytest.raises(TaskError, match=r"shaft_margin = .*give a share"):
        make_plan(robot, q, task(robot, q, 10), shaft_margin=margin)  # type: ignore[arg-type]
