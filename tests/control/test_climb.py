"""The third level moves the elbow to larger mu. With `climb = "scaled"`, Newton steps lead to the nearest maximum."""

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.errors import ControlError
from moc_opt.planning.self_motion import self_motion
from moc_opt.qp.problem import fields
from moc_opt.robots.model import RobotModel
from moc_opt.trace.oscillation import LIMIT_RAD_PER_S, shaking
from tests.control.torques import in_place, subproblem
from tests.reference.law import CLIMB_PER_S


def test_desired_speed_with_climb_scaled_is_proportional_to_distance_from_maximum_of_mu(robot: RobotModel) -> None:
    """The distance is an arc length on the self-motion curve."""
    q = np.asarray(self_motion(robot, robot.data.q_home, 0.01).q)
    top = int(np.argmax(robot.mu_along(q)))
    assert 40 < top < len(q) - 40, "the maximum of mu must be away from both ends of the curve"
    for off in (-12, -5, 5, 12):
        s = robot.state(q[top + off])
        desired = fields(subproblem(robot, s, *in_place(s), climbs=True, c2=1.0, rho=1.0)).pull
        arc = np.linalg.norm(np.diff(q[min(top, top + off) : max(top, top + off) + 1], axis=0), axis=1).sum()
        assert np.linalg.norm(desired) / CLIMB_PER_S == pytest.approx(arc, rel=0.2, abs=0.01)
        assert desired @ (q[top] - q[top + off]) > 0.0


def test_climb_scaled_without_regularization_is_refused() -> None:
    with pytest.raises(ControlError, match=r"climb = 'scaled' with c2 = 0\.001, regularization = 0"):
        mo.run(mo.Scenario(control={"climb": "scaled", "regularization": 0.0}))


@pytest.mark.parametrize(("number", "preset"), [(13, "nominal"), (25, "realistic")])
def test_velocity_bounds_stop_the_elbow_before_a_joint_limit(number, preset, robot, regular_poses) -> None:
    """From these two poses, mu increases along the self-motion until a joint reaches its limit."""
    q = regular_poses(30)[number].tolist()
    trace = mo.run(mo.Scenario(
        start={"q_rad": q, "swivel": 0.5}, plant={"preset": preset}, duration_s=4.0, task={"wait_s": 5.0},
        judge=False, bound_samples=0,
    ))  # fmt: skip
    room = np.minimum(robot.q_max - trace.q_rad, trace.q_rad - robot.q_min)
    assert trace.mu[-1] > 1.15 * trace.mu[0]
    assert 0.15 < room.min() < 0.17
    assert (trace.status == "solved").all()
    assert not trace.limited.any()
    assert trace.meta["ended"] == "completed"
    assert trace.tip_error_m.max() < 2e-3


def test_shaft_margin_prevents_shaking_near_a_straight_wrist() -> None:
    trial = mo.Scenario(seed=707, start={"pose": "random"}, judge=False, bound_samples=0)
    lost, kept = mo.run(trial.change(control={"shaft_margin": 0.0})), mo.run(trial)
    assert lost.meta["ended"] == kept.meta["ended"] == "completed"
    worst = shaking(lost, "v_rad_per_s")
    assert worst.joint == 4
    assert worst.rms > 2.0 * LIMIT_RAD_PER_S
    assert shaking(kept, "v_rad_per_s").rms < 0.5 * LIMIT_RAD_PER_S
    assert kept.rcm_error_m.max() < 0.6 * lost.rcm_error_m.max()
