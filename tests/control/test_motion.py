"""The safety filter's checks of packet age and of measured motion."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from moc_opt import core
from moc_opt.control.safety_filter import SafetyFilterSettings, numbers_of
from moc_opt.robots import load_data
from moc_opt.robots.model import RobotModel
from tests.control.torques import PERIOD, REST, N, guard_of

PATIENCE = 3
ARM = RobotModel(dataclasses.replace(load_data("lwr4"), tau_max=np.full(N, 100.0), v_max=np.full(N, 1e3)))
"""An arm whose speed limits accept every finite reading."""
FRESH, REPEAT, OLD = range(3)


def ages(stamps, patience=PATIENCE):
    """Return FRESH, REPEAT or OLD for each tick. `stamps` are the times [ticks] of the packets that arrive."""
    guard = core.Guard(ARM.arm, **numbers_of(SafetyFilterSettings(patience_ticks=patience), ARM, PERIOD))
    deaf, late, found = np.full(6, np.nan), core.REASONS.index("measurements are too late"), []
    guard.start(REST, REST, 0)
    for stamp in stamps:
        reason = guard.believe(REST, REST, int(stamp), None, deaf, None)[0]
        bad = guard.watched()[0]
        found.append(OLD if reason == late else REPEAT if bad else FRESH)
    return found


@given(st.integers(0, 6), st.integers(0, 3), st.integers(0, 40))
@settings(max_examples=80, deadline=None)
def test_a_constant_delay_is_accepted_and_the_last_packet_is_too_old_after_the_patience(patience, late, last):
    late = min(late, patience)
    found = ages([min(last, max(0, k - late)) for k in range(late + last + patience + 2)], patience)
    assert found[: late + 1] == [FRESH] + [REPEAT] * late
    assert found[late + 1 : late + last + 1] == [FRESH] * last
    ordinary = late if last > 0 else 0  # without a new packet, the safety filter assumes delay 0
    first = last + ordinary + patience + 1
    assert OLD not in found[:first]
    if first < len(found):
        assert found[first] == OLD


@given(st.lists(st.integers(-10, 200), min_size=1, max_size=80), st.integers(0, 6))
@settings(max_examples=200, deadline=None)
def test_a_fresh_packet_is_newer_than_all_before_it_and_never_too_old(stamps, patience):
    newest, clock, delay = 0, 0, None
    found = ages([0, *stamps], patience)[1:]  # the first packet belongs to the start
    for stamp, one in zip(stamps, found, strict=True):
        clock += 1
        if 0 < stamp - clock <= patience:
            clock = stamp
        if one == FRESH:
            assert stamp > newest
            assert stamp <= clock
            newest, delay = stamp, clock - stamp if delay is None else delay
            assert clock - stamp <= delay + patience
        if clock - newest > (delay or 0) + patience:
            assert one == OLD


@pytest.mark.parametrize("missed", [1, PATIENCE, PATIENCE + 1])
def test_packet_after_a_gap_is_fresh_only_if_the_gap_is_within_the_patience(missed):
    found = ages([0, 1, 2, 3 + missed, 4 + missed])
    assert found == [FRESH] * 5 if missed <= PATIENCE else found[3] == REPEAT


def looked(q, v, tau=None, reference=None, wrench=None, **levels):
    """Return why the filter stopped the arm, and the index of that reading; without a stop, "" and len(q)."""
    guard = guard_of(ARM, q[0], v[0], carries=False, **levels)
    for k in range(len(q)):
        if reference is not None:
            guard.limit_torque(REST, REST, q[k], v[k], reference[k], tip=reference[k, 0])
        given = REST if tau is None else tau[k], None if wrench is None else wrench[k]
        guard.check_measurement(q[k], v[k], None, *given)
        if guard.reason:
            return guard.reason, k
    return "", len(q)


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 2.0), st.sampled_from([30.0, 50.0, 100.0, 0.0]))
@settings(max_examples=40, deadline=None)
def test_readings_of_a_smooth_motion_with_filtered_velocity_are_accepted(seed, speed, cutoff):
    """Positions are quantized and noisy, and velocities are low-passed."""
    rng = np.random.default_rng(seed)
    t = PERIOD * np.arange(800)[:, None]
    rate = rng.uniform(0.5, 3.0, N)
    q = speed / rate * np.sin(rate * t + rng.uniform(0, 6, N)) + rng.normal(scale=1e-5, size=(800, N))
    q = 2.4e-5 * np.rint(q / 2.4e-5)
    gain = 1.0 if cutoff == 0.0 else -np.expm1(-2 * np.pi * cutoff * PERIOD)
    rates = np.diff(q, axis=0) / PERIOD
    v, _ = lfilter([gain], [1.0, gain - 1.0], rates, axis=0, zi=(1.0 - gain) * rates[:1])
    assert looked(q[1:], v)[0] == ""


@pytest.mark.parametrize("speed", [0.02, 0.1, 1.0])
@pytest.mark.parametrize("joint", [0, 6])
def test_frozen_position_with_nonzero_velocity_stops_the_arm(speed, joint):
    v = np.zeros((400, N))
    v[:, joint] = speed
    q = np.cumsum(v, axis=0) * PERIOD
    assert looked(q, v)[0] == ""
    q[100:, joint] = q[100, joint]
    wrong, k = looked(q, v)
    assert "do not follow their velocities" in wrong
    assert 0 < (k - 100) * PERIOD * speed < 2.0 * (0.001 + 0.012 * speed)  # undetected motion [rad]


@pytest.mark.parametrize(("by", "wrench_repeats", "level"), [
    ("reference", False, 3e-3), ("reference", True, 5e-4), ("torque", False, 6.0), ("torque", True, 0.05),
])  # fmt: skip
def test_repeated_reading_stops_the_arm_if_reference_or_torque_changes(by, wrench_repeats, level):
    """Until reference [m] or torque [Nm] reaches `level`, static friction may hold the arm, so no stop is expected."""
    still, reference, tau = np.tile(np.linspace(-1.0, 1.0, N), (600, 1)), np.zeros((600, 3, 3)), np.zeros((600, N))
    grown = reference[:, 0, 0] if by == "reference" else tau[:, 2]
    grown[:] = (0.01 * PERIOD if by == "reference" else -0.02) * np.arange(600)
    assert looked(still, 0.0 * still)[0] == ""  # the reference is at rest
    wrench = np.zeros((600, 6)) if wrench_repeats else np.random.default_rng(0).normal(size=(600, 6))
    wrong, k = looked(still, 0.0 * still, tau, reference, wrench)
    assert "all encoders repeat" in wrong
    assert abs(grown[k]) == pytest.approx(level, abs=1e-4 if by == "reference" else 0.1)
    one = still.copy()
    one[:, 6] += 1e-5 * np.arange(600)
    assert looked(one, np.gradient(one, PERIOD, axis=0), reference=reference)[0] == ""


@pytest.mark.parametrize("alone", [True, False])
@pytest.mark.parametrize("noisy", [True, False])
def test_repeated_reading_of_a_noisy_sensor_stops_the_arm(noisy, alone):
    """With `alone`, only the wrench repeats. Otherwise the encoders repeat too."""
    rng = np.random.default_rng(4)
    q = rng.normal(scale=1e-5, size=(600, N)) * alone
    wrench = rng.normal(size=(600, 6)) if noisy else np.ones((600, 6))
    wrench[300:] = wrench[300]
    wrong, k = looked(q, 0.0 * q, wrench=wrench)
    assert (("wrench sensor repeats" if alone else "all encoders repeat") in wrong) == noisy
    assert k == (326 if noisy else 600)
    wrench[325] += 1.0  # the count restarts
    assert looked(q[:340], 0.0 * q[:340], wrench=wrench[:340]) == ("", 340)


def watched(robot, torque, ticks, momentum=True, **levels):
    """Return the reason and the tick k of the stop. The arm rests under the gravity torque plus `torque(k)` [Nm]."""
    rng, q, guard = np.random.default_rng(0), robot.data.q_home, guard_of(robot, momentum=momentum, **levels)
    for k in range(ticks):
        shown, tau = q + 1e-5 * rng.normal(size=N), robot.gravity(q) + torque(k)
        guard.check_measurement(shown, REST, k, tau)
        guard.limit_torque(REST, tau, shown, REST)
        if guard.reason:
            return guard.reason, k
    return "", ticks


@pytest.mark.parametrize(("begins", "stops"), [(1, False), (120, True)])
def test_arm_stops_if_a_load_appears_after_the_residual_settled(robot, begins, stops):
    """Until the residual has settled, its mean adapts to a load, so no stop is expected."""
    load = 0.4 * robot.tau_max
    for on, momentum in ((True, True), (False, True), (True, False)):
        reason, _ = watched(robot, lambda k: (k >= begins) * load, 200, momentum, residual_s=1e6, motion=on)
        found = "the measured motion does not fit the torque" in reason
        assert found == bool(reason) == (stops and on and momentum)


@pytest.mark.parametrize(("levels", "stops"), [({}, True), ({"residual_whole_torque": 1e6}, False)])
def test_slowly_growing_torque_without_motion_stops_the_arm(levels, stops, robot):
    rate = 0.25 * robot.tau_max[1] * PERIOD * np.eye(N)[1]  # 1.25 times the torque limit after 5 s
    reason, k = watched(robot, lambda k: rate * k, 2500, **levels)
    assert ("does not fit the torque" in reason) == bool(reason) == stops
    if stops:
        assert 0.5 < 0.25 * PERIOD * k < 0.55
