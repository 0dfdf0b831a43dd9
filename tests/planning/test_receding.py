"""A receding horizon with V leaves the local maximum that traps a climb; what it follows is where its path asks."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.errors import ControlError, ScenarioError
from moc_opt.planning.receding import NODES, Receding
from moc_opt.planning.targets import Targets
from moc_opt.scenario import Scenario, Setup
from moc_opt.tasks.trocar import shaft_distance
from moc_opt.trace.trace import Trace
from tests.conftest import Array

TRAPPED = Scenario(seed=9, bound_samples=0, judge=False).change(
    control={"preset": "tuned", "third_level": "receding"}, start={"pose": "random"}, task={"path": "circle"}
)
"""A start below the lower of two local maxima of mu."""


@cache
def setup() -> Setup:
    return Setup(TRAPPED)


def guide(of: Setup | None = None) -> Receding:
    found = (of or setup()).controller()._guide
    assert isinstance(found, Receding)
    return found


@cache
def ran() -> Trace:
    return mo.run(TRAPPED)


@cache
def climbed() -> Trace:
    return mo.run(TRAPPED.change(control={"third_level": "local"}))


def followed(one: Receding) -> Array:
    """Poses of an arm that goes where it is asked to at once."""
    one.start()
    q, poses = np.array(setup().q_start), []
    for _ in range(setup().ticks):
        q = q + one.desired_velocity(setup().robot.state(q)) * one._period
        poses.append(q)
    return np.array(poses)


def test_what_a_pose_is_worth_to_the_end_knows_the_margin_of_the_shaft() -> None:
    """Both V are of one scenario but for the margin: it is worth less where every pose is below it."""
    of = [Setup(TRAPPED.change(control={"shaft_margin": margin})) for margin in (0.0, 1.0)]
    least = [guide(one)._to_go.map.mu for one in of]
    known = ~np.isnan(least[0])
    assert (least[1][known] <= least[0][known]).all()
    assert (least[1][known] < least[0][known]).mean() > 0.1


def test_it_leaves_the_hump_in_which_the_local_law_is_trapped() -> None:
    assert ran().meta["ended"] == "completed"
    told = ran().meta["replans"]
    assert told["solves"] > 20.0 * (setup().duration_s - 0.3)
    assert told["refused"] <= 0.05 * told["solves"]
    assert 0.0 < told["solve_ms_median"] <= told["solve_ms_p99"]
    assert ran().mu.mean() > 1.15 * climbed().mu.mean()
    assert ran().columns["tip_error_model_m"].mean() < 2.0 * climbed().columns["tip_error_model_m"].mean()


def test_a_horizon_that_sees_no_further_stays_in_the_hump() -> None:
    """V is what sees the other maximum: without it the same program ends where the local law does.

    At the joints' whole speed a second is enough to see it: the horizon is the shortest.
    """
    blind = guide(Setup(TRAPPED.change(control={"horizon_s": 0.2})))
    kept, blind._to_go.value = blind._to_go.value, np.array(blind._to_go._gain)
    try:
        q = followed(blind)
    finally:
        blind._to_go.value = kept
    assert setup().robot.mu_along(q).mean() < 1.05 * climbed().mu.mean()


def test_what_it_follows_is_on_the_path_and_within_the_speeds() -> None:
    one = guide()
    q = followed(one)
    assert one.refused <= 0.05 * len(one.solve_s)
    assert len(one.solve_s) > 20.0 * (setup().duration_s - 0.3)
    t = one._period * (1.0 + np.arange(len(q)))
    tips, wrists = setup().robot.tool_along(q)
    # Between the times of the program it is a cubic, and a joint turns by up to 0.2 rad from one to the next.
    assert np.linalg.norm(tips - setup().reference.at(t)[0], axis=1).max() < 2e-3
    assert shaft_distance(tips, wrists, setup().registered.at(t)[0]).max() < 2e-3
    # On average from time to time as fast as joints can be, so the cubic is here and there faster; the box is not.
    assert (np.abs(np.diff(q, axis=0)) / one._period <= 1.2 * setup().robot.v_max).all()


@pytest.mark.parametrize("wrong", ["random", "nan", "fast"])
def test_nonsense_in_place_of_a_course_is_found_out(monkeypatch: pytest.MonkeyPatch, wrong: str) -> None:
    """The last answer goes on to its end, and there the arm is asked to rest."""
    one, rng = guide(), np.random.default_rng(0)
    robot, q = setup().robot, setup().q_start

    def nonsense(guess: Array, *_: object) -> Array:
        if wrong == "fast":
            return guess + np.eye(7)[6] * np.linspace(0.0, 3.0, len(guess))[:, None] + 0.05
        return rng.normal(size=guess.shape) if wrong == "random" else np.full_like(guess, np.nan)

    monkeypatch.setattr(one._horizon, "solve", nonsense)
    for _ in range(700):
        desired = one.desired_velocity(robot.state(q))
    assert one.refused == len(one.solve_s) - 1 > 10
    assert np.isfinite(desired).all()
    np.testing.assert_allclose(desired, 5.0 * (one._answer.q_rad[-1] - q), atol=1e-12)


def test_a_run_can_be_repeated_and_a_controller_has_its_own_course() -> None:
    one, other = guide(), guide()
    state = setup().robot.state(setup().q_start)
    first = [one.desired_velocity(state) for _ in range(60)]
    assert np.ptp(first, axis=0).max() > 1e-3, "it changes with the time"
    np.testing.assert_array_equal(first, [other.desired_velocity(state) for _ in range(60)])
    one.start()
    np.testing.assert_array_equal(first, [one.desired_velocity(state) for _ in range(60)])


def test_where_no_course_goes_all_the_way_the_run_is_refused() -> None:
    task, start = {"v_max_m_per_s": 2.0, "a_max_m_per_s2": 20.0}, {"check_path": False, "pose": "home"}
    fast = TRAPPED.change(task=task, start=start)
    with pytest.raises(ScenarioError, match=r"third_level = 'receding'.*mm along the path"):
        Setup(fast).controller()


@pytest.mark.parametrize("given", [{"horizon_s": 0.1}, {"horizon_s": 3.0}, {"replan_per_s": 5.0}])
def test_a_horizon_or_rate_out_of_range_is_named(given: dict[str, float]) -> None:
    with pytest.raises(ControlError, match=next(iter(given))):
        TRAPPED.change(control=given)


def test_a_solve_begins_at_the_course_where_the_arm_is_on_it() -> None:
    robot = setup().robot
    home, t, begun, made = np.array(robot.data.q_home), 0.1 * np.arange(21), list[Array](), list[int]()
    (tip,), (wrist,) = robot.tool_along(home[None])
    path = Targets(t, np.tile(tip, (21, 1)), np.tile(wrist, (21, 1)), np.zeros(21))

    class Still:
        margin, speed = 0.0, robot.v_max

        def forget(self) -> None:
            made.append(len(begun))

        def solve(self, guess: Array, start: Array, *_: object) -> Array:
            begun.append(np.array(start))
            return np.tile(home, (NODES, 1))

    to_go: Any = SimpleNamespace(
        map=SimpleNamespace(targets=path), near=lambda *_: None,
        way=lambda q, t_s, end, _: (np.array([t_s, t[end]]), np.array([q, home]), 0, 0),
    )  # fmt: skip
    still: Any = Still()
    one = Receding(to_go, still, robot, path, home, 0.002, horizon_s=1.0, rate_per_s=20.0)
    for off, on_it in ((0.04, True), (0.06, False)):
        one.begin(home, 0)
        one._tick, q = one._every, home + off * np.eye(7)[2]
        one.desired_velocity(robot.state(q))
        np.testing.assert_array_equal(begun[-1], home if on_it else q)
    # Taken over within a run: one solve in that tick, and none of the 0.15 s that a new solver takes.
    solved, one_period = len(begun), one._every
    assert one.begin(home, 5 * one_period)
    one.desired_velocity(robot.state(home))
    assert (len(begun), made) == (solved + 1, [0])
    for _ in range(one_period):
        one.desired_velocity(robot.state(home))
    assert len(begun) == solved + 2
    one.start()
    assert len(made) == 2
