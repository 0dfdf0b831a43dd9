"""After a stop, the arm is held, but gives way to a trocar that presses. docs/reliability.md has the bounds."""

import dataclasses
from collections import ChainMap

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from moc_opt.control.safety_filter import SafetyFilter, SafetyFilterSettings
from moc_opt.robots import available_robots
from moc_opt.robots.model import RobotModel
from moc_opt.scenario import Scenario, Setup, run
from moc_opt.scenario.tables import RobotTable
from moc_opt.trace.meta import Ending
from tests.odd_inputs import many

QUICK = {"bound_samples": 0, "judge": False}


def after(trace):
    """Return what happened after a stop: largest tip displacement [m], largest and last trocar force [N]."""
    stop = trace.t_s >= trace.meta["stopped_at_s"]
    force = np.linalg.norm(trace.trocar_force_N[stop], axis=1)
    return np.linalg.norm(trace.tip_m[stop] - trace.tip_m[stop][0], axis=1).max(), force.max(), force[-1]


@pytest.mark.parametrize("share", [1.0, 0.3, 0.15, 0.08])
@pytest.mark.parametrize("swivel", [0.0, 1.0])
def test_arm_with_weak_drives_is_held(monkeypatch, share, swivel):
    """With `share` = 0.15, the drives carry three quarters of the weight."""
    data = RobotTable().arm().data
    weak = RobotModel(dataclasses.replace(data, tau_max=share * data.tau_max))
    monkeypatch.setattr(RobotTable, "arm", lambda table: weak)
    rng = np.random.default_rng(round(1e3 * share) + int(swivel))
    seed, at = int(rng.integers(1000, 2000)), float(rng.uniform(0.05, 1.0))
    trace = run(Scenario(
        seed=seed, start={"swivel": swivel, "check_path": False}, faults={"nan_at_s": at, "nan_ticks": 10**6},
        control={"preset": "tuned"}, duration_s=2.0, **QUICK,
    ))  # fmt: skip
    assert trace.meta["ended"].startswith("stopped")
    assert after(trace)[0] < 0.025
    assert np.abs(trace.v_rad_per_s[-1]).max() < 0.01


@pytest.mark.parametrize("load", [{"payload_kg": 0.3}, {"payload_kg": 0.7}, {}], ids=str)
@pytest.mark.parametrize("seed", [41, 42])
def test_unknown_load_does_not_sink(load, seed):
    """A load above stop_yield_N would be mistaken for a pressing trocar."""
    scenario = Scenario(
        seed=seed, start={"pose": "random"}, faults={"nan_at_s": 0.4, "nan_ticks": 10**6, **load},
        plant={"mass_error": 0.3}, duration_s=1.2, **QUICK,
    )  # fmt: skip
    moved, _, _ = after(run(scenario))
    assert moved < 0.003
    sinking, _, _ = after(run(scenario.change(guard={"stop_holding": 0.0})))
    assert sinking > 2.0 * moved


@pytest.mark.parametrize(("seed", "slip_m"), [(50, 0.03), (51, 0.1), (52, 0.03), (53, 0.1)])
def test_arm_gives_way_to_a_pressing_trocar(seed, slip_m):
    """A slip takes 0.1 s. It may go on after the stop."""
    at = float(np.random.default_rng(seed).uniform(0.2, 1.8))
    scenario = Scenario(
        seed=seed, start={"swivel": "random"}, faults={"slip_m": slip_m, "slip_at_s": at}, control={"preset": "tuned"},
        duration_s=2.8, **QUICK,
    )  # fmt: skip
    trace = run(scenario)
    assert trace.meta["ended"].startswith("stopped: ")
    _, most, last = after(trace)
    assert most < 80.0
    assert last < 16.0
    held = run(scenario.change(guard={"stop_yield_N": None}))
    assert after(held)[2] > 1.5 * last  # with closed brakes, the force remains


def test_closed_brakes_open_only_if_the_force_rises_by_stop_yield(robot):
    guard, q = SafetyFilter(robot, SafetyFilterSettings(), 0.002, momentum=False), np.array(robot.data.q_home)
    guard.start(q, np.zeros(7))
    pose, length = robot.tool_pose(q), robot.data.tool_length
    trocar, weight = np.array([pose[3] - 0.15 * pose[2], np.zeros(3)]), -9.81 * robot.data.tool_mass * pose[:3, 2]
    free = np.concatenate([weight, [-0.5 * length * weight[1], 0.5 * length * weight[0], 0.0]])
    guard.check_measurement(q, np.zeros(7), trocar=trocar, wrench=free)

    def is_open(force, ticks):
        reading = free + np.array([force, 0.0, 0.0, 0.0, force * (length - 0.15), 0.0])
        return [not guard.brake_friction(reading).any() for _ in range(ticks)]

    for force, last in ((0.0, False), (7.0, False), (20.0, True), (6.0, True), (3.0, False), (np.nan, False)):
        assert is_open(force, 100)[-1] == last, force
    most = round(SafetyFilterSettings().stop_yield_s / 0.002)
    # Once the force has been 0 N, 20 N opens the brakes again.
    for force, ticks in ((0.0, 0), (20.0, most), (26.0, 0), (40.0, most), (0.0, 0), (20.0, most)):
        found = is_open(force, 1000)
        assert (sum(found), any(found[-500:])) == (ticks, False), force


PRESSED_N = 35.0
"""Largest allowed trocar force [N] of a completed run (root mean square over 0.1 s)."""

at_s, some, whole, forged = st.floats(0.05, 0.6), st.floats, st.integers, st.booleans()


def table(**fields):
    return st.fixed_dictionaries(fields)


def one_of(*values):
    return st.sampled_from(values)


def signed(least, most):
    return st.floats(least, most).flatmap(lambda size: one_of(-size, size))


JOINT = st.none() | st.integers(0, 6)
FAULTS = [
    table(encoder_bias_rad=some(1e-6, 0.003), encoder_noise_rad=some(1e-6, 1e-4)),
    table(nan_at_s=at_s, nan_ticks=whole(1, 1000)), table(jump_at_s=at_s, jump_rad=signed(1e-3, 1.0)),
    table(frozen_at_s=at_s, frozen_ticks=whole(1, 1000), frozen_joint=JOINT, forged_stamps=forged,
          frozen_velocity=one_of("repeated", "zero"), frozen_wrench=st.booleans()),
    table(lag_at_s=at_s, lag_growth=some(0.01, 1.0), forged_stamps=forged, lag_joint=JOINT, lag_ticks=whole(0, 60)),
    table(replay_at_s=at_s, replay_ticks=whole(1, 200), forged_stamps=forged),
    table(drift_at_s=at_s, drift_rad_per_s=signed(1e-3, 0.1), drift_velocity=one_of("included", "apart")),
    table(drop_share=some(1e-3, 1.0), late_ticks=whole(0, 3)),
    table(bump_N=some(1.0, 60.0), bump_at_s=at_s, bump_s=some(0.01, 0.5)), table(payload_kg=some(0.01, 1.0)),
    table(slip_m=some(1e-3, 0.1), slip_at_s=at_s),
    table(solver=one_of("fail", "nan", "lie", "raise", "outside", "rig", "malformed", "hang"),
          solver_share=some(0.01, 1.0)),
]  # fmt: skip
FAULTY = table(
    seed=whole(0, 2**31), robot=table(name=one_of(*available_robots())), start=st.just({"swivel": "random"}),
    faults=st.lists(st.one_of(FAULTS), min_size=1, max_size=4).map(lambda parts: dict(ChainMap(*reversed(parts)))),
    control=table(preset=one_of("tuned", "robust"), law=one_of("moc", "dcac")), plant=table(delay_ticks=whole(0, 2)),
)  # fmt: skip


@many(0.1)
@given(FAULTY)
def test_under_several_faults_at_once_a_run_completes_or_the_arm_is_stopped_and_at_rest(case):
    setup = Setup(Scenario(**case, duration_s=1.8, **QUICK))
    trace = setup.trace()
    ended = Ending.of(trace.meta["ended"])
    assert (np.abs(trace.tau_Nm) <= setup.robot.tau_max * (1.0 + 1e-12)).all()
    if ended is Ending.STOPPED:
        whole = trace.meta["ticks"] < trace.meta["ticks_planned"]  # the end of the run did not cut the stop off
        assert not whole or np.abs(trace.v_rad_per_s[-1]).max() <= 0.05
    else:
        assert ended in (Ending.COMPLETED, Ending.OSCILLATED)
        square = np.convolve((trace.trocar_force_N**2).sum(axis=1), np.full(50, 0.02), "valid").max()
        assert square <= PRESSED_N**2
