"""An ascent keeps tip, wrist and limits, and ends where no small step inside the limits leads higher."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.redundancy.ascent import ascend, place
from moc_opt.redundancy.continuation import Constraint
from tests.conftest import Array


def constraint(robot: RobotModel, q: Array) -> Constraint:
    chain, s = robot.chain, robot.state(q)
    active = np.flatnonzero(robot.moves.any(axis=0))
    return Constraint(
        chain.joints, chain.offsets, robot.moves, robot.q_min, robot.q_max, active, np.array([s.tip, s.wrist])
    )


def steepest(robot: RobotModel, q: Array) -> float:
    """The largest slope of mu along a direction in [-1, 1]^n that keeps tip, wrist and limits, by HiGHS."""
    s = robot.state(q)
    low = np.where(q <= robot.q_min + 1e-6, 0.0, -1.0)
    high = np.where(q >= robot.q_max - 1e-6, 0.0, 1.0)
    across = np.linalg.svd(s.A)[2][:5]
    found = linprog(-s.grad_mu, A_eq=across, b_eq=np.zeros(5), bounds=list(zip(low, high, strict=True)))
    assert found.status == 0
    return float(-found.fun)


@pytest.mark.parametrize("name", ["panda", "lwr4_rail", "odd"])
def test_an_ascent_ends_at_a_maximum_inside_the_limits(name: str, odd_robot: RobotModel) -> None:
    robot = odd_robot if name == "odd" else load_robot(name)
    rng = np.random.default_rng(8)
    at_limits, slopes = 0, []
    for start in rng.uniform(robot.q_min, robot.q_max, (25, robot.n)):
        arm, q = constraint(robot, start), start.copy()
        mu = ascend(arm, q)
        there, before = robot.state(q), robot.state(start)
        np.testing.assert_allclose([there.tip, there.wrist], [before.tip, before.wrist], atol=1e-9)
        assert np.all((robot.q_min <= q) & (q <= robot.q_max))
        assert mu == pytest.approx(there.mu, rel=1e-12)
        assert mu >= before.mu - 1e-12
        slopes.append(steepest(robot, q) / np.abs(before.grad_mu).max())
        at_limits += bool(((q == robot.q_min) | (q == robot.q_max))[arm.active].any())
    assert max(slopes) < 3e-2
    assert np.median(slopes) < 1e-3
    assert at_limits  # some of them end there, where what is held decides


def test_a_point_out_of_reach_is_told(odd_robot: RobotModel) -> None:
    arm = constraint(odd_robot, odd_robot.data.q_home)
    far = arm._replace(target=arm.target + 10.0)
    q = np.array(odd_robot.data.q_home)
    assert not place(far, q.copy(), 40)
    assert ascend(far, q) == -1.0
