"""Both halves of the safety filter's tick against their parts, asked one after the other."""

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.control import incision, replay_kernels, safety_tick
from moc_opt.control import motion_kernels as motion
from moc_opt.control.safety_filter import SafetyFilter, SafetyFilterSettings
from moc_opt.control.safety_kernels import believable, limit_torque

PERIOD, N = 0.002, 7
REST = np.zeros(N)


def guard_of(robot, **levels):
    guard = SafetyFilter(
        robot.data, SafetyFilterSettings(**levels), PERIOD, robot.gravity, robot.tool_place, robot.state
    )
    guard.start(robot.data.q_home, REST)
    return guard


def part_by_part(guard, q, v, stamp, applied, wrench, trocar, robot):
    """What `safety_tick.before` says of itself, on the memory of ``guard``: flags and digits."""
    m, inside, s, counts = guard._motion, guard._incision, guard.settings, guard._counts
    believed, found, newest = guard._believed, 0, m.clock[1]
    late = motion.age(stamp, s.patience_ticks, m.clock)
    counts[safety_tick.GAP] += m.clock[1] - newest
    found += safety_tick.TOO_OLD * (late == motion.OLD)
    bounds = np.array([robot.v_max * PERIOD, s.speed_factor * robot.v_max])
    bad = counts[safety_tick.BAD]
    if late == motion.FRESH and believable(q, v, believed[0], s.jump_rad, 1 + bad, bounds):
        believed[:], counts[safety_tick.BAD] = (q, v), 0
        elapsed = PERIOD * max(1, counts[safety_tick.GAP])
        what = motion.compare_readings(
            s.patience_ticks, robot.tau_max, m.levels, m.memory, m.still, q, v, applied, wrench, m.tip, elapsed
        )
        counts[safety_tick.GAP] = 0
        most = m.levels[motion.REPEAT_READING_TICKS]
        lagging = replay_kernels.count_lagging(q, v, m.joints_seen, m.joints_count)
        if lagging > most and what == motion.NOTHING:
            what = motion.LAGGING
        came_before = replay_kernels.count_replayed(q, v, wrench, m.seen, m.count)
        if came_before > min(most, m.most_replayed[int(motion.has_noise(m.still))]):
            what = motion.RECORDED
        found += safety_tick.ACCEPTED + safety_tick.WHAT * what
    else:
        counts[safety_tick.BAD] += 1
        believed[0] += believed[1] * PERIOD
    taken = incision.take(inside.tool, inside.lowest, inside.means, robot.tool_pose(believed[0]), trocar[0], wrench)
    return found + safety_tick.INSIDE * taken


@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(["sound", "repeated", "lost", "replayed", "wild"]))
@settings(max_examples=40, deadline=None)
def test_before_is_its_parts_one_after_the_other(robot, seed, kind):
    """Whatever arrives: same findings, same memory, at every tick of a sequence."""
    rng = np.random.default_rng(seed)
    whole, parts = guard_of(robot), guard_of(robot)
    pose, seen, found = robot.tool_pose(robot.data.q_home), [], set()
    everything = safety_tick.AGE + safety_tick.READING + safety_tick.INCISION
    for k in range(1, 120):
        q = robot.data.q_home + 2e-4 * k + rng.normal(scale=1e-5, size=N)
        v, stamp = np.full(N, 0.1) + rng.normal(scale=1e-3, size=N), k
        wrench = rng.normal(scale=3.0, size=6)
        trocar = np.stack([pose[3] - 0.15 * pose[2] + rng.normal(scale=5e-3, size=3), REST[:3]])
        seen.append((q, v, wrench))
        if kind == "repeated" and k > 30:
            q, v, wrench = seen[30]
        elif kind == "lost" and rng.random() < 0.6:
            stamp = k - int(rng.integers(0, 8))
        elif kind == "replayed" and k > 60:
            q, v, wrench = seen[k - 30]
            q = q.copy()
        elif kind == "wild" and rng.random() < 0.4:
            q, v, wrench = (a * rng.choice([1.0, np.nan, 3.0, np.inf]) for a in (q, v, wrench))
        applied = rng.normal(size=N)
        expected = part_by_part(parts, q, v, stamp, applied, wrench, trocar, robot)
        assert whole._before(everything, q, v, stamp, applied, wrench, trocar) == expected
        found.add(expected)
        for one, other in ((whole._believed, parts._believed), (whole._counts, parts._counts),
                           (whole._motion.memory, parts._motion.memory), (whole._motion.still, parts._motion.still),
                           (whole._motion.seen, parts._motion.seen), (whole._motion.clock, parts._motion.clock),
                           (whole._incision.means, parts._incision.means)):  # fmt: skip
            np.testing.assert_array_equal(one, other)
    assert len(found) > (kind != "sound")


@given(seed=st.integers(0, 2**32 - 1), bad=st.sampled_from([0.0, np.nan]), fast=st.sampled_from([0.2, 3.0]))
@settings(max_examples=40, deadline=None)
def test_after_limits_as_the_law_alone_does_and_adds_what_it_found(robot, seed, bad, fast):
    rng = np.random.default_rng(seed)
    guard = guard_of(robot, tip_error_s=PERIOD)
    q, v = robot.data.q_home, fast * robot.v_max * rng.uniform(-1.0, 1.0, N)
    tau, before = rng.normal(scale=80.0, size=(2, N))
    tau[3] += bad
    state, off = robot.state(q, v), rng.choice([0.0, 0.02])
    tip_ref = np.stack([state.tip + off * np.eye(3)[0], REST[:3], REST[:3]])
    alone, sent = tau.copy(), tau.copy()
    limited = limit_torque(alone, before, q, v, np.empty(0), guard._limits, guard._wall, guard._step)
    both = safety_tick.TIP + safety_tick.MOMENTUM
    found = guard._after(both, q, v, before, state.record, np.empty(0), tip_ref, sent)
    np.testing.assert_array_equal(sent, alone)
    assert found == safety_tick.INSIDE * (limited + 2) + safety_tick.OFF_REFERENCE * (off > 0.0)
    np.testing.assert_array_equal(guard._motion.tip, tip_ref[0])
    np.testing.assert_allclose(guard._motion.memory[motion.INTEGRAL], state.M @ v, rtol=1e-12, atol=1e-12)
    assert guard._counts[safety_tick.CHECKED] == 1


@pytest.mark.parametrize("lost", [0, 1, 4])
def test_a_gap_leaves_room_for_the_way_of_all_its_periods(robot, lost):
    """After readings that were none, each joint may be as much farther as it can go in them, and no farther."""
    for share in (0.95, 1.05):
        for joint in range(N):
            guard = guard_of(robot, patience_ticks=9)
            for _ in range(lost):
                guard.check_measurement(np.full(N, np.nan), REST)
            way = guard.settings.jump_rad + (1 + lost) * robot.v_max[joint] * PERIOD
            there = robot.data.q_home + share * way * np.eye(N)[joint]
            q, _ = guard.check_measurement(there, REST)
            np.testing.assert_array_equal(q, there if share < 1.0 else robot.data.q_home)


@pytest.mark.parametrize("shown", ["its state", "its tip", "nothing"])
def test_a_tip_is_checked_wherever_the_controller_shows_it(robot, shown):
    guard = guard_of(robot, tip_error_s=PERIOD)
    q = robot.data.q_home
    state = robot.state(q, REST)
    tip_ref = np.stack([state.tip + 0.02, REST[:3], REST[:3]])
    told = {"its state": {"state": state}, "its tip": {"tip": state.tip}, "nothing": {}}[shown]
    guard.limit_torque(state.h, state.h, q, REST, tip_ref, **told)
    assert guard.stopped == (shown != "nothing")


def test_a_run_can_be_watched_by_two_filters_at_once(robot):
    """Kernels are bound to the arrays of one filter each."""
    one, other = guard_of(robot), guard_of(robot)
    held = copy.deepcopy(other._motion.memory)
    for k in range(5):
        one.check_measurement(robot.data.q_home + np.nan, REST, k + 1, REST, np.zeros(6))
    assert one.stopped
    assert not other.stopped
    np.testing.assert_array_equal(other._motion.memory, held)
