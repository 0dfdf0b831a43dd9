"""Hold, then weight and damping, then brakes; a reading that is not finite is never used."""

from __future__ import annotations

import numpy as np
import pytest

from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.realtime.settings import WireSettings
from moc_opt.realtime.watchdog import Watchdog
from moc_opt.scenario import Scenario, make_safety_filter
from moc_opt.sim.sensors import Measurement

SETTINGS = WireSettings(hold_ticks=2, damp_ticks=3, damping_Nm_s_per_rad=4.0)


@pytest.fixture
def watched(robot):
    first = Measurement(np.array(robot.data.q_home), np.zeros(robot.n), np.zeros(6))
    guard = make_safety_filter(robot, Scenario(guard=SafetyFilterSettings().model_dump()))
    return Watchdog(SETTINGS, guard, first), first


def test_the_torque_is_held_then_carries_the_weight_then_the_brakes_close(watched, robot):
    dog, first = watched
    held = np.arange(robot.n) - 3.0
    moving = first._replace(v=np.full(robot.n, 0.1))
    dog.see(moving)
    for _ in range(SETTINGS.hold_ticks):
        np.testing.assert_array_equal(dog.tick(held), held)
    weight = robot.gravity(first.q)
    for _ in range(SETTINGS.damp_ticks):
        np.testing.assert_allclose(dog.tick(weight), weight - 4.0 * moving.v, atol=1e-9)
        assert not dog.reason
    dog.tick(weight)
    assert dog.reason == "no command from the controller for 6 ticks"
    assert (dog.brake_friction() > 0.0).all()


def test_a_command_in_time_begins_the_count_anew(watched, robot):
    dog, _ = watched
    held = np.ones(robot.n)
    for _ in range(20):
        dog.tick(held)
        dog.tick(held)
        dog.feed()
    np.testing.assert_array_equal(dog.tick(held), held)
    assert not dog.reason


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["q", "v"])
def test_a_reading_that_is_not_finite_is_passed_over(watched, robot, name, wrong):
    dog, first = watched
    weight = robot.gravity(first.q)
    dog.see(first._replace(v=np.full(robot.n, 0.1)))
    bad = np.array(getattr(first, name))
    bad[3] = wrong
    dog.see(first._replace(**{name: bad}))
    for _ in range(SETTINGS.hold_ticks):
        dog.tick(weight)
    np.testing.assert_allclose(dog.tick(weight), weight - 0.4, atol=1e-9)
