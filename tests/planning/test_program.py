"""The nonlinear program plans courses that keep all limits."""

import casadi
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from moc_opt.planning.course import Limits, make_course, shaft_shares, worth
from moc_opt.planning.plan import best_course
from moc_opt.planning.pose_map import map_of
from moc_opt.planning.program import WHOLE, Program, across, refine, too_fast
from moc_opt.planning.search import WHOLE_CELL, End, Value, keeping_shaft
from moc_opt.robots.model import load_robot
from moc_opt.scenario import Scenario
from moc_opt.scenario.planned import plan
from tests.planning.arms import at_poses, line_from, task

NODES = 8


def on_grid(robot, targets, limits=None, swivels=180):
    limits, q = limits or Limits(), robot.data.q_home
    found = keeping_shaft(map_of(robot, q, targets, swivels), limits)
    poses = best_course(Value(found, limits), q)
    bound = Value(found, limits, cell=WHOLE_CELL).of(q, robot.state(q).mu)
    return make_course(robot, targets, poses, limits), bound


@pytest.mark.parametrize("name", ["lwr4", "panda"])
def test_refinement_raises_mu_to_a_certified_local_maximum(name, capfd, monkeypatch):
    robot = load_robot(name)
    targets = task(robot, robot.data.q_home, 60) if name == "lwr4" else line_from(robot, robot.data.q_home, 20)
    course, bound = on_grid(robot, targets, swivels=90)
    better = refine(robot, targets, course, Limits())
    assert capfd.readouterr().out == "", "the solver must print nothing"
    assert (better.certified, better.kept) == (True, True)
    assert course.mu_mean < better.mu_mean <= bound + 1e-12
    np.testing.assert_array_equal(better.q_rad[0], robot.data.q_home)
    monkeypatch.setitem(WHOLE, "ipopt.max_iter", 5)
    early = refine(robot, targets, course, Limits())
    assert not early.certified
    assert course.mu_mean <= early.mu_mean < better.mu_mean


def test_smoothing_a_course_costs_little_mu(robot):
    q = (0.2912492688528833, -0.9312126696305606, -0.2813874639891124, -0.9455987681077571, 0.08576585626315732,
         -1.0843382517252966, 1.987021145390591)  # fmt: skip
    circle = Scenario().change(start={"q_rad": q, "check_path": False}, task={"sizes": {"radius": 0.02}})
    limits = Limits(0.05, 0.97)
    found = plan(circle, margin_rad=0.05, speed_share=0.97, refined=False)
    smooth = refine(robot, found.targets, found.from_start, limits, smoothness=1e-4)
    assert smooth.mu_mean > 0.99 * found.from_start.mu_mean
    assert found.climbed.mu_mean < 0.97 * found.from_start.mu_mean
    gentle = refine(robot, found.targets, found.from_start, limits, smoothness=1e-3)
    turns = [np.abs(np.diff(each.q_rad, 2, axis=0)).max() for each in (gentle, smooth, found.from_start)]
    assert turns[0] < turns[1] < turns[2]
    steps = np.abs(np.diff(gentle.q_rad, axis=0)).max(axis=1)
    assert steps[-1] < 0.7 * steps[-2], "the course comes to rest at its end"


@given(arrays(float, 3, elements=st.floats(-1.0, 1.0)).filter(lambda shaft: np.linalg.norm(shaft) > 1e-3))
def test_the_two_vectors_across_a_shaft_are_orthonormal(shaft):
    for along, two in zip((shaft, np.ones(3)), across(np.array([shaft, np.ones(3)])), strict=True):
        frame = np.vstack([along / np.linalg.norm(along), two])
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)


def test_the_violation_of_a_course_is_its_excess_over_a_limit(robot):
    targets = task(robot, robot.data.q_home, 20)
    course, _ = on_grid(robot, targets)
    jump, off = np.array(course.q_rad), np.array(course.q_rad)
    jump[10, 6] += 3.5  # joint 7 moves neither tip nor wrist
    off[3, 1] += 1e-3
    for share in (1.0, 0.5):
        beyond = abs(jump[10, 6] - jump[9, 6]) - share * robot.v_max[6] * targets.period_s
        assert make_course(robot, targets, jump, Limits(speed_share=share)).violation == pytest.approx(beyond)
    room = np.minimum(course.q_rad - robot.q_min, robot.q_max - course.q_rad).min(axis=0)
    for j in range(6):
        limits = Limits(margin=(room[j] + 0.2) * np.eye(7)[j])
        assert make_course(robot, targets, course.q_rad, limits).violation == pytest.approx(0.2)
    moved = np.abs(np.subtract(robot.tool_along(off), (targets.tip, targets.wrist))).max()
    assert make_course(robot, targets, off).violation == pytest.approx(moved, rel=1e-6)
    slow = Limits(speed_share=1e-10)
    assert not refine(robot, targets, make_course(robot, targets, course.q_rad, slow), slow).kept


def test_a_fast_joint_stops_before_its_position_limit():
    v, q, zero = casadi.MX.sym("v"), casadi.MX.sym("q"), casadi.DM(0.0)
    excess = casadi.Function("excess", [v, q], [too_fast(v, q, casadi.DM(-9.0), zero, 2.0)])
    pose, dt, speeds = -1.5, 1e-3, []
    for _ in range(6000):
        speeds.append(-float(excess(0.0, pose)[0]))
        pose += dt * speeds[-1]
        assert pose <= 0.0
    assert pose > -1e-3
    assert 1.8 < -np.diff(speeds).min() / dt <= 2.0 + 1e-6
    assert float(excess(-100.0, -9.0)[1]) == 100.0, "at the lower limit, no speed towards it is allowed"


def test_with_limited_deceleration_a_course_slows_down_before_joint_limits(robot):
    brake, limits, targets, late = 0.5, Limits(margin=0.3), task(robot, robot.data.q_home, 60), []
    course, _ = on_grid(robot, targets, limits)
    for rule in (np.inf, brake):
        poses = refine(robot, targets, course, limits, brake=rule).q_rad
        speed, ends = np.diff(poses, axis=0) / targets.period_s, (robot.q_min + 0.3, robot.q_max - 0.3)
        rows = zip(speed, poses[1:], strict=True)
        excess = [too_fast(*(casadi.DM(given) for given in (*row, *ends)), brake) for row in rows]
        late.append(float(np.array(excess)[:, robot.moves.any(axis=0).tolist() * 2].max()))
    assert late[1] < 1e-6 < 0.05 < late[0]


def test_a_shaft_margin_lowers_mean_mu(robot):
    course, _ = on_grid(robot, targets := task(robot, robot.data.q_home, 40))
    # A shaft share tells how well the shaft can turn while the tip rests. If it is below the margin, mu is rated lower.
    margin = 1.2 * float(shaft_shares(robot, course.q_rad).min())
    limits, top = Limits(shaft=margin), float(course.mu.max())
    kept, _ = on_grid(robot, targets, limits)
    refined, free = (refine(robot, targets, kept, each) for each in (limits, Limits()))
    assert worth(robot, refined, limits, top) > worth(robot, free, limits, top)
    assert shaft_shares(robot, refined.q_rad).min() > shaft_shares(robot, free.q_rad).min()
    assert refined.mu_mean < free.mu_mean


@pytest.fixture(scope="module")
def middle(robot):
    targets = task(robot, robot.data.q_home, 101)
    q = on_grid(robot, targets)[0].q_rad
    return robot, q[29], q[30 : 30 + NODES], targets[30 : 30 + NODES], horizon(robot)


def self_motion(robot, q):
    return np.append(np.linalg.svd(robot.state(q).A[:, :6])[2][-1], 0.0)


def horizon(robot, smoothness=0.001, margin=0.0):
    return Program(robot, NODES, 0.05, Limits(margin), mu=0.1, smoothness=smoothness, horizon=True)


def test_a_course_over_a_horizon_keeps_all_limits(middle, capfd):
    robot, start, guess, there, usual = middle
    rough = []
    for made in (horizon(robot, 1e-4), usual, horizon(robot, 1e-1)):
        answer, _ = made.solve(guess, start, there)
        assert make_course(robot, there, answer).violation < 1e-4
        assert (np.abs(answer[0] - start) / there.period_s <= robot.v_max + 1e-3).all()
        rough.append(float((np.diff(np.concatenate([start[None], answer]), axis=0) ** 2).sum()))
    assert capfd.readouterr().out == "", "the solver must print nothing"
    assert rough[2] < rough[1] <= rough[0] * (1.0 + 1e-6)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_last_pose_of_a_horizon_moves_to_where_the_value_function_is_larger(middle, side):
    robot, start, guess, there, made = middle
    rest = (guess[-1] - start) / (NODES * there.period_s)
    plain, _ = made.solve(guess, start, there, rest)
    along = self_motion(robot, plain[-1])
    far, near = (End(plain[-1], along, 0.05 * side, -0.5, -most, most) for most in (1.0, 1e-4))
    pulled, _ = made.solve(guess, start, there, rest, far)
    assert side * (along @ (pulled[-1] - plain[-1])) > 1e-3
    kept, _ = made.solve(guess, start, there, rest, near)
    assert abs(along @ (kept[-1] - plain[-1])) < 1e-3


def test_slopes_of_mu_and_value_function_balance_at_the_last_pose(middle):
    robot, start, guess, there, _ = middle
    v, dt = End(guess[-1], self_motion(robot, guess[-1]), slope=0.003, low=-1.0, high=1.0), 0.5
    q = Program(robot, NODES, dt, Limits(), mu=0.1).solve(guess, start, there, end=v)[0][-1]
    along = self_motion(robot, q)
    assert 0.5 * dt * robot.state(q).grad_mu @ along == pytest.approx(-v.slope * v.along @ along, rel=1e-4)


def test_a_horizon_begins_at_the_given_joint_velocity(middle):
    robot, start, guess, there, made = middle
    steps = [made.solve(guess, start, there, speed * np.ones(robot.n))[0][0] - start for speed in (-0.5, 0.5)]
    along = self_motion(robot, start)
    assert along @ (steps[1] - steps[0]) * np.sign(along.sum()) > 1e-4


def test_the_shaft_margin_moves_the_elbow(robot):
    q = robot.random_regular_pose(np.random.default_rng(5), margin=0.3)
    there, guess, shares = at_poses(robot, np.tile(q, (NODES, 1))), np.tile(q, (NODES, 1)), []
    share = float(shaft_shares(robot, q[None])[0])
    for margin in (0.0, 1.5 * share):
        made = Program(robot, NODES, 0.05, Limits(shaft=margin), mu=0.1, smoothness=1e-5, horizon=True)
        shares.append(float(shaft_shares(robot, made.solve(guess, q, there, period_s=0.05)[0][-1:])[0]))
    assert shares[1] > max(share, shares[0]) + 1e-3
