"""What the guard knows of the incision: geometry and statics against the plant, levels, and the stops they order."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.control.incision import SHORTEST_DEPTH_M, rcm_error, trocar_force
from moc_opt.control.safety_filter import SafetyFilter, SafetyFilterSettings
from moc_opt.errors import ControlError
from moc_opt.tasks import shaft_distance

PERIOD = 0.002


@settings(max_examples=100)
@given(seed=st.integers(0, 10**6), point=st.tuples(*[st.floats(-0.3, 0.3)] * 3))
def test_the_rcm_error_is_the_shafts_distance(robot, seed, point):
    q = np.random.default_rng(seed).uniform(robot.q_min, robot.q_max)
    s, pose = robot.state(q), robot.tool_pose(q)
    np.testing.assert_allclose(pose[3], s.tip, atol=1e-12)
    np.testing.assert_allclose(pose[2], s.tool_direction, atol=1e-12)
    np.testing.assert_allclose(pose[:3] @ pose[:3].T, np.eye(3), atol=1e-12)
    p = s.wrist + np.array(point)
    assert rcm_error(pose, p) == pytest.approx(float(shaft_distance(s.tip, s.wrist, p)), abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(
    seed=st.integers(0, 10**6), depth=st.floats(1.01 * SHORTEST_DEPTH_M, 0.25),
    force=st.tuples(*[st.floats(-20.0, 20.0)] * 3), touch=st.tuples(*[st.floats(-20.0, 20.0)] * 3),
)  # fmt: skip
def test_the_trocars_force_is_told_from_weight_and_from_what_the_tip_touches(robot, seed, depth, force, touch):
    """By statics alone, whatever the pose: the part across the shaft; forces along it are no trocar's."""
    pose = robot.tool_pose(np.random.default_rng(seed).uniform(robot.q_min, robot.q_max))
    length, mass = robot.data.tool_length, robot.data.tool_mass
    loads = [(np.array(force), length - depth), (np.array(touch), length), (np.array([0, 0, -9.81 * mass]), length / 2)]
    total = sum(load for load, _ in loads)
    moment = sum(np.cross(arm * pose[2], load) for load, arm in loads)
    wrench = np.concatenate([pose[:3] @ total, pose[:3] @ moment])
    expected = np.linalg.norm(pose[:2] @ np.array(force))
    point = pose[3] - depth * pose[2]
    assert trocar_force(pose, point, wrench, mass, length, np.inf) == pytest.approx(expected, abs=1e-6)
    close = pose[3] - 0.5 * SHORTEST_DEPTH_M * pose[2]  # not to be told apart: all that acts across the shaft
    across = np.linalg.norm(pose[:2] @ (np.array(force) + np.array(touch)))
    assert trocar_force(pose, close, wrench, mass, length, np.inf) == pytest.approx(across, abs=1e-6)
    for allowed in (0.0, 10.0):  # of what the tip touches, no more than that is believed
        found = trocar_force(pose, point, wrench, mass, length, allowed)
        assert found == pytest.approx(max(expected, across - allowed), abs=1e-6)


def guard_of(robot, **changes):
    mine = SafetyFilter(robot.data, SafetyFilterSettings(**changes), PERIOD, robot.gravity, robot.tool_place)
    mine.start(robot.data.q_home, np.zeros(7))
    return mine


def look(guard, q, trocar, wrench):
    """One tick at rest, as the sensor at the mount and the registered trocar have it."""
    guard.check_measurement(q, np.zeros(7), None, None, wrench, trocar)


def off_by(robot, q, distance):
    """A registered trocar (2, 3) that the shaft misses by so much [m]."""
    pose = robot.tool_pose(q)
    return np.stack([pose[3] - 0.15 * pose[2] + distance * pose[0], np.zeros(3)])


def weight(robot, q, force=0.0):
    """What the sensor shows at rest, with a force across the shaft at 0.15 m [N]."""
    pose, length = robot.tool_pose(q), robot.data.tool_length
    load, pull = np.array([0.0, 0.0, -9.81 * robot.data.tool_mass]), force * pose[1]
    moment = np.cross(0.5 * length * pose[2], load) + np.cross((length - 0.15) * pose[2], pull)
    return np.concatenate([pose[:3] @ (load + pull), pose[:3] @ moment])


@pytest.mark.parametrize(
    ("warning", "limit", "bring", "says"),
    [
        ("rcm_warning_m", "rcm_error_m", lambda r, q, x: (off_by(r, q, x), weight(r, q)), "the RCM error"),
        (
            "trocar_force_warning_N", "trocar_force_N",
            lambda r, q, x: (off_by(r, q, 0.0), weight(r, q, x)), "the trocar's force",
        ),
    ],
    ids=["rcm", "force"],
)  # fmt: skip
def test_a_level_warns_and_a_limit_stops_after_a_while(robot, warning, limit, bring, says):
    """Just below the warning nothing, between both a warning, above the limit a stop; each can be switched off."""
    q = robot.data.q_home
    levels = SafetyFilterSettings()
    low, high = getattr(levels, warning), getattr(levels, limit)

    def hold(value, ticks=1000, **changes):
        mine = guard_of(robot, **changes)
        for k in range(ticks):
            look(mine, q, *bring(robot, q, value))
            if mine.stopped:
                return mine, k
        return mine, ticks

    calm, _ = hold(0.99 * low)
    assert not calm.stopped
    assert calm.warnings == []
    warned, _ = hold(0.5 * (low + high))
    assert not warned.stopped
    [found] = warned.warnings
    assert found["of"] == says
    assert found["largest"] == pytest.approx(found["level"] * 0.5 * (low + high) / low, rel=1e-3)
    assert 0.0 < found["first_s"] < 0.2
    stopped, k = hold(1.02 * high)
    assert stopped.reason.startswith(f"{says} has been above")
    assert 0.2 < k * PERIOD < 0.6  # a mean over 0.1 s takes that long to come so near
    sudden, k = hold(5.0 * high)
    assert sudden.stopped
    assert k * PERIOD < 0.01
    for off in (None, math.inf):
        silent, _ = hold(5.0 * high, **{limit: off, warning: off})
        assert not silent.stopped
        assert silent.warnings == []
        heard, _ = hold(5.0 * high, **{limit: off})
        assert not heard.stopped
        assert len(heard.warnings) == 1
    stopped.start(q, np.zeros(7))
    assert not stopped.stopped
    assert stopped.warnings == []


def means(value, ticks, share):
    """A root mean square after 1, 2, ... ticks of a steady value."""
    return value * np.sqrt(1.0 - (1.0 - share) ** np.arange(1, ticks + 1))


@pytest.mark.parametrize("time_s", [0.05, 0.002, 0.0005])
def test_the_means_warn_and_stop_at_the_tick_that_their_law_says(robot, time_s):
    """5 mm and 6 N at once, levels apart: each at its own tick, with its own largest value."""
    q, share = robot.data.q_home, min(1.0, PERIOD / time_s)
    seen = off_by(robot, q, 0.005), weight(robot, q, 6.0)
    both = {"RCM": means(5.0, 400, share), "force": means(6.0, 400, share)}
    quiet = {"rcm_error_m": None, "trocar_force_N": None, "incision_s": time_s}
    for levels in ((2.0, 5.5), (4.0, 3.0)):
        guard = guard_of(robot, rcm_warning_m=1e-3 * levels[0], trocar_force_warning_N=levels[1], **quiet)
        for k in range(400):
            look(guard, q, *seen)
            due = [(np.flatnonzero(m > level)[0], m[k], level)
                   for m, level in zip(both.values(), levels, strict=True) if m[k] > level]  # fmt: skip
            assert len(guard.warnings) == len(due)
            for found, (first, largest, level) in zip(guard.warnings, due, strict=True):
                assert found["first_s"] == pytest.approx(first * PERIOD)
                assert found["largest"] == pytest.approx(largest, rel=1e-9)
                assert found["level"] == pytest.approx(level)
        assert [w["unit"] for w in guard.warnings] == ["mm", "N"]
        look(guard, q, off_by(robot, q, 0.0), weight(robot, q))
        again = [w["largest"] for w in guard.warnings]
        assert again == pytest.approx([5.0, 6.0], rel=1e-3)  # the largest stays, whatever comes
    for name, change, level in (("RCM", "rcm_error_m", 4e-3), ("force", "trocar_force_N", 4.0)):
        low = {"rcm_warning_m": None, "trocar_force_warning_N": None}
        guard = guard_of(robot, **{**quiet, **low, change: level})
        due = int(np.flatnonzero(both[name] > 4.0)[0])
        for _ in range(due + 1):
            assert not guard.stopped
            look(guard, q, *seen)
        assert guard.reason.endswith(f"has been above 4 {'mm' if name == 'RCM' else 'N'}")


def test_both_above_their_limits_are_both_noted(robot):
    guard, q = guard_of(robot, incision_s=PERIOD), robot.data.q_home
    look(guard, q, off_by(robot, q, 0.05), weight(robot, q, 50.0))
    assert guard.reason.startswith("the RCM error")
    assert guard.warnings[0]["largest"] == pytest.approx(50.0)
    guard = guard_of(robot, incision_s=PERIOD)
    look(guard, q, off_by(robot, q, 0.01), weight(robot, q, 50.0))
    assert guard.reason.startswith("the trocar's force")
    assert [w["of"] for w in guard.warnings] == ["the RCM error", "the trocar's force"]


def test_a_start_forgets_the_means(robot):
    guard, q = guard_of(robot), robot.data.q_home
    for _ in range(30):
        look(guard, q, off_by(robot, q, 0.011), weight(robot, q))
    assert len(guard.warnings) == 1
    guard.start(q, np.zeros(7))
    look(guard, q, off_by(robot, q, 0.011), weight(robot, q))
    assert guard.warnings == []


def test_a_loud_tick_between_readings_that_are_no_numbers_counts_as_heard(robot):
    q, bad = robot.data.q_home, np.full(6, np.nan)
    guard = guard_of(robot, incision_s=PERIOD, trocar_force_N=20.0, patience_ticks=1)
    for _ in range(5):
        look(guard, q, off_by(robot, q, 0.0), bad)
        look(guard, q, off_by(robot, q, 0.0), weight(robot, q, 10.0))
    assert not guard.stopped
    look(guard, q, off_by(robot, q, 0.0), bad)
    assert not guard.stopped
    look(guard, q, off_by(robot, q, 0.0), bad)
    assert guard.stopped


def test_a_deaf_sensor_leaves_the_rcm_error_watched(robot):
    guard, q = guard_of(robot, incision_s=PERIOD), robot.data.q_home
    look(guard, q, off_by(robot, q, 0.05), np.full(6, np.nan))
    assert guard.reason.startswith("the RCM error")


def test_a_guard_without_a_tool_knows_no_incision(robot):
    guard = SafetyFilter(robot.data, SafetyFilterSettings(), PERIOD, robot.gravity)
    guard.start(robot.data.q_home, np.zeros(7))
    look(guard, robot.data.q_home, off_by(robot, robot.data.q_home, 1.0), np.full(6, np.nan))
    assert not guard.stopped
    assert guard.warnings == []


def test_near_the_tip_the_whole_force_is_the_trocars(robot):
    """On both sides of the shortest depth, with the lever arm of a mount-to-tip length in between."""
    pose, length, mass = robot.tool_pose(robot.data.q_home), robot.data.tool_length, robot.data.tool_mass
    load = np.array([0.0, 0.0, -9.81 * mass])
    touch = 4.0 * pose[0]  # at the tip alone
    moment = np.cross(0.5 * length * pose[2], load) + np.cross(length * pose[2], touch)
    wrench = np.concatenate([pose[:3] @ (load + touch), pose[:3] @ moment])
    for depth, expected in ((1.001 * SHORTEST_DEPTH_M, 0.0), (0.999 * SHORTEST_DEPTH_M, 4.0), (-0.1, 4.0)):
        found = trocar_force(pose, pose[3] - depth * pose[2], wrench, mass, length, 10.0)
        assert found == pytest.approx(expected, abs=1e-9)
    assert SHORTEST_DEPTH_M == 0.05


def test_levels_must_be_in_order_and_numbers():
    for wrong in ({"rcm_warning_m": 0.02}, {"trocar_force_warning_N": 16.0}, {"rcm_error_m": -1.0},
                  {"trocar_force_N": float("nan")}):  # fmt: skip
        with pytest.raises(ControlError, match=next(iter(wrong))):
            SafetyFilterSettings(**wrong)


def test_a_deaf_sensor_stops_the_arm_and_a_short_gap_does_not(robot):
    q, bad = robot.data.q_home, np.full(6, np.nan)
    guard, sound = guard_of(robot), (off_by(robot, q, 0.0), weight(robot, q))
    for _ in range(3):
        look(guard, q, sound[0], bad)
    look(guard, q, *sound)
    for _ in range(3):
        look(guard, q, sound[0], bad)
    assert not guard.stopped
    look(guard, q, sound[0], bad)
    assert "wrench sensor" in guard.reason
    off = guard_of(robot, trocar_force_N=None, trocar_force_warning_N=None)
    for _ in range(10):
        look(off, q, sound[0], bad)
    assert not off.stopped
