"""The safety filter at the incision: RCM error and trocar force."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.tasks import shaft_distance
from tests.control.torques import PERIOD, REST, guard_of, off_by, weight

SHORTEST_DEPTH_M = 0.05
WARNINGS, LIMITS = ("rcm_warning_m", "trocar_force_warning_N"), ("rcm_error_m", "trocar_force_N")


def look(guard, q, trocar, wrench):
    guard.check_measurement(q, REST, wrench=wrench, trocar=trocar)


def seen(robot, q, point, wrench=None, tip_force=None):
    """RCM error [m] and trocar force [N] from one reading."""
    guard = guard_of(robot, q, incision=True, incision_s=PERIOD, tip_force_N=tip_force)
    look(guard, q, np.array([point, np.zeros(3)]), wrench)
    _, figures = guard._guard.watched()
    return np.sqrt(figures[0])


@settings(max_examples=100)
@given(seed=st.integers(0, 10**6), point=st.tuples(*[st.floats(-0.3, 0.3)] * 3))
def test_the_rcm_error_is_the_distance_of_the_shaft_from_the_trocar(robot, seed, point):
    q = np.random.default_rng(seed).uniform(robot.q_min, robot.q_max)
    s, pose = robot.state(q), robot.tool_pose(q)
    np.testing.assert_allclose(pose[3], s.tip, atol=1e-12)
    np.testing.assert_allclose(pose[2], s.tool_direction, atol=1e-12)
    np.testing.assert_allclose(pose[:3] @ pose[:3].T, np.eye(3), atol=1e-12)
    p = s.wrist + np.array(point)
    assert seen(robot, q, p)[0] == pytest.approx(float(shaft_distance(s.tip, s.wrist, p)), abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(
    seed=st.integers(0, 10**6), depth=st.floats(1.01 * SHORTEST_DEPTH_M, 0.25),
    force=st.tuples(*[st.floats(-20.0, 20.0)] * 3), touch=st.tuples(*[st.floats(-20.0, 20.0)] * 3),
)  # fmt: skip
def test_the_trocars_force_is_separated_from_the_tools_weight_and_a_force_at_the_tip(robot, seed, depth, force, touch):
    """The expected force is perpendicular to the shaft."""
    q = np.random.default_rng(seed).uniform(robot.q_min, robot.q_max)
    pose = robot.tool_pose(q)
    length, mass = robot.data.tool_length, robot.data.tool_mass
    loads = np.array([force, touch, [0.0, 0.0, -9.81 * mass]])
    moments = np.cross(np.outer([length - depth, length, length / 2], pose[2]), loads)
    wrench = np.concatenate([pose[:3] @ loads.sum(axis=0), pose[:3] @ moments.sum(axis=0)])
    expected = np.linalg.norm(pose[:2] @ np.array(force))
    point = pose[3] - depth * pose[2]
    assert seen(robot, q, point, wrench)[1] == pytest.approx(expected, abs=1e-6)
    close = pose[3] - 0.5 * SHORTEST_DEPTH_M * pose[2]  # too shallow to separate the forces
    across = np.linalg.norm(pose[:2] @ (np.array(force) + np.array(touch)))
    assert seen(robot, q, close, wrench)[1] == pytest.approx(across, abs=1e-6)
    for allowed in (1e-9, 10.0):  # upper bound [N] on the force attributed to the tip
        found = seen(robot, q, point, wrench, allowed)[1]
        assert found == pytest.approx(max(expected, across - allowed), abs=1e-6)


@pytest.mark.parametrize(("j", "of", "off_m", "newton"), [
    (0, "the RCM error", 0.05, 0.0), (1, "the trocar's force", 0.0, 75.0)
])  # fmt: skip
@pytest.mark.parametrize("off", [None, math.inf])
def test_each_limit_and_warning_can_be_switched_off(robot, j, of, off_m, newton, off):
    q = robot.data.q_home
    for changes, count in (({LIMITS[j]: off, WARNINGS[j]: off}, 0), ({LIMITS[j]: off}, 1)):
        mine = guard_of(robot, incision=True, **changes)
        for _ in range(400):
            look(mine, q, off_by(robot, q, off_m), weight(robot, q, newton))
        assert not mine.reason
        assert [each["of"] for each in mine.warnings] == [of] * count
        mine.start(q, np.zeros(7))
        assert mine.warnings == []


@pytest.mark.parametrize("time_s", [0.05, 0.002, 0.0005])
def test_warnings_and_stops_depend_on_low_passed_mean_squares(robot, time_s):
    q, left = robot.data.q_home, 1.0 - min(1.0, PERIOD / time_s)
    means = [5.0, 6.0] * np.sqrt(1.0 - left ** np.arange(1, 401))[:, None]
    seen = off_by(robot, q, 0.005), weight(robot, q, 6.0)
    quiet = {"incision": True, "incision_s": time_s, **dict.fromkeys([*WARNINGS, *LIMITS])}
    for levels in ((2.0, 5.5), (4.0, 3.0)):
        guard = guard_of(robot, **quiet | dict(zip(WARNINGS, (1e-3 * levels[0], levels[1]), strict=True)))
        first = (means > levels).argmax(axis=0)
        for k, now in enumerate(means):
            look(guard, q, *seen)
            due = np.transpose([first * PERIOD, now, levels])[first <= k]
            found = [[w["first_s"], w["largest"], w["level"]] for w in guard.warnings]
            np.testing.assert_allclose(np.reshape(found, (-1, 3)), due, rtol=1e-9)
        look(guard, q, off_by(robot, q, 0.0), weight(robot, q))  # the warning keeps the largest value
        assert [(w["unit"], round(w["largest"], 2)) for w in guard.warnings] == [("mm", 5.0), ("N", 6.0)]
    for j, (limit, level, words) in enumerate(zip(LIMITS, (4e-3, 4.0), ("4 mm", "4 N"), strict=True)):
        guard = guard_of(robot, **quiet | {limit: level})
        for mean in means[:, j]:
            look(guard, q, *seen)
            assert guard.reason.endswith(f"has been above {words}") == (mean > 4.0)


def test_long_gap_in_wrench_readings_stops_the_arm(robot):
    q, bad = robot.data.q_home, np.full(6, np.nan)
    guard, sound = guard_of(robot, incision=True), (off_by(robot, q, 0.0), weight(robot, q))
    for wrench in (bad, bad, bad, sound[1], bad, bad, bad):
        look(guard, q, sound[0], wrench)
    assert not guard.reason
    look(guard, q, sound[0], bad)
    assert "wrench sensor" in guard.reason
    off = guard_of(robot, incision=True, trocar_force_N=None, trocar_force_warning_N=None)
    for _ in range(10):
        look(off, q, sound[0], bad)
    assert not off.reason
    rcm = guard_of(robot, incision=True, incision_s=PERIOD)
    look(rcm, q, off_by(robot, q, 0.05), bad)
    assert rcm.reason.startswith("the RCM error")
    bare = guard_of(robot)
    look(bare, q, off_by(robot, q, 1.0), bad)
    assert (bare.reason, bare.warnings) == ("", [])
