"""The safety filter: walls (torques that hold joints off their limits), brakes, and its checks of measurements."""

import dataclasses
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.control.safety_filter import MOST_TICKS, SafetyFilter, SafetyFilterSettings, numbers_of
from moc_opt.errors import ControlError
from moc_opt.robots.model import RobotModel, load_robot
from tests.control.torques import PERIOD, REST, N, guard_of, off_by, weight


def bad_ticks(guard):
    """Number of consecutive refused measurements."""
    return guard._guard.watched()[0]


def by_the_law(s, robot, tau, before, q, v, carries):
    margins = s.position_margin_rad
    low, high, hold = robot.q_min + margins, robot.q_max - margins, carries * robot.gravity(q)
    ends, step = [], s.torque_rate_Nm_per_s * PERIOD
    for side, distance in ((1.0, high - q), (-1.0, q - low)):
        depth, speed = np.maximum(-distance, 0.0), side * v
        allowed = np.minimum(robot.v_max, np.sqrt(2.0 * s.wall_brake_rad_per_s2 * np.maximum(distance, 0.0)))
        acts = (distance < 0.0) | (speed > allowed)
        push = s.wall_stiffness_Nm_per_rad * depth + s.wall_damping_Nm_s_per_rad * np.maximum(speed - allowed, 0.0)
        ends.append(np.where(acts, -push, np.inf))
    most, least = ends[0], -ends[1]
    both = least > most  # beyond one wall and too fast towards the other: their torques contradict
    most, least = np.where(both, 0.0, most), np.where(both, 0.0, least)
    sent = np.clip(np.clip(tau, hold + least, hold + most), before - step, before + step)
    return np.clip(sent, -robot.tau_max, robot.tau_max)


@settings(max_examples=300)
@given(seed=st.integers(0, 10**6), rate=st.sampled_from([500.0, 2e4, 1e9]), fast=st.sampled_from([0.3, 1.0, 3.0, 20.0]),
       asked=st.sampled_from([1.2, 1e3]), carries=st.booleans())  # fmt: skip
def test_the_torque_follows_the_numpy_law_and_stays_within_its_limits(robot, seed, rate, fast, asked, carries):
    rng = np.random.default_rng(seed)
    guard = guard_of(
        robot, carries=carries, torque_rate_Nm_per_s=rate, position_margin_rad=0.05 * rng.uniform(0.5, 2.0),
        wall_stiffness_Nm_per_rad=2000.0 * rng.uniform(0.5, 2.0), wall_brake_rad_per_s2=rng.uniform(1.0, 4.0),
    )  # fmt: skip
    near = rng.choice([0.02, 0.3, 0.7], N) * rng.choice([-1.0, 1.0], N)  # offset from the limit / half the range
    q = np.where(rng.random(N) < 0.5, robot.q_min, robot.q_max) + near * (robot.q_max - robot.q_min) / 2.0
    v = fast * robot.v_max * rng.uniform(-1.0, 1.0, N)
    wall, at = robot.q_max - guard.settings.position_margin_rad, rng.random((2, N)) < 0.25
    q = np.where(at[0], wall, q)  # exactly at the wall or at the largest allowed speed
    room = np.sqrt(2.0 * guard.settings.wall_brake_rad_per_s2 * np.maximum(wall - q, 0.0))
    v = np.where(at[1], np.minimum(robot.v_max, room), v)
    before, tau = rng.uniform(-1.0, 1.0, (2, N)) * robot.tau_max * [[1.0], [asked]]
    expected = by_the_law(guard.settings, robot, tau, before, q, v, carries)
    sent = guard.limit_torque(tau, before, q, v)
    np.testing.assert_allclose(sent, expected, rtol=1e-12, atol=1e-9)
    assert guard.limited == np.count_nonzero(sent != tau)
    assert (np.abs(sent) <= robot.tau_max).all()
    assert (np.abs(sent - before) <= rate * PERIOD * (1 + 1e-12)).all()


@pytest.mark.parametrize(("j", "bad"), [(0, np.nan), (3, np.inf), (6, -np.inf)])
def test_torque_that_is_not_finite_stops_the_arm(robot, j, bad):
    guard = guard_of(robot)
    tau, before = np.ones(N), np.full(N, 2.0)
    tau[j] = bad
    assert guard.limit_torque(tau, before, robot.data.q_home, REST) is before
    assert (guard.limited, guard.reason) == (0, "the controller's torque is not finite")


def test_wall_of_a_sliding_joint_uses_position_margin_m():
    rail, margins = load_robot("lwr4_rail"), [0.02, *[0.3] * 7]
    given = numbers_of(SafetyFilterSettings(position_margin_rad=0.3, position_margin_m=0.02), rail, PERIOD)
    np.testing.assert_allclose(given["low"] - rail.q_min, margins)
    np.testing.assert_allclose(rail.q_max - given["high"], margins)


def test_default_filter_checks_incision_and_motion(robot):
    mine, q = SafetyFilter(robot, SafetyFilterSettings(incision_s=PERIOD), PERIOD), robot.data.q_home
    np.testing.assert_allclose(mine.stop_torque(robot.gravity(q)), robot.gravity(q))
    mine.check_measurement(q, REST, trocar=off_by(robot, q, 0.02))
    assert mine.reason.startswith("the RCM error")
    with patch.object(robot, "state", side_effect=ArithmeticError), pytest.raises(ArithmeticError):
        mine.limit_torque(REST, REST, q, REST)  # the check of the motion needs the state
    given = numbers_of(SafetyFilterSettings(), robot, PERIOD)
    assert (given["carries"], given["in_incision"], MOST_TICKS) == (True, True, np.iinfo(np.int32).max)


@pytest.mark.parametrize(("ticks", "replayed"), [(None, np.inf), (70, 25.0), (700, 100.0)])
def test_limits_for_stuck_joints_follow_from_settings(robot, ticks, replayed):
    known = np.array([9.0, 0.0, 0.5, 0.8, 0.5, 0.3, 0.3])  # 0: the friction is not known
    arm = RobotModel(dataclasses.replace(robot.data, coulomb_friction=known))
    settings = SafetyFilterSettings(stuck_torque=0.1, stuck_friction=2.0, repeat_joint_ticks=ticks)
    given = numbers_of(settings, arm, PERIOD)
    np.testing.assert_allclose(given["held"], np.fmin(0.1 * robot.tau_max, np.where(known > 0.0, 2.0 * known, np.inf)))
    assert given["replayed_ticks"] == replayed


@pytest.mark.parametrize("start", [-1.0, 1.0])
def test_start_inside_a_wall_moves_that_wall_to_the_start(robot, start):
    q, s = np.array(robot.data.q_home), SafetyFilterSettings()
    q[1] = start * (robot.q_max[1] - 0.5 * s.position_margin_rad)
    guard = guard_of(robot, q, carries=False)
    assert not guard.limit_torque(REST, REST, q, REST).any()
    deeper = np.where(np.arange(N) == 1, q + 1e-3 * start, q)
    back = guard.limit_torque(REST, REST, deeper, REST)
    assert back[1] == pytest.approx(-start * s.wall_stiffness_Nm_per_rad * 1e-3)
    q[5] = robot.q_max[5] - 0.5 * s.position_margin_rad
    assert guard.limit_torque(REST, REST, q, REST)[5] < 0.0
    guard.start(np.array(robot.data.q_home), REST)  # the walls are at their usual places again
    assert guard.limit_torque(REST, REST, q, REST)[1] * start < 0.0


def test_bad_measurements_are_bridged_by_extrapolation(robot):
    q, v = robot.data.q_home, np.full(N, 0.1)
    guard = guard_of(robot)
    guard.check_measurement(q, v)
    for k, bad in enumerate((np.full(N, np.nan), q + 1.0, np.full(N, np.inf)), start=1):
        seen, speed = guard.check_measurement(bad, v)
        np.testing.assert_allclose(seen, q + k * PERIOD * v, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(speed, v)
        assert bad_ticks(guard) == k
        assert not guard.reason
    back, _ = guard.check_measurement(q + 3 * PERIOD * v, v)
    np.testing.assert_array_equal(back, q + 3 * PERIOD * v)
    assert bad_ticks(guard) == 0
    for _ in range(4):
        guard.check_measurement(q, np.full(N, np.nan))
    assert "not believed" in guard.reason


def test_largest_accepted_step_grows_with_each_bad_measurement(robot):
    """With the period T, b bad measurements allow a distance of jump_rad + (1 + b) T v_max from q + b T v."""
    q, v = robot.data.q_home, np.full(N, 0.2)
    for bad in range(3):
        for share, sound in ((0.999, True), (1.001, False)):
            guard = guard_of(robot, q, v, speed_factor=2.0)
            for _ in range(bad):
                guard.check_measurement(np.full(N, np.nan), v)
            step = guard.settings.jump_rad + (1 + bad) * PERIOD * robot.v_max
            guard.check_measurement(q + bad * PERIOD * v + share * step, 2.0 * share * robot.v_max)
            assert bad_ticks(guard) == (0 if sound else bad + 1)


@pytest.mark.parametrize(("speed", "reason"), [(0.5, ""), (1.0, "do not follow their velocities")])
def test_position_change_over_three_ticks_is_compared_with_the_velocity(robot, speed, reason):
    guard, v = guard_of(robot), np.full(N, 0.5)
    for stamp in np.arange(60) // 3 * 3:
        guard.check_measurement(robot.data.q_home + stamp * PERIOD * speed, v, int(stamp), REST)
    assert reason in guard.reason
    assert bool(guard.reason) == bool(reason)


@pytest.mark.parametrize("time_s", [0.1, 0.002, 0.0005])
@pytest.mark.parametrize("factor", [0.999, 1.1, 3.0])
def test_mean_square_tip_error_above_its_limit_stops_the_arm(robot, time_s, factor):
    guard = guard_of(robot, tip_error_m=0.004, tip_error_s=time_s)
    share = min(1.0, PERIOD / time_s)
    for _ in range(2):  # the second start clears the first run's mean
        guard.start(robot.data.q_home, REST)
        for k in range(1, 400):
            guard.limit_torque(REST, REST, REST, REST, np.zeros((3, 3)), tip=np.array([0.0, 0.004 * factor, 0.0]))
            assert bool(guard.reason) == (factor**2 * (1.0 - (1.0 - share) ** k) > 1.0)
        assert guard.reason in ("", "the tip has been 4 mm off its reference")
    guard.start(robot.data.q_home, REST)
    guard.limit_torque(REST, REST, REST, REST, np.zeros((3, 3)), tip=np.full(3, np.nan))
    assert guard.reason


def test_start_resets_the_filter(robot):
    guard = guard_of(robot, patience_ticks=0)
    guard.limit_torque(np.full(N, 1e3), REST, robot.data.q_home, REST)
    assert guard.limited == N
    guard.check_measurement(np.full(N, np.nan), REST)
    assert guard.reason
    guard.request_stop("too late")
    assert guard.reason == "measurements not believed"
    q, v = robot.data.q_home + 0.1, np.full(N, 0.3)
    guard.start(q, v)
    assert (bad_ticks(guard), guard.limited, guard.reason, guard.warnings) == (0, 0, "", [])
    seen, _ = guard.check_measurement(np.full(N, np.nan), v)
    np.testing.assert_allclose(seen, q + PERIOD * v, rtol=1e-14)
    for bad in ((q, np.full(N, np.nan)), (np.full(N, np.inf), v)):
        with pytest.raises(ControlError, match="not finite"):
            guard.start(*bad)


@pytest.mark.parametrize("rate", [20000.0, 1e9])
def test_stopped_arm_carries_weight_within_torque_limits(robot, rate):
    q = np.array([0.3, 1.2, 0.1, -0.6, 0.2, 0.4, 0.0])
    before, step = np.array([-100.0, 100.0, 0.0, 0.0, 10.0, 0.0, 0.0]), rate * PERIOD
    for carries in (True, False):
        guard = guard_of(robot, q, carries=carries, torque_rate_Nm_per_s=rate)
        guard.limited = 3
        wanted = np.clip(carries * robot.gravity(q), -robot.tau_max, robot.tau_max)
        expected = np.clip(wanted, before - step, before + step)
        np.testing.assert_allclose(guard.stop_torque(before), expected, rtol=1e-9, atol=1e-9)
        assert guard.limited == 0


@pytest.mark.parametrize("newton", [9.0, 30.0, 100.0])
def test_brakes_open_if_the_low_passed_trocar_force_exceeds_stop_yield_N(robot, newton):
    """After k ticks of length T, the low-passed force is (1 - (1 - T / 0.02 s)^k) times the force."""
    q, guard = robot.data.q_home, guard_of(robot, incision=True)
    guard.check_measurement(q, REST, wrench=weight(robot, q), trocar=off_by(robot, q, 0.0))
    opened = [not guard.brake_friction(weight(robot, q, newton)).any() for _ in range(400)]
    first = next(k for k in range(1, 60) if newton * (1.0 - 0.9**k) > SafetyFilterSettings().stop_yield_N)
    assert opened.index(True) + 1 == first
    assert (first == 1) == (newton > 80.0)
    assert np.flatnonzero(opened).tolist() == list(range(first - 1, first - 1 + 200))  # open once, for stop_yield_s


def test_low_pass_returns_the_latest_value_if_its_time_constant_is_below_the_period(robot):
    short = SafetyFilterSettings(tip_error_s=0.05, incision_s=0.05, residual_s=0.05)
    found = numbers_of(short, robot, 0.1)
    assert {found[f"{name}_share"] for name in ("tip", "incision", "residual", "press")} == {1.0}


@pytest.mark.parametrize("share", [1.0, 0.05])
def test_brakes_hold_weight_that_drives_cannot_carry(robot, share):
    weak = dataclasses.replace(robot.data, tau_max=share * robot.data.tau_max)
    guard = guard_of(RobotModel(weak))
    left = np.maximum(np.abs(robot.gravity(weak.q_home)) - weak.tau_max, 0.0)
    assert (left.max() > 0.0) == (share < 1.0)
    expected = guard.settings.stop_holding * weak.tau_max + 1.5 * left
    np.testing.assert_allclose(guard.brake_friction(np.zeros(6)), expected, rtol=1e-12)
