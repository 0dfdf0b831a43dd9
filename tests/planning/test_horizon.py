"""The short program keeps tip, shaft, limits and speeds, goes where V is higher, and gently for a price."""

from __future__ import annotations

import numpy as np
import pytest

from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.planning.course import make_course
from moc_opt.planning.horizon import Horizon
from moc_opt.planning.refine import SOFT_RAD, too_fast
from moc_opt.planning.search import search
from moc_opt.planning.shaft import shaft_shares
from moc_opt.planning.targets import Targets
from moc_opt.planning.to_go import End
from tests.conftest import Array
from tests.planning.test_search import map_of
from tests.planning.test_shaft import MARGIN, planned

NODES = 8


def problem(robot: RobotModel) -> tuple[Horizon, Array, Array, Targets]:
    """A start in the middle of a course, and the course as a guess."""
    found, step = map_of(robot, robot.data.q_home, count=101)
    q = search(found, step, start=(robot.data.q_home, 0.1)).q_rad
    assert q is not None
    part, path = slice(30, 30 + NODES), found.targets
    there = Targets(path.t_s[part], path.tip[part], path.wrist[part], path.arc_length_m[part])
    made = Horizon(robot, NODES, mu=0.1, margin=0.0, speed=robot.v_max, smoothness=1e-3)
    return made, q[29], q[part], there


def nothing(q: Array) -> End:
    return End(q, np.zeros(len(q)), 0.0, 0.0, -1.0, 1.0)


def test_tip_shaft_limits_and_speeds_are_kept(robot: RobotModel) -> None:
    made, start, guess, there = problem(robot)
    answer = made.solve(guess, start, np.zeros(robot.n), there, nothing(start))
    course = make_course(robot, there, answer)
    assert course.violation < 1e-4
    first = np.abs(answer[0] - start) / there.period_s
    assert (first <= robot.v_max + 1e-3).all()


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_its_end_is_pulled_to_where_v_is_higher(robot: RobotModel, side: float) -> None:
    made, start, guess, there = problem(robot)
    rest = (guess[-1] - start) / (NODES * there.period_s)
    plain = made.solve(guess, start, rest, there, nothing(guess[-1]))
    along = np.linalg.svd(robot.state(plain[-1]).A[:, :6])[2][-1]
    along = np.append(along / np.linalg.norm(along), 0.0)
    pulled = made.solve(guess, start, rest, there, End(plain[-1], along, 0.05 * side, -0.5, -1.0, 1.0))
    assert side * (along @ (pulled[-1] - plain[-1])) > 1e-3
    kept = made.solve(guess, start, rest, there, End(plain[-1], along, 0.05 * side, -0.5, -1e-4, 1e-4))
    assert abs(along @ (kept[-1] - plain[-1])) < 1e-3


def test_a_smoother_course_is_had_for_a_higher_price(robot: RobotModel) -> None:
    _, start, guess, there = problem(robot)
    rough = []
    for price in (1e-4, 1e-1):
        made = Horizon(robot, NODES, mu=0.1, margin=0.0, speed=robot.v_max, smoothness=price)
        q = np.concatenate([start[None], made.solve(guess, start, np.zeros(robot.n), there, nothing(start))])
        rough.append(float((np.diff(q, axis=0) ** 2).sum()))
    assert rough[1] < rough[0]


def test_a_margin_from_losing_the_shaft_is_kept_where_mu_rises_below_it() -> None:
    """From this start the best course lies below the margin."""
    plan, along = planned(10, MARGIN)
    assert plan.from_start is not None
    way, path, k = plan.from_start.q_rad, plan.targets, int(np.argmin(along[10:40])) + 10
    part, arm = slice(k + 1, k + 1 + NODES), load_robot("lwr4")
    there = Targets(path.t_s[part], path.tip[part], path.wrist[part], path.arc_length_m[part])
    shares = []
    for kept in (0.0, MARGIN):
        made = Horizon(arm, NODES, mu=0.1, margin=0.0, speed=arm.v_max, smoothness=1e-5, shaft_margin=kept)
        answer = made.solve(way[part], way[k], np.zeros(arm.n), there, nothing(way[k + NODES]))
        assert make_course(arm, there, answer).violation < 1e-3
        shares.append(shaft_shares(arm, answer))
    floor = np.minimum(along[part], MARGIN)
    assert (shares[0] < floor - 5e-3).any()
    assert (shares[1] > floor - 2e-3).all()


@pytest.mark.parametrize(("of_share", "room"), [(0.7, "down to the margin"), (1.03, "no further down"), (4.0, "none")])
def test_what_the_margin_leaves_is_counted_from_the_guess(robot: RobotModel, of_share: float, room: str) -> None:
    """With the share's slope s at the guess: s . (q - guess) >= min(margin - share, 0); no bound far below it."""
    q = robot.random_regular_pose(np.random.default_rng(5))
    state, step = robot.state(q), 1e-6
    share = state.mu_shaft / state.tool_span**2
    margin = of_share * share
    made = Horizon(robot, 1, mu=0.1, margin=0.0, speed=robot.v_max, smoothness=1e-3, shaft_margin=margin)
    slope, least = made._shafts(q[None])
    for j in range(robot.n):
        near = [robot.state(q + side * step * np.eye(robot.n)[j]) for side in (-1.0, 1.0)]
        shares = [one.mu_shaft / one.tool_span**2 for one in near]
        assert slope[0, j] == pytest.approx((shares[1] - shares[0]) / (2.0 * step), abs=1e-6)
    wanted = {"down to the margin": margin - share, "no further down": 0.0, "none": -np.inf}[room]
    assert least[0] - slope[0] @ q == pytest.approx(wanted, abs=1e-12)


def test_it_begins_at_the_speed_that_the_arm_has(robot: RobotModel) -> None:
    made, start, guess, there = problem(robot)
    steps = [
        made.solve(guess, start, speed * np.ones(robot.n), there, nothing(start))[0] - start for speed in (-0.5, 0.5)
    ]
    along = np.linalg.svd(robot.state(start).A[:, :6])[2][-1]
    assert abs(along @ (steps[1] - steps[0])[:6]) > 1e-4
    assert np.sign(along @ (steps[1] - steps[0])[:6]) == np.sign(along.sum())


def towards(robot: RobotModel, free: Array, start: Array) -> tuple[int, float, float]:
    """Return the joint that goes farthest towards its nearer limit, on which side that is, and how far [rad].

    Of the joints that the elbow's motion turns: tip and shaft alone say where the others are.
    """
    side = np.sign(start - 0.5 * (robot.q_min + robot.q_max))
    turned = np.abs(np.linalg.svd(robot.state(start).A[:, :6])[2][-1]) > 0.1
    way = side * (free[-1] - start) * np.append(turned, False)
    joint = int(np.argmax(way))
    return joint, float(side[joint]), float(way[joint])


def margin_at(robot: RobotModel, joint: int, side: float, end: float) -> Array:
    """Return margins (n,) from the limits with which a joint's range ends at ``end`` [rad] on this side."""
    margin = np.zeros(robot.n)
    margin[joint] = robot.q_max[joint] - end if side > 0.0 else end - robot.q_min[joint]
    return margin


def test_a_margin_from_a_limit_is_kept_where_the_course_would_go_beyond(robot: RobotModel) -> None:
    made, start, guess, there = problem(robot)
    free = made.solve(guess, start, np.zeros(robot.n), there, nothing(start))
    joint, side, far = towards(robot, free, start)
    end = start[joint] + 0.7 * side * far
    margin = margin_at(robot, joint, side, end)
    made = Horizon(robot, NODES, mu=0.1, margin=margin, speed=robot.v_max, smoothness=1e-3)
    kept = made.solve(guess, start, np.zeros(robot.n), there, nothing(start))
    assert (side * (free[:, joint] - end)).max() > 1e-3
    assert (side * (kept[:, joint] - end)).max() < 1e-6
    assert make_course(robot, there, kept).violation < 1e-4


def test_a_joint_near_its_limit_is_slow_enough_to_stop_before_it(robot: RobotModel) -> None:
    made, start, guess, there = problem(robot)
    free = made.solve(guess, start, np.zeros(robot.n), there, nothing(start))
    joint, side, far = towards(robot, free, start)
    margin = margin_at(robot, joint, side, start[joint] + side * (far + 0.01))
    low, high = robot.q_min + margin, robot.q_max - margin
    fastest = np.abs(np.diff(free[:, joint])).max() / there.period_s
    brake = 0.5 * (0.5 * fastest / (np.sqrt(0.01 + SOFT_RAD) - np.sqrt(SOFT_RAD))) ** 2

    def excess(q: Array) -> float:
        speed = np.diff(np.concatenate([start[None], q]), axis=0) / there.period_s
        return max(float(np.max(too_fast(*pair, low, high, brake))) for pair in zip(speed, q, strict=True))

    made = Horizon(robot, NODES, mu=0.1, margin=margin, speed=robot.v_max, smoothness=1e-3, brake=brake)
    braked = made.solve(guess, start, np.zeros(robot.n), there, nothing(start))
    assert excess(free) > 1e-2
    assert excess(braked) < 1e-3
    assert make_course(robot, there, braked).violation < 1e-4
