"""The self-motion keeps tip, wrist and limits, and its best pose is no worse than any other on the curve."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from moc_opt.errors import RobotError
from moc_opt.planning.elbow import Elbow
from moc_opt.planning.self_motion import SelfMotion, parabola_peak, self_motion
from moc_opt.robots.model import RobotModel, load_robot
from tests.conftest import Array, Draw


def check(robot: RobotModel, start: Array, motion: SelfMotion, poses: Array) -> None:
    """The promises every pose on a curve must keep."""
    s = robot.state(start)
    for q in poses:
        there = robot.state(q)
        np.testing.assert_allclose(there.tip, s.tip, atol=1e-9)
        np.testing.assert_allclose(there.wrist, s.wrist, atol=1e-9)
        assert np.all(q >= robot.q_min)
        assert np.all(q <= robot.q_max)
        np.testing.assert_array_equal(q[list(motion.held)], start[list(motion.held)])


def test_tip_wrist_and_limits_are_kept(robot: RobotModel, regular_poses: Draw) -> None:
    rng = np.random.default_rng(5)
    for start in regular_poses(15, seed=4):
        motion = self_motion(robot, start)
        check(robot, start, motion, motion.q[::7])
        check(robot, start, motion, np.array([motion.at(f) for f in (0.0, *rng.uniform(size=4), 1.0)]))
        assert motion.held == (6,)
        here = int(np.flatnonzero(motion.s == 0.0)[0])
        np.testing.assert_array_equal(motion.q[here], start)


def test_samples_are_evenly_spaced_and_end_on_a_limit(robot: RobotModel, regular_poses: Draw) -> None:
    for start in regular_poses(10, seed=6):
        motion = self_motion(robot, start)
        gaps = np.linalg.norm(np.diff(motion.q, axis=0), axis=1)
        np.testing.assert_allclose(gaps, np.diff(motion.s), atol=1e-12)
        assert 0 < gaps.min() <= gaps.max() < 0.021
        for end, why in zip((motion.q[0], motion.q[-1]), motion.ends, strict=True):
            if why == "limit":
                assert np.min(np.minimum(end - robot.q_min, robot.q_max - end)) < 1e-8


def test_mu_is_the_models_and_best_beats_the_start(robot: RobotModel, regular_poses: Draw) -> None:
    for start in regular_poses(15, seed=8):
        motion = self_motion(robot, start)
        np.testing.assert_allclose(motion.mu, [robot.state(q).mu for q in motion.q], atol=1e-12)
        check(robot, start, motion, motion.best[None])
        assert motion.mu_best == pytest.approx(robot.state(motion.best).mu, abs=1e-12)
        assert motion.mu_best >= motion.mu.max() >= robot.state(start).mu - 1e-12
        assert motion.mu_best == pytest.approx(self_motion(robot, start, step=0.005).mu_best, abs=1e-6)


def test_the_same_curve_from_any_of_its_poses(robot: RobotModel) -> None:
    motion = self_motion(robot, robot.data.q_home)
    again = self_motion(robot, motion.at(0.8))
    assert again.s[-1] - again.s[0] == pytest.approx(motion.s[-1] - motion.s[0], abs=1e-3)
    assert again.mu_best == pytest.approx(motion.mu_best, abs=1e-6)
    from_end = self_motion(robot, motion.q[-1])
    assert 0.0 in (from_end.s[0], from_end.s[-1])
    assert from_end.s[-1] - from_end.s[0] == pytest.approx(motion.s[-1] - motion.s[0], abs=1e-3)


def test_a_full_turn_closes() -> None:
    data = load_robot().data
    robot = RobotModel(replace(data, q_min=np.full(7, -17.0), q_max=np.full(7, 17.0)))
    q = np.array([0.2, -1.0, 0.3, 1.5, -0.4, -0.6, 0.1])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        motion = self_motion(robot, q)
        assert motion.closed
        turns = (motion.q[-1] - motion.q[0]) / (2 * np.pi)
        np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)
        check(robot, q, motion, motion.q[::9])
        check(robot, q, motion, np.array([motion.at(f) for f in np.linspace(0, 1, 11)]))
        swivel = np.unwrap(Elbow(robot, robot.state(q).wrist[None]).swivel(motion.q))
    assert abs(swivel[-1] - swivel[0]) == pytest.approx(2 * np.pi, abs=1e-6)


def test_a_tool_off_the_last_axis_leaves_a_curve(odd_robot: RobotModel) -> None:
    q = odd_robot.data.q_home
    motion = self_motion(odd_robot, q)
    assert motion.held == (6,)
    assert len(motion.s) > 10
    check(odd_robot, q, motion, motion.q)


def test_bad_input_is_named(robot: RobotModel) -> None:
    q = robot.data.q_home
    for step in (0.0, -0.1, float("nan")):
        with pytest.raises(RobotError, match="step = "):
            self_motion(robot, q, step=step)
    with pytest.raises(RobotError, match=r"joints \[2\] are outside"):
        self_motion(robot, q + np.array([0, 3, 0, 0, 0, 0, 0]))
    with pytest.raises(RobotError, match="singular"):
        self_motion(robot, np.zeros(7))
    motion = self_motion(robot, q)
    for fraction in (-0.1, 1.1, float("nan")):
        with pytest.raises(RobotError, match="fraction"):
            motion.at(fraction)
    with pytest.raises(ValueError, match="read-only"):
        motion.q[0, 0] = 0.0


def test_the_peak_of_a_parabola_is_found_from_any_three_samples() -> None:
    rng = np.random.default_rng(6)
    for _ in range(100):
        bend, top, height = rng.uniform(-3.0, -0.1), rng.normal(), rng.normal()
        x = top + rng.uniform(-1.0, 1.0) + np.array([-rng.uniform(0.1, 2.0), 0.0, rng.uniform(0.1, 2.0)])
        y = bend * (x - top) ** 2 + height
        step, above = parabola_peak(x, y)
        if x[0] <= top <= x[2]:
            np.testing.assert_allclose([x[1] + step, y[1] + above], [top, height], atol=1e-9)
        else:  # no farther than to a neighbour
            assert min(abs(x[1] + step - x[0]), abs(x[1] + step - x[2])) < 1e-12
    assert parabola_peak(np.arange(3.0), np.array([1.0, 0.0, 1.0])) == (0.0, 0.0)
    assert parabola_peak(np.arange(3.0), np.array([-np.inf, 1.0, 0.5])) == (0.0, 0.0)
    assert parabola_peak(np.arange(3.0), np.array([0.0, 1.0, 2.0])) == (0.0, 0.0)
