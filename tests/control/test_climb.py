"""The scaled climb is a Newton step up the self-motion: as long as the way to the top, whatever mu's size and rho."""

from __future__ import annotations

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.control.climb import LONGEST_RAD, RATE_PER_S, ScaledClimb, on_self_motion
from moc_opt.errors import ControlError
from moc_opt.model.robot_model import RobotModel
from moc_opt.redundancy.self_motion import self_motion

SCALED = mo.Scenario(
    duration_s=1.5, judge=False, bound_samples=0, start={"swivel": 0.2}, plant={"preset": "nominal"},
    control={"climb": "scaled"},
)  # fmt: skip


def test_near_a_top_the_wish_is_the_way_to_it(robot: RobotModel) -> None:
    """Poses of one self-motion curve: the distance to its top along the curve is known without any derivative."""
    curve = self_motion(robot, robot.data.q_home, 0.01)
    q, climb = np.asarray(curve.q), ScaledClimb(robot)
    top = int(np.argmax(robot.mu_along(q)))
    assert 40 < top < len(q) - 40, "the top is inside the joint limits"
    for off in (-12, -5, 5, 12):
        state = robot.state(q[top + off])
        desired = climb.desired_velocity(state)
        way = np.linalg.norm(np.diff(q[min(top, top + off) : max(top, top + off) + 1], axis=0), axis=1).sum()
        assert np.linalg.norm(desired) / RATE_PER_S == pytest.approx(way, rel=0.2, abs=0.01)
        assert desired @ (q[top] - state.q) > 0.0


def test_the_wish_moves_neither_tip_nor_wrist_climbs_and_is_never_longer_than_told(robot: RobotModel) -> None:
    rng, climb, longest = np.random.default_rng(0), ScaledClimb(robot), 0
    for _ in range(50):
        state = robot.state(robot.random_regular_pose(rng, margin=0.1))
        desired = climb.desired_velocity(state)
        length = float(np.linalg.norm(desired))
        assert np.abs(state.A @ desired).max() < 1e-9 * max(length, 1.0)
        assert state.grad_mu @ desired > 0.0
        assert length <= RATE_PER_S * LONGEST_RAD * (1.0 + 1e-9)
        longest += length > 0.99 * RATE_PER_S * LONGEST_RAD
        flat = on_self_motion(state.A, state.tool_direction, state.grad_mu)
        np.testing.assert_allclose(desired / length, flat / np.linalg.norm(flat), atol=1e-9)
    assert longest > 3, "where mu curves upwards the step is the longest"


@pytest.mark.parametrize("bend", [0.0, 1e-12])
def test_where_there_is_no_slope_there_is_no_wish(robot: RobotModel, bend: float) -> None:
    desired = ScaledClimb(robot).desired_velocity(robot.state(np.array([0.2, 0.0, 0.0, bend, 0.0, 0.0, 0.0])))
    np.testing.assert_array_equal(desired, np.zeros(7))


def test_its_speed_does_not_depend_on_rho_and_the_gradients_does() -> None:
    ends = {}
    for climb in ("scaled", "gradient"):
        for rho in (1e-5, 1e-3):
            asked = SCALED.change(control={"climb": climb, "regularization": rho})
            ends[climb, rho] = mo.run(asked).q_rad[-1]
    assert np.abs(ends["scaled", 1e-5] - ends["scaled", 1e-3]).max() < 1e-3
    assert np.abs(ends["gradient", 1e-5] - ends["gradient", 1e-3]).max() > 0.1


def test_without_rho_it_is_refused() -> None:
    with pytest.raises(ControlError, match=r"climb = 'scaled' with c2 = 0\.001, regularization = 0"):
        mo.run(SCALED.change(control={"regularization": 0.0}, duration_s=0.01))


def test_close_to_where_the_shaft_is_lost_it_leads_away_from_there(robot: RobotModel) -> None:
    """The climb differs only inside the margin: there some that led towards losing the shaft are turned round."""
    rng, inside, turned = np.random.default_rng(1), 0, 0
    plain, kept = ScaledClimb(robot), ScaledClimb(robot, 0.05)
    for _ in range(200):
        state = robot.state(robot.random_regular_pose(rng, margin=0.1))
        desired, other = plain.desired_velocity(state), kept.desired_velocity(state)
        if state.mu_shaft >= 0.0501:
            np.testing.assert_array_equal(desired, other)
        elif 0.01 < state.mu_shaft < 0.03:
            inside += 1
            away = on_self_motion(state.A, state.tool_direction, state.grad_mu_shaft)
            assert other @ away > 0.0 or desired @ away <= 0.0, "the push turns no climb round that led away already"
            turned += desired @ away < 0.0 < other @ away
    assert inside > 10
    assert turned > 3
