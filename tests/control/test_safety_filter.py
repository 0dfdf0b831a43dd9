"""Limits that hold at every tick."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from moc_opt.control.safety_filter import SafetyFilter, SafetyFilterSettings
from moc_opt.control.safety_kernels import limit_torque
from moc_opt.errors import ControlError
from moc_opt.model.robot_model import load_robot
from moc_opt.scenario import Scenario, make_safety_filter

PERIOD = 0.002
N = 7


@pytest.fixture
def guard(robot):
    mine = SafetyFilter(robot.data, SafetyFilterSettings(), PERIOD, robot.gravity)
    mine.start(robot.data.q_home, np.zeros(N))
    return mine


def numbers(low, high):
    return arrays(np.float64, N, elements=st.floats(low, high))


@settings(max_examples=200)
@given(tau=numbers(-1e4, 1e4), before=numbers(-1.0, 1.0), place=numbers(-0.2, 1.2), v=numbers(-20.0, 20.0))
def test_torque_and_rate_stay_within_their_limits(robot, tau, before, place, v):
    """Whatever is asked for, in any state, also beyond the joint limits."""
    q = robot.q_min + place * (robot.q_max - robot.q_min)
    before = before * robot.tau_max
    mine = SafetyFilter(robot.data, SafetyFilterSettings(), PERIOD, robot.gravity)
    sent = mine.limit_torque(tau, before, q, v)
    assert (np.abs(sent) <= robot.tau_max).all()
    step = SafetyFilterSettings().torque_rate_Nm_per_s * PERIOD
    assert (np.abs(sent - before) <= step * (1 + 1e-12)).all()
    assert mine.limited == np.count_nonzero(sent != tau)


@settings(max_examples=200)
@given(tau=numbers(-170.0, 170.0), place=numbers(0.0, 1.0), v=numbers(-6.0, 6.0))
def test_too_fast_or_too_near_is_braked(robot, tau, place, v):
    """Without a rate limit: a joint that is too fast for where it is gets a torque below its weight's, against v."""
    s = SafetyFilterSettings(torque_rate_Nm_per_s=1e9)
    q = robot.q_min + place * (robot.q_max - robot.q_min)
    mine = SafetyFilter(robot.data, s, PERIOD)  # drives that carry the weight: hold = 0
    sent = mine.limit_torque(np.clip(tau, -robot.tau_max, robot.tau_max), np.zeros(N), q, v)
    for i in range(N):
        inside = min(robot.q_max[i] - q[i], q[i] - robot.q_min[i]) < s.position_margin_rad
        if inside and abs(v[i]) > robot.v_max[i] and (q[i] > 0.0) != (v[i] > 0.0):
            assert sent[i] == 0.0  # it leaves the wall, and too fast already
            continue
        for side, distance in ((1.0, robot.q_max[i] - q[i]), (-1.0, q[i] - robot.q_min[i])):
            distance -= s.position_margin_rad
            allowed = min(robot.v_max[i], np.sqrt(2.0 * s.wall_brake_rad_per_s2 * max(distance, 0.0)))
            if side * v[i] > allowed:
                assert side * sent[i] <= 1e-9
            if distance < 0.0:
                spring = s.wall_stiffness_Nm_per_rad * -distance
                assert side * sent[i] <= -min(spring, robot.tau_max[i]) + 1e-9
            if abs(v[i]) <= allowed and distance > 0.0 and place[i] in (0.4, 0.5):
                assert sent[i] == np.clip(tau, -robot.tau_max, robot.tau_max)[i]


def test_calm_torques_pass_untouched(guard, robot):
    tau = robot.gravity(robot.data.q_home)
    sent = guard.limit_torque(tau, tau, robot.data.q_home, 0.5 * robot.v_max)
    np.testing.assert_array_equal(sent, tau)
    assert guard.limited == 0


def test_the_wall_of_a_joint_that_slides_has_a_margin_of_its_own():
    rail = load_robot("lwr4_rail")
    (j,) = np.flatnonzero(rail.chain.prismatic)
    settings = SafetyFilterSettings(position_margin_rad=0.3, position_margin_m=0.02)
    mine = make_safety_filter(rail, Scenario(robot={"name": "lwr4_rail"}, guard=settings, control={"law": "dcac"}))
    turning = (j + 1) % rail.n
    for joint, inside, touched in ((j, 0.03, 0), (j, 0.01, 1), (turning, 0.31, 0), (turning, 0.29, 1)):
        q = np.array(0.5 * (rail.q_min + rail.q_max))
        q[joint] = rail.q_max[joint] - inside
        tau = rail.gravity(q)
        tau[joint] += 1.0  # towards the wall
        mine.limit_torque(tau, tau, q, np.zeros(rail.n))
        assert mine.limited == touched


def test_the_kernel_asks_for_the_weight_only_where_it_brakes(robot):
    limits = np.array([robot.q_min, robot.q_max, robot.v_max, robot.tau_max, np.full(N, 0.05)])
    wall = np.array([2000.0, 20.0, 2.0])
    rest, tau = np.zeros(N), np.ones(N)
    args = (np.empty(0), limits, wall, 40.0)
    assert limit_torque(tau, rest, robot.data.q_home, rest, *args) == 0
    assert limit_torque(tau, rest, robot.data.q_home, 2.0 * robot.v_max, *args) == -1
    np.testing.assert_array_equal(tau, np.ones(N))
    tau[3] = np.nan
    assert limit_torque(tau, rest, robot.data.q_home, rest, *args) == -2


def test_bad_measurements_are_bridged(guard, robot):
    q, v = robot.data.q_home, np.full(N, 0.1)
    guard.check_measurement(q, v)
    for k, bad in enumerate((np.full(N, np.nan), q + 1.0, np.full(N, np.inf)), start=1):
        seen, speed = guard.check_measurement(bad, v)
        np.testing.assert_allclose(seen, q + k * PERIOD * v, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(speed, v)
        assert guard.bad_ticks == k
        assert not guard.stopped
    back, _ = guard.check_measurement(q + 3 * PERIOD * v, v)
    np.testing.assert_array_equal(back, q + 3 * PERIOD * v)
    assert guard.bad_ticks == 0
    for _ in range(4):
        guard.check_measurement(q, np.full(N, np.nan))
    assert guard.stopped
    assert "not believed" in guard.reason


def test_a_speed_that_no_joint_has_is_not_believed(guard, robot):
    guard.check_measurement(robot.data.q_home, 6.0 * robot.v_max)
    assert guard.bad_ticks == 1


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_the_first_measurement_must_be_one(guard, bad):
    with pytest.raises(ControlError, match="not finite"):
        guard.start(np.full(N, bad), np.zeros(N))


@pytest.mark.parametrize(
    "field", [{"patience_ticks": -1}, {"jump_rad": 0.0}, {"stop_s": -1.0}, {"tip_error_m": float("nan")}]
)
def test_wrong_settings_name_the_field(field):
    with pytest.raises(ControlError, match=next(iter(field))):
        SafetyFilterSettings(**field)


@pytest.mark.parametrize("newton", [9.0, 30.0, 100.0])
def test_brakes_open_by_the_mean_of_the_trocars_force_and_not_by_a_blow(robot, newton):
    """m = 1 - (1 - 50 /s T)^k of a force that acts for k ticks; in one tick the tool's own inertia may show as much."""
    q, data = np.array(robot.data.q_home), robot.data
    guard = SafetyFilter(data, SafetyFilterSettings(), 0.002, robot.gravity, robot.tool_place)
    guard.start(q, np.zeros(7))
    pose = robot.tool_pose(q)
    calm = np.zeros(6)
    calm[:2] = -9.81 * data.tool_mass * pose[:2, 2]  # the tool's weight alone
    # At the tip the whole force is the trocar's.
    guard.check_measurement(q, np.zeros(7), wrench=calm, trocar=np.array([pose[3], np.zeros(3)]))
    pressed = calm + np.array([0.0, newton, 0.0, 0.0, 0.0, 0.0])
    opened = [not guard.brake_friction(pressed).any() for _ in range(400)]
    first = next(k for k in range(1, 60) if newton * (1.0 - 0.9**k) > SafetyFilterSettings().stop_yield_N)
    assert opened.index(True) + 1 == first
    assert (first == 1) == (newton > 80.0)
    assert np.flatnonzero(opened).tolist() == list(range(first - 1, first - 1 + 200))  # stop_yield_s, and not again


def test_a_measurement_that_is_no_newer_than_the_last_is_not_taken(guard, robot):
    q, v = np.array(robot.data.q_home), np.zeros(N)
    for stamp, off, taken in ((0, 0.0, True), (0, 1e-3, False), (2, 2e-3, True), (1, 3e-3, False), (4, 4e-3, True)):
        found, _ = guard.check_measurement(q + off, v, stamp)
        assert guard.bad_ticks == (not taken)
        assert (found == q + off).all() == taken
    assert not guard.stopped


@pytest.mark.parametrize("share", [1.0, 0.05])
def test_the_brakes_hold_their_share_of_each_drive_and_what_the_drive_cannot_carry(robot, share):
    weak = dataclasses.replace(robot.data, tau_max=share * robot.data.tau_max)
    guard = SafetyFilter(weak, SafetyFilterSettings(), PERIOD, robot.gravity)
    guard.start(weak.q_home, np.zeros(robot.n))
    left = np.maximum(np.abs(robot.gravity(weak.q_home)) - weak.tau_max, 0.0)
    assert (left.max() > 0.0) == (share < 1.0)
    expected = guard.settings.stop_holding * weak.tau_max + 1.5 * left
    np.testing.assert_allclose(guard.brake_friction(np.zeros(6)), expected, rtol=1e-12)
