"""The guard's laws to the last digit: torque by walls and brakes, what is believed, and the mean of the tip's error."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.control.safety_filter import SafetyFilter, SafetyFilterSettings
from moc_opt.control.safety_kernels import believable, limit_torque, squared_error
from moc_opt.errors import ControlError

PERIOD = 0.002
N = 7


def by_the_law(tau, before, q, v, hold, limits, wall, step):
    """What `limit_torque` says of itself, with numpy; the torque of the walls alone, and what is left of it."""
    low, high, v_max, tau_max = limits
    stiffness, damping, brake = wall
    ends = []
    for side, distance in ((1.0, high - q), (-1.0, q - low)):
        depth, speed = np.maximum(-distance, 0.0), side * v
        allowed = np.minimum(v_max, np.sqrt(2.0 * brake * np.maximum(distance, 0.0)))
        acts = (distance < 0.0) | (speed > allowed)
        ends.append(np.where(acts, -stiffness * depth - damping * np.maximum(speed - allowed, 0.0), np.inf))
    most, least = ends[0], -ends[1]
    both = least > most
    most, least = np.where(both, 0.0, most), np.where(both, 0.0, least)
    sent = np.clip(np.clip(tau, hold + least, hold + most), before - step, before + step)
    return np.clip(sent, -tau_max, tau_max), np.isfinite(most) | np.isfinite(least)


@settings(max_examples=150)
@given(seed=st.integers(0, 10**6), step=st.sampled_from([1.0, 40.0, 1e9]), fast=st.sampled_from([0.3, 1.0, 3.0]))
def test_the_torque_follows_the_law(robot, seed, step, fast):
    rng = np.random.default_rng(seed)
    margins = 0.05 * rng.uniform(0.5, 2.0, N)
    limits = np.array([robot.q_min + margins, robot.q_max - margins, robot.v_max, robot.tau_max])
    wall = np.array([2000.0, 20.0, 2.0]) * rng.uniform(0.5, 2.0, 3)
    near = rng.choice([0.02, 0.3, 0.7], N) * rng.choice([-1.0, 1.0], N)  # of half the range
    q = np.where(rng.random(N) < 0.5, robot.q_min, robot.q_max) + near * (robot.q_max - robot.q_min) / 2.0
    v = fast * robot.v_max * rng.uniform(-1.0, 1.0, N)
    hold, before = rng.uniform(-30.0, 30.0, N), robot.tau_max * rng.uniform(-1.0, 1.0, N)
    tau = rng.uniform(-1.2, 1.2, N) * robot.tau_max
    expected, braked = by_the_law(tau, before, q, v, hold, limits, wall, step)
    sent = np.array(tau)
    touched = limit_torque(sent, before, q, v, hold, limits, wall, step)
    np.testing.assert_allclose(sent, expected, rtol=1e-12, atol=1e-9)
    assert touched == np.count_nonzero(sent != tau)
    unknown = np.array(tau)
    said = limit_torque(unknown, before, q, v, np.empty(0), limits, wall, step)
    assert said == (-1 if braked.any() else touched)
    np.testing.assert_array_equal(unknown, tau if braked.any() else sent)


@pytest.mark.parametrize("j", [0, 3, 6])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_torque_that_is_no_number_is_enough(robot, j, bad):
    guard = SafetyFilter(robot.data, SafetyFilterSettings(), PERIOD, robot.gravity)
    guard.start(robot.data.q_home, np.zeros(N))
    tau, before = np.ones(N), np.full(N, 2.0)
    tau[j] = bad
    assert guard.limit_torque(tau, before, robot.data.q_home, np.zeros(N)) is before
    assert guard.limited == 0
    assert guard.reason == "the controller's torque is not finite"


def test_a_brake_starts_from_the_arms_weight(robot):
    """And asks for it only then."""
    asked = []

    def gravity(q):
        asked.append(q)
        return np.arange(7.0)

    guard = SafetyFilter(robot.data, SafetyFilterSettings(torque_rate_Nm_per_s=1e9), PERIOD, gravity)
    q, tau = robot.data.q_home, np.full(N, 30.0)
    np.testing.assert_array_equal(guard.limit_torque(tau, tau, q, np.zeros(N)), tau)
    assert asked == []
    v = np.zeros(N)
    v[2] = 1.5 * robot.v_max[2]
    sent = guard.limit_torque(tau, tau, q, v)
    assert len(asked) == 1
    assert sent[2] == pytest.approx(2.0 - 20.0 * 0.5 * robot.v_max[2])
    np.testing.assert_array_equal(np.delete(sent, 2), np.delete(tau, 2))
    assert guard.limited == 1


@pytest.mark.parametrize("j", [0, 3, 6])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("ticks", [1, 2, 4])
def test_a_step_is_believed_up_to_the_jump_and_what_v_max_explains(j, sign, ticks):
    q, v, per_tick, fastest = np.arange(7.0), np.zeros(N), np.linspace(0.01, 0.07, N), np.linspace(1.0, 7.0, N)
    unit, bounds = np.eye(N)[j] * sign, np.array([per_tick, fastest])
    for share, sound in ((0.999, True), (1.001, False)):
        moved = q + share * (0.05 + ticks * per_tick[j]) * unit
        assert believable(moved, v, q, 0.05, ticks, bounds) == sound
        assert believable(q, share * fastest[j] * unit, q, 0.05, ticks, bounds) == sound
    assert believable(q, fastest[j] * unit, q, 0.05, ticks, bounds)
    for bad in (np.nan, np.inf):
        assert not believable(q + np.where(unit, bad, 0.0), v, q, 0.05, ticks, bounds)
        assert not believable(q, np.where(unit, bad, 0.0), q, 0.05, ticks, bounds)


def test_limits_of_belief_grow_with_the_gap(robot):
    """After b bad measurements the arm may be (1 + b) ticks of v_max farther, from where it was expected."""
    s = SafetyFilterSettings(speed_factor=2.0)
    q, v = robot.data.q_home, np.full(N, 0.2)
    for bad in range(3):
        for share, sound in ((0.999, True), (1.001, False)):
            guard = SafetyFilter(robot.data, s, PERIOD)
            guard.start(q, v)
            for _ in range(bad):
                guard.check_measurement(np.full(N, np.nan), v)
            step = s.jump_rad + (1 + bad) * PERIOD * robot.v_max
            guard.check_measurement(q + bad * PERIOD * v + share * step, 2.0 * share * robot.v_max)
            assert guard.bad_ticks == (0 if sound else bad + 1)


def test_squared_error_is_of_the_first_row():
    rng = np.random.default_rng(1)
    for _ in range(20):
        tip, reference = rng.normal(size=3), rng.normal(size=(3, 3))
        assert squared_error(tip, reference) == pytest.approx(((tip - reference[0]) ** 2).sum(), rel=1e-12)


def look(guard, tip):
    """One tick of an arm at rest whose tip has to be at the origin."""
    rest = np.zeros(N)
    guard.limit_torque(rest, rest, rest, rest, np.zeros((3, 3)), tip=tip)


@pytest.mark.parametrize("time_s", [0.1, 0.002, 0.0005])
@pytest.mark.parametrize("factor", [0.999, 1.1, 3.0])
def test_a_tip_off_its_reference_is_noted_when_its_mean_says_so(robot, time_s, factor):
    guard = SafetyFilter(robot.data, SafetyFilterSettings(tip_error_m=0.004, tip_error_s=time_s), PERIOD)
    share = min(1.0, PERIOD / time_s)
    for _ in range(2):  # the second time after a start, which forgets
        guard.start(robot.data.q_home, np.zeros(N))
        assert not guard.stopped
        for k in range(1, 400):
            look(guard, np.array([0.0, 0.004 * factor, 0.0]))
            assert guard.stopped == (factor**2 * (1.0 - (1.0 - share) ** k) > 1.0)
        assert guard.reason in ("", "the tip has been 4 mm off its reference")
    guard.start(robot.data.q_home, np.zeros(N))
    look(guard, np.full(3, np.nan))
    assert guard.stopped


def test_a_start_forgets_everything(robot):
    guard = SafetyFilter(robot.data, SafetyFilterSettings(patience_ticks=0), PERIOD, robot.gravity)
    guard.start(robot.data.q_home, np.zeros(N))
    guard.limit_torque(np.full(N, 1e3), np.zeros(N), robot.data.q_home, np.zeros(N))
    assert guard.limited == N
    guard.check_measurement(np.full(N, np.nan), np.zeros(N))
    assert guard.stopped
    guard.request_stop("too late")
    assert guard.reason == "measurements not believed"
    q, v = robot.data.q_home + 0.1, np.full(N, 0.3)
    guard.start(q, v)
    assert (guard.stopped, guard.bad_ticks, guard.limited, guard.reason, guard.warnings) == (False, 0, 0, "", [])
    seen, speed = guard.check_measurement(np.full(N, np.nan), v)
    np.testing.assert_allclose(seen, q + PERIOD * v, rtol=1e-14)
    np.testing.assert_array_equal(speed, v)
    with pytest.raises(ControlError, match=r"v = .*not finite"):
        guard.start(q, np.full(N, np.nan))


@pytest.mark.parametrize("rate", [20000.0, 1e9])
def test_at_rest_the_weight_is_carried_within_the_limits(robot, rate):
    weight = np.array([1e3, -1e3, 5.0, -5.0, 0.0, 60.0, -60.0])
    s = SafetyFilterSettings(torque_rate_Nm_per_s=rate)
    before = np.array([-100.0, 100.0, 0.0, 0.0, 10.0, 0.0, 0.0])
    wanted = np.clip(weight, -robot.tau_max, robot.tau_max)
    step = rate * PERIOD
    guard = SafetyFilter(robot.data, s, PERIOD, lambda q: weight)
    guard.start(robot.data.q_home, np.zeros(N))
    guard.limited = 3
    np.testing.assert_allclose(guard.stop_torque(before), np.clip(wanted, before - step, before + step), rtol=1e-12)
    assert guard.limited == 0
    bare = SafetyFilter(robot.data, s, PERIOD)
    np.testing.assert_allclose(bare.stop_torque(before), np.clip(np.zeros(N), before - step, before + step))
    dumb = SafetyFilter(robot.data, s, PERIOD, lambda q: np.full(N, np.nan))
    np.testing.assert_array_equal(dumb.stop_torque(before), np.zeros(N))


def test_levels_may_be_equal_and_are_compared_where_both_are_given():
    SafetyFilterSettings(rcm_warning_m=0.012, trocar_force_warning_N=15.0)
    SafetyFilterSettings(rcm_warning_m=0.02, rcm_error_m=None, trocar_force_warning_N=None, trocar_force_N=1.0)
    for least in ({"torque_rate_Nm_per_s": 0.5}, {"wall_brake_rad_per_s2": 0.5}, {"jump_rad": 0.5},
                  {"tip_error_m": 0.5}, {"tip_error_s": 0.5}, {"rcm_error_m": 0.5}, {"incision_s": 0.5},
                  {"speed_factor": 1.5},
                  {"stop_damping_Nm_s_per_rad": 0.5}, {"stop_s": 0.5}, {"position_margin_rad": 0.0},
                  {"wall_stiffness_Nm_per_rad": 0.0}, {"wall_damping_Nm_s_per_rad": 0.0}, {"patience_ticks": 0},
                  {"trocar_force_N": 0.5, "trocar_force_warning_N": 0.5}):  # fmt: skip
        SafetyFilterSettings(**least)
        [field, *_] = least
        low = {"speed_factor": 1.0, "patience_ticks": -1}.get(field, -1e-9 if least[field] == 0.0 else 0.0)
        with pytest.raises(ControlError, match=field):
            SafetyFilterSettings(**{field: low})


@pytest.mark.parametrize("field", ["rcm_error_m", "rcm_warning_m", "trocar_force_N", "trocar_force_warning_N"])
@pytest.mark.parametrize("value", [0.0, -0.5])
def test_a_level_is_above_zero(field, value):
    off = dict.fromkeys(("rcm_error_m", "rcm_warning_m", "trocar_force_N", "trocar_force_warning_N"))
    with pytest.raises(ControlError, match=field):
        SafetyFilterSettings(**{**off, field: value})


def test_defaults_are_those_of_the_documentation():
    """Each number bounds what an arm may do near a patient: a change of one is a decision, and is made here too."""
    assert SafetyFilterSettings().model_dump() == {
        "torque_rate_Nm_per_s": 20000.0, "position_margin_rad": 0.045, "position_margin_m": 0.045,
        "wall_stiffness_Nm_per_rad": 2000.0, "wall_damping_Nm_s_per_rad": 20.0, "wall_brake_rad_per_s2": 2.0,
        "jump_rad": 0.05, "speed_factor": 5.0,
        "patience_ticks": 3, "tip_error_m": 0.01, "tip_error_s": 0.1, "rcm_error_m": 0.012, "rcm_warning_m": 0.006,
        "trocar_force_N": 15.0, "trocar_force_warning_N": 8.0, "incision_s": 0.1,
        "tip_force_N": 10.0,
        "stop_damping_Nm_s_per_rad": 20.0, "stop_holding": 0.25, "stop_yield_N": 8.0, "stop_yield_s": 0.4,
        "stop_s": 0.5,
        "motion": True, "motion_s": 0.1, "motion_rad": 0.001, "motion_lag_s": 0.012, "repeat_m": 0.003,
        "repeat_whole_m": 0.0005, "repeat_whole_ticks": 25,
        "repeat_torque": 0.06, "repeat_whole_torque": 0.0005, "stuck_torque": 0.06, "stuck_rad_per_s": 0.2,
        "stuck_friction": 6.0, "repeat_joint_ticks": None, "repeat_reading_ticks": None,
        "residual_torque": 0.2, "residual_whole_torque": 0.5, "residual_rate_per_s": 40.0, "residual_s": 0.25,
    }  # fmt: skip
