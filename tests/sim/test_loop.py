"""The closed loop itself: who gets what, what is written down, and when."""

import gc

import numpy as np
import pytest

from moc_opt.errors import PlantError
from moc_opt.scenario import Scenario, run
from moc_opt.sim import Plant, PlantSettings
from moc_opt.sim.loop import no_collector, simulate
from moc_opt.tasks import shaft_distance

TICKS = 25


class Holding:
    """Holds the arm by the model's gravity and some damping, and remembers what it was shown."""

    def __init__(self, robot, push=3.0):
        self.robot, self.push = robot, push
        self.started, self.seen, self.order = [], [], []

    def start(self, *given):
        """Remember the first measurement."""
        self.started.append([each.copy() for each in given])

    def tick(self, q, v, tip_ref, trocar):
        """Gravity, damping and a push on joint 1."""
        self.order.append("tick")
        self.seen.append((q.copy(), v.copy(), tip_ref.copy(), trocar.copy()))
        return self.robot.gravity(q) - 5.0 * v + self.push * np.eye(7)[0]

    def columns(self, ticks):
        """One column of its own."""
        return {"extra": np.zeros(ticks)}

    def note(self, row, columns):
        """The number of ticks so far."""
        self.order.append("note")
        columns["extra"][row] = len(self.seen)


@pytest.fixture(scope="module")
def references(robot):
    """Recognizable tip references, true and registered trocars: every tick its own number."""
    s, k = robot.state(robot.data.q_home), np.arange(TICKS, dtype=float)
    tip_refs, trocars = np.zeros((TICKS, 3, 3)), np.zeros((TICKS, 2, 3))
    tip_refs[:, 0] = s.tip + 1e-4 * k[:, None]
    tip_refs[:, 1] = 1e-3 * k[:, None]
    trocars[:, 0] = s.tip - 0.15 * s.tool_direction + [1e-3, 0.0, 0.0] + 1e-5 * k[:, None]
    return tip_refs, trocars, trocars + np.array([[0.0, 5e-4, 0.0], np.zeros(3)])


def ready(robot, settings=None):
    plant = Plant(robot.data, PlantSettings.nominal() if settings is None else settings)
    plant.reset(robot.data.q_home)
    return plant


def test_one_row_a_tick_the_state_at_its_start(robot, references):
    """What the trace says is what the plant's own truths were before each step, and errors count from these."""
    tip_refs, trocars, registered = references
    trace = simulate(ready(robot), Holding(robot), *references)
    plant, brain = ready(robot), Holding(robot)
    assert len(trace) == TICKS
    for k in range(TICKS):
        assert trace.t_s[k] == pytest.approx(plant.time, abs=1e-12)
        for column, truth in (
            (trace.q_rad, plant.q), (trace.v_rad_per_s, plant.v), (trace.tip_m, plant.tip),
            (trace.wrist_m, plant.wrist), (trace.trocar_force_N, plant.trocar_force),
        ):  # fmt: skip
            np.testing.assert_array_equal(column[k], truth)
        seen = plant.measure()
        np.testing.assert_array_equal(np.r_[trace.force_N[k], trace.torque_Nm[k]], seen.force)
        tau = brain.tick(seen.q, seen.v, tip_refs[k], registered[k])
        np.testing.assert_array_equal(trace.tau_Nm[k], tau)
        plant.step(tau, trocars[k])
    assert np.linalg.norm(trace.q_rad[-1] - trace.q_rad[0]) > 1e-4  # it does move
    np.testing.assert_allclose(trace.tip_error_m, np.linalg.norm(tip_refs[:, 0] - trace.tip_m, axis=1), atol=1e-15)
    np.testing.assert_allclose(trace.rcm_error_m, shaft_distance(trace.tip_m, trace.wrist_m, trocars[:, 0]))
    assert trace.rcm_error_m.max() > 1e-4


def test_the_brain_is_shown_measurements_and_the_registered_trocar(robot, references):
    tip_refs, trocars, registered = references
    brain = Holding(robot, 0.0)
    trace = simulate(ready(robot, PlantSettings.realistic()), brain, *references)
    assert len(brain.started) == 1
    np.testing.assert_array_equal(brain.started[0][3], registered[0])
    for k, (q, v, tip_ref, trocar) in enumerate(brain.seen):
        np.testing.assert_array_equal(tip_ref, tip_refs[k])
        np.testing.assert_array_equal(trocar, registered[k])
        assert 0.0 < np.abs(q - trace.q_rad[k]).max() < 1e-3  # noise: measured, not true
        assert v.shape == (7,)
    np.testing.assert_array_equal(trace.trocar_m, trocars[:, 0])
    np.testing.assert_array_equal(trace.trocar_registered_m, registered[:, 0])


def test_the_plant_is_given_the_true_trocar(robot, references):
    """With the true trocar on the shaft there is no force, wherever the controller believes it to be."""
    s = robot.state(robot.data.q_home)
    tip_refs, _, registered = (each[:5] for each in references)
    on = np.zeros_like(registered)
    on[:, 0] = s.tip - 0.15 * s.tool_direction
    away = on + np.array([[5e-3, 0.0, 0.0], np.zeros(3)])
    forces = [
        np.abs(simulate(ready(robot), Holding(robot, 0.0), tip_refs, true, told).trocar_force_N).max()
        for true, told in ((on, registered), (away, on))
    ]
    assert forces[0] < 1e-2
    assert forces[1] > 1.0


def test_a_tick_is_timed_before_it_is_written_down_and_no_garbage_is_collected_meanwhile(robot, references):
    brain, watched = Holding(robot), []
    trace = simulate(
        ready(robot), brain, *references, watch=lambda k: watched.append((k, len(brain.seen), gc.isenabled()))
    )
    assert watched == [(k, k, False) for k in range(TICKS)]  # before each tick
    assert gc.isenabled()
    assert brain.order == ["tick", "note"] * TICKS
    assert 0.0 < trace.tick_us.min() <= np.median(trace.tick_us) < 1e5
    np.testing.assert_array_equal(trace.extra, np.arange(1, TICKS + 1))


def test_meta_and_time(robot, references):
    plant = ready(robot, PlantSettings.nominal(period_s=0.004, substeps=4))
    trace = simulate(plant, Holding(robot), *references, meta={"answer": 42})
    counted = {"ticks": TICKS, "ticks_planned": TICKS}
    assert dict(trace.meta) == {"period_s": 0.004, "ended": "completed", "answer": 42, **counted}
    np.testing.assert_allclose(np.diff(trace.t_s), 0.004)
    more = simulate(plant, Holding(robot), *references)
    assert more.t_s[0] == pytest.approx(trace.t_s[-1] + 0.004)  # goes on from the plant's present state


def test_the_collector_comes_back_after_an_error_and_stays_off_where_it_was(robot, references):
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


def test_the_registered_rcm_error_is_the_true_shaft_s_distance_from_what_the_controller_was_told():
    trace = run(Scenario(duration_s=0.1, judge=False, bound_samples=0))
    u = (trace.tip_m - trace.wrist_m) / np.linalg.norm(trace.tip_m - trace.wrist_m, axis=1)[:, None]
    for trocar, found in (
        (trace.trocar_m, trace.rcm_error_m), (trace.trocar_registered_m, trace.rcm_error_registered_m)
    ):  # fmt: skip
        away = np.linalg.norm(np.cross(trocar - trace.tip_m, u), axis=1)
        np.testing.assert_allclose(found, away, rtol=1e-9, atol=1e-12)
    assert abs(trace.rcm_error_m - trace.rcm_error_registered_m).max() > 1e-4  # the registration is 0.5 mm off
