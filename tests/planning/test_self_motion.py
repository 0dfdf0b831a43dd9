"""Self-motions keep tip and wrist in place, within the joint limits."""

from dataclasses import replace

import numpy as np
import pytest

from moc_opt.errors import MocOptError, RobotError
from moc_opt.planning.elbow import Elbow, distance_to_go, in_transient
from moc_opt.planning.self_motion import best_freedoms, freedoms, limit_shares, parabola_peak, self_motion
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.scenario import Scenario, run
from tests.planning.arms import IIWA14, build


def check(robot, start, motion, poses):
    s = robot.state(start)
    for q in poses:
        there = robot.state(q)
        np.testing.assert_allclose([there.tip, there.wrist], [s.tip, s.wrist], atol=1e-9)
        assert np.all((robot.q_min <= q) & (q <= robot.q_max))
        np.testing.assert_array_equal(q[list(motion.held)], start[list(motion.held)])


def test_a_self_motion_keeps_tip_and_wrist_in_place(robot, regular_poses):
    rng = np.random.default_rng(5)
    for start in regular_poses(10, seed=4):
        motion = self_motion(robot, start)
        check(robot, start, motion, motion.q[::7])
        check(robot, start, motion, motion.at([0.0, *rng.uniform(size=4), 1.0]))
        check(robot, start, motion, motion.best[None])
        assert motion.held == (6,)
        np.testing.assert_array_equal(motion.q[int(np.flatnonzero(motion.s == 0.0)[0])], start)
        gaps = np.linalg.norm(np.diff(motion.q, axis=0), axis=1)
        np.testing.assert_allclose(gaps, np.diff(motion.s), atol=1e-12)
        assert 0 < gaps.min() <= gaps.max() < 0.021
        for end in (motion.q[0], motion.q[-1]):
            assert np.min(np.minimum(end - robot.q_min, robot.q_max - end)) < 1e-8
        np.testing.assert_allclose(motion.mu, [robot.state(q).mu for q in motion.q], atol=1e-12)
        assert motion.mu_best == pytest.approx(robot.state(motion.best).mu, abs=1e-12)
        assert motion.mu_best >= motion.mu.max() >= robot.state(start).mu - 1e-12
        assert motion.mu_best == pytest.approx(self_motion(robot, start, step=0.005).mu_best, abs=1e-6)


def test_a_self_motion_is_the_same_from_each_of_its_poses(robot, odd_robot):
    motion = self_motion(robot, robot.data.q_home)
    turned = np.append(robot.data.q_home[:6], robot.q_max[6])  # the idle joint is at its limit
    again, idle, *from_ends = (self_motion(robot, q) for q in (motion.at([0.8])[0], turned, motion.q[0], motion.q[-1]))
    for other in (again, idle, *from_ends):
        assert (np.ptp(other.s), other.mu_best) == pytest.approx((np.ptp(motion.s), motion.mu_best), abs=1e-6)
    assert all(0.0 in (other.s[0], other.s[-1]) for other in from_ends)
    assert " _" not in repr(motion), "private fields are hidden"
    last = int(np.argmax(motion.mu)) + 2  # one sample after the largest mu suffices for the parabola
    cut = replace(motion, s=motion.s[:last], q=motion.q[:last], mu=motion.mu[:last])
    assert pytest.approx(motion.mu_best, rel=1e-9) == cut.mu_best > motion.mu.max() * (1.0 + 1e-8)
    odd = self_motion(odd_robot, odd_robot.data.q_home)
    assert (odd.held, len(odd.s) > 10) == ((6,), True)
    rail = load_robot("lwr4_rail")
    assert self_motion(rail, rail.data.q_home).held == (0, 7), "the rail, and the joint that turns only the tool"
    check(odd_robot, odd_robot.data.q_home, odd, odd.q)


def test_a_self_motion_without_joint_limits_is_a_closed_curve(robot):
    free = RobotModel(replace(robot.data, q_min=np.full(7, -17.0), q_max=np.full(7, 17.0)))
    q = np.array([0.2, -1.0, 0.3, 1.5, -0.4, -0.6, 0.1])
    motion = self_motion(free, q)
    gaps = np.linalg.norm(np.diff(motion.q, axis=0), axis=1)
    np.testing.assert_allclose(gaps, np.diff(motion.s), atol=1e-12)
    assert 0.001 < gaps.min() <= gaps.max() < 0.021
    turns = (motion.q[-1] - motion.q[0]) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)
    check(free, q, motion, motion.q[::9])
    check(free, q, motion, motion.at(np.linspace(0, 1, 11)))
    swivel = np.unwrap(Elbow(free, free.state(q).wrist[None]).swivel(motion.q))
    assert abs(swivel[-1] - swivel[0]) == pytest.approx(2 * np.pi, abs=1e-6)


def test_errors_name_the_bad_input(robot):
    q = robot.data.q_home
    for pose, message in ((np.zeros(7), "singular"), (q + 3.0 * np.eye(7)[1], r"joints \[2\] are outside")):
        with pytest.raises(RobotError, match=message):
            self_motion(robot, pose)
    assert len(self_motion(robot, q, step=10.0).q) > 1
    for step in (0.0, 1e9, np.nan):
        with pytest.raises(MocOptError, match="step = "):
            self_motion(robot, q, step=step)


def test_three_samples_give_the_peak_of_a_parabola():
    rng = np.random.default_rng(6)
    for _ in range(100):
        bend, top, height = rng.uniform(-3.0, -0.1), rng.normal(), rng.normal()
        x = top + rng.uniform(-1.0, 1.0) + np.array([-rng.uniform(0.1, 2.0), 0.0, rng.uniform(0.1, 2.0)])
        y = bend * (x - top) ** 2 + height
        step, above = parabola_peak(x, y)
        if x[0] <= top <= x[2]:
            np.testing.assert_allclose([x[1] + step, y[1] + above], [top, height], atol=1e-9)
        else:  # a peak outside the samples
            assert min(abs(x[1] + step - x[0]), abs(x[1] + step - x[2])) < 1e-12
    for y in ([1.0, 0.0, 1.0], [-np.inf, 1.0, 0.5], [0.0, 1.0, 2.0]):
        assert parabola_peak(np.arange(3.0), np.array(y)) == (0.0, 0.0)


def test_arms_have_their_known_rank_and_null_space_dimension(robot, odd_robot, tmp_path):
    assert best_freedoms(robot)[:3] == (5, 1, (6,))
    drawn = np.random.default_rng(0).uniform(robot.q_min, robot.q_max, (8, 7))
    assert best_freedoms(robot).both == max(freedoms(robot, q).both for q in drawn)
    assert best_freedoms(load_robot("lwr4_rail"))[:3] == (5, 2, (7,))
    off_the_axis = build(tmp_path, IIWA14, wrist=(0.05, 0.0, 0.0), mount=(0.05, 0.0, 0.0))
    assert best_freedoms(off_the_axis)[:3] == (5, 2, ())
    assert best_freedoms(odd_robot).rank == 5
    four = build(tmp_path, IIWA14, **{name: IIWA14[name][:4] for name in ("joints", "q_max", "v_max", "home")})
    assert freedoms(four, four.data.q_home)[::2] == (3, (3,), 0.0), "the arm cannot place the shaft freely"
    straight = freedoms(robot, np.zeros(7))
    assert (straight.rank < 5, straight.both) == (True, pytest.approx(0.0, abs=1e-9))


def test_moc_refuses_an_arm_without_a_self_motion(tmp_path):
    joints, rest = IIWA14["joints"], [k for k in range(7) if k != 2]
    six = {name: IIWA14[name][rest] for name in ("q_max", "v_max")}
    six |= {"joints": [*joints[:2], ((0, 0.42, 0), (0, 0, 0)), *joints[4:]], "home": np.take(IIWA14["home"], rest)}
    arm = build(tmp_path, {**IIWA14, **six})
    alone, home = self_motion(arm, arm.data.q_home), arm.state(arm.data.q_home)
    assert (alone.s.tolist(), alone.q.tolist(), alone.mu_best) == ([0.0], [home.q.tolist()], home.mu)
    message = r"of 6 joints, the tool's tip and shaft need 5, and 1 turn only the tool \(joint_6\)"
    asked = Scenario(robot={"name": str(tmp_path / "arm.toml")}, duration_s=0.1, bound_samples=0)
    with pytest.raises(RobotError, match=message):
        run(asked)
    assert run(asked.change(control={"law": "dcac"})).meta["ended"] == "completed"
    railed = {name: [add, *six[name]] for name, add in (("q_max", 0.3), ("v_max", 1.0), ("home", 0.0))}
    slide = build(tmp_path, {**IIWA14, **railed, "joints": [2 * ((0, 0, 0),), *six["joints"]], "slides": (0,)})
    assert self_motion(slide, slide.data.q_home).held == (6,), "the rail is the only freedom"


def test_limit_shares_are_zero_at_a_limit_and_one_midway_between_limits(robot):
    np.testing.assert_allclose(limit_shares(robot, 0.5 * (robot.q_min + robot.q_max)), 1.0)
    np.testing.assert_allclose(limit_shares(robot, robot.q_max), 0.0, atol=1e-12)


T = np.arange(0.0, 4.0, 0.02)


@pytest.fixture(scope="module")
def curve(robot):
    return self_motion(robot, robot.data.q_home)


@pytest.fixture(scope="module")
def place(curve):
    top = curve.s[np.argmax(curve.mu)] - curve.s[0]
    return lambda s: curve.at((top + np.atleast_1d(s)) / (curve.s[-1] - curve.s[0]))


def test_the_distance_to_the_largest_mu_is_an_arc_length(robot, curve, place, regular_poses):
    offsets = np.array([-0.6, -0.3, -0.1, 0.1, 0.3, 0.6])
    distance = distance_to_go(robot, [*place(offsets), curve.best, np.zeros(7)])
    np.testing.assert_allclose(distance[:6], np.abs(offsets), atol=0.02)
    np.testing.assert_allclose(distance[:3] + distance[5:2:-1], 2.0 * np.abs(offsets[:3]), atol=2e-4)
    assert (distance[6] < 1e-3, np.isnan(distance[7])) == (True, True), "a straight arm is singular"
    poses = np.array(regular_poses(6))[[0, 5]]  # from these poses, mu rises until a joint reaches its limit
    ends = [self_motion(robot, poses[0]).s[-1], -self_motion(robot, poses[1]).s[0]]
    np.testing.assert_allclose(distance_to_go(robot, poses), ends, atol=1e-3)


@pytest.mark.parametrize(("distance", "speed", "before", "after"), [(1.0, 0.5, 1.7, 1.9), (0.4, 0.1, 2.8, 3.2)])
def test_a_moving_elbow_is_in_transient(robot, place, distance, speed, before, after):
    flags = in_transient(robot, T, place(np.minimum(speed * T - distance, 0.0)))
    assert (flags[before > T].all(), flags[after < T].any()) == (True, False)


def test_a_resting_or_slow_elbow_is_not_in_transient(robot, curve, place):
    far, turns = np.tile(place(-0.5), (100, 1)), np.linspace(0.0, 1.0, 100)
    base, last = (np.outer(turns, axis) for axis in np.eye(7)[[0, 6]])
    for q in (far, curve.best + base, far + last):
        assert not in_transient(robot, 0.01 * np.arange(100), q).any()
    assert not in_transient(robot, T, place(0.03 * T - 0.4)).any()
    late = in_transient(robot, T, place(np.clip(0.5 * (T - 2.0) - 1.0, -1.0, 0.0)))  # the elbow rests for 2 s
    assert not late[T < 1.9].any()
    assert late[(T > 2.1) & (T < 3.6)].all()
    assert not in_transient(robot, [0.0], [robot.data.q_home]).any(), "one tick is no motion"
