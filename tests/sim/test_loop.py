"""The closed loop."""

import gc

import numpy as np
import pytest

from moc_opt.control.safety_filter import SafetyFilterSettings
from moc_opt.errors import PlantError
from moc_opt.live import LiveRun
from moc_opt.scenario import Scenario, Setup
from moc_opt.sim import Plant, PlantSettings
from moc_opt.sim.loop import no_collector, simulate
from moc_opt.sim.record import RunAway, TaskOffset
from moc_opt.vision.hands_on import HandsOnSettings, HandsOnStatus, guide_to

TICKS = 25


class Holding:
    def __init__(self, robot, push=3.0):
        self.robot, self.push = robot, push
        self.started, self.seen, self.order = [], [], []

    def start(self, *given):
        self.started.append([np.array(each) for each in given])

    def tick(self, q, v, tip_ref, trocar):
        self.order.append("tick")
        self.seen.append([np.array(each) for each in (q, v, tip_ref, trocar)])
        return self.robot.gravity(q) - 5.0 * v + self.push * np.eye(7)[0]

    def columns(self, ticks):
        return {"extra": np.zeros(ticks)}

    def note(self, row, columns):
        self.order.append("note")
        columns["extra"][row] = len(self.seen)


@pytest.fixture(scope="module")
def references(robot):
    """Return tip references, true trocars and registered trocars of every tick."""
    s, k = robot.state(robot.data.q_home), np.arange(TICKS, dtype=float)
    tip_refs, trocars = np.zeros((TICKS, 3, 3)), np.zeros((TICKS, 2, 3))
    tip_refs[:, 0] = s.tip + 1e-4 * k[:, None]
    tip_refs[:, 1] = 1e-3 * k[:, None]
    trocars[:, 0] = s.tip - 0.15 * s.tool_direction + [1e-3, 0.0, 0.0] + 1e-5 * k[:, None]
    return tip_refs, trocars, trocars + np.array([[0.0, 5e-4, 0.0], np.zeros(3)])


def ready(robot, settings=None):
    plant = Plant(robot.data, settings or PlantSettings.nominal())
    plant.reset(robot.data.q_home)
    return plant


def test_each_tick_records_the_state_at_its_start(robot, references):
    """The controller gets the registered trocar, and the plant the true one."""
    tip_refs, trocars, registered = references
    brain, plant = Holding(robot), ready(robot, PlantSettings())
    offset = TaskOffset(np.array([1e-3, 2e-3, 0.0]), np.array([0.0, 1e-3, 3e-3]))
    trace = simulate(ready(robot, PlantSettings()), brain, *references, offset=offset)
    assert len(trace) == TICKS
    (started,) = brain.started
    for given, first in zip(started, brain.seen[0], strict=True):
        np.testing.assert_array_equal(given, first)
    for k in range(TICKS):
        assert trace.t_s[k] == pytest.approx(plant.time, abs=1e-12)
        for column, truth in (
            (trace.q_rad, plant.q), (trace.v_rad_per_s, plant.v), (trace.tip_m, plant.tip),
            (trace.wrist_m, plant.wrist), (trace.trocar_force_N, plant.trocar_force),
        ):  # fmt: skip
            np.testing.assert_array_equal(column[k], truth)
        seen = plant.measure()
        np.testing.assert_array_equal(np.r_[trace.force_N[k], trace.torque_Nm[k]], seen.force)
        for given, shown in zip(brain.seen[k], (seen.q, seen.v, tip_refs[k], registered[k]), strict=True):
            np.testing.assert_array_equal(given, shown)
        np.testing.assert_array_equal(trace.tau_Nm[k], tau := Holding(robot).tick(*brain.seen[k]))
        plant.step(tau, trocars[k])
    assert np.linalg.norm(trace.q_rad[-1] - trace.q_rad[0]) > 1e-4
    np.testing.assert_allclose(trace.tip_error_m, np.linalg.norm(tip_refs[:, 0] - trace.tip_m, axis=1), atol=1e-15)
    u = (trace.tip_m - trace.wrist_m) / np.linalg.norm(trace.tip_m - trace.wrist_m, axis=1)[:, None]
    away = np.linalg.norm(tip_refs[:, 0] + offset.tip - trace.tip_m, axis=1)
    np.testing.assert_allclose(trace.tip_error_registered_m, away, atol=1e-15)
    for place, which in ((trocars, ""), (registered + offset.trocar, "_registered")):
        np.testing.assert_array_equal(trace.columns[f"trocar{which}_m"], place[:, 0])
        away = np.linalg.norm(np.cross(place[:, 0] - trace.tip_m, u), axis=1)
        np.testing.assert_allclose(trace.columns[f"rcm_error{which}_m"], away, rtol=1e-9, atol=1e-12)
    assert np.abs(trace.rcm_error_m - trace.rcm_error_registered_m).max() > 1e-4


def test_no_garbage_is_collected_during_the_loop(robot, references):
    brain, watched = Holding(robot), []

    def watch(tick):
        watched.append((tick, len(brain.seen), gc.isenabled()))

    trace = simulate(ready(robot), brain, *references, watch=watch)
    assert watched == [(k, k, False) for k in range(TICKS)]  # watch is called before each tick
    assert gc.isenabled()
    assert brain.order == ["tick", "note"] * TICKS
    assert 0.0 < trace.tick_us.min() <= np.median(trace.tick_us) < 1e5
    np.testing.assert_array_equal(trace.extra, np.arange(1, TICKS + 1))


def test_meta_describes_the_run(robot, references):
    plant = ready(robot, PlantSettings.nominal(period_s=0.004, substeps=4))
    trace, ticks = simulate(plant, Holding(robot), *references, meta={"answer": 42}), ("ticks", "ticks_planned")
    assert trace.meta == {"period_s": 0.004, "ended": "completed", "answer": 42, **dict.fromkeys(ticks, TICKS)}
    np.testing.assert_allclose(np.diff(trace.t_s), 0.004)
    more = simulate(plant, Holding(robot), *references)
    assert more.t_s[0] == pytest.approx(trace.t_s[-1] + 0.004)


def test_loop_restores_the_garbage_collectors_state(robot, references):
    with pytest.raises(PlantError, match="not finite"):
        simulate(ready(robot), Holding(robot, float("nan")), *references)
    assert gc.isenabled()
    gc.disable()
    try:
        with no_collector():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_error_for_a_runaway_arm_contains_the_trace(robot, references):
    plant = ready(robot)

    def push(tick):
        plant.mj_data.qvel[:] += 1e6 * (tick == 5)

    with pytest.raises(RunAway, match=r"ran away at t = 0\.010 s") as said:
        simulate(plant, Holding(robot), *references, watch=push)
    assert len(said.value.trace) == 6


QUICK = {"bound_samples": 0, "judge": False, "duration_s": 1.2}


def live(scenario):
    """Run as the live page does. Return reason and time [s] of the stop, and final joint velocities (n,)."""
    run = LiveRun(scenario.change(duration_s=None))
    run.advance(round(QUICK["duration_s"] / run.period_s))
    at = run.t_s
    run.advance(10)
    assert not run.stopped or run.t_s == at  # no advance after a stop
    return run.stopped, at - scenario.guard.stop_s, run._setup.plant.v


def procedure(scenario):
    """Guide the arm by hand. Return the same values as `live`."""
    setup = Setup(scenario)
    incision = setup.plant.tip + np.array([0.05, 0.1, 0.1])
    found = guide_to(incision, setup.plant, setup.robot, HandsOnSettings(guard=scenario.guard, time_limit_s=1.2))
    assert (found.status, found.registered) == (HandsOnStatus.STOPPED, None)
    assert np.isfinite(found.trace.tau_Nm).all()
    return found.trace.meta["ended"], found.trace.t_s[-1] - scenario.guard.stop_s, setup.plant.v


NOT_BELIEVED = "measurements not believed"
FORCED = {"trocar_force_N": 0.1, "trocar_force_warning_N": 0.1}


@pytest.mark.parametrize(("loop", "reason", "guard"), [
    (live, NOT_BELIEVED, {}), (procedure, NOT_BELIEVED, {}), (live, "the tip has been", {"tip_error_m": 1e-5}),
    (live, "the trocar's force has been above", FORCED),
])  # fmt: skip
def test_live_run_and_hand_guiding_end_with_the_safety_filters_reason(loop, reason, guard, monkeypatch):
    measure = Plant.measure

    def broken(plant):
        seen = measure(plant)
        return seen._replace(q=seen.q + np.nan) if plant.time > 0.2 else seen

    if reason == NOT_BELIEVED:
        monkeypatch.setattr(Plant, "measure", broken)
    ended, at, speed = loop(Scenario(control={"preset": "tuned"}, guard=guard, **QUICK))
    assert reason in ended
    assert at == pytest.approx(0.208, abs=0.003) if "believed" in reason else 0.0 < at < 0.9
    assert np.abs(speed).max() < 0.02  # the brakes hold


def test_stop_is_simulated_for_stop_s(robot):
    """The time stop_s begins after the step that requests the stop."""
    setup = Setup(Scenario(**QUICK))
    loop = setup.closed_loop(setup.controller())
    loop.filtered._filter.request_stop("for a test")  # the loop's start clears this request
    references = setup.reference.rows(0.0), np.stack(setup.registered.at(0.0)), np.stack(setup.trocar.at(0.0))
    loop.start(*references[:2])
    for _ in range(5):
        loop.step(*references)
    assert (loop.stop_reason, loop.finished, loop.ticks) == ("", False, 5)
    free = np.array(setup.plant.mj_model.dof_damping)
    loop.filtered._filter.request_stop("for a test")
    steps = 0
    while not loop.finished:
        loop.step(*references)
        steps += 1
    assert steps == round(SafetyFilterSettings().stop_s / setup.plant.settings.period_s) + 1
    np.testing.assert_allclose(setup.plant.mj_model.dof_damping - free, 20.0)
    np.testing.assert_array_equal(loop.tau, loop.filtered._applied)
