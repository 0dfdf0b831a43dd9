"""The one step of every closed loop: a reason of the safety filter stops the arm in the loops without a trace too."""

import numpy as np
import pytest

from moc_opt.control.safety_filter import SafetyFilterSettings
from moc_opt.live import LiveRun
from moc_opt.scenario import Scenario, Setup
from moc_opt.sim import Plant
from moc_opt.vision.hands_on import HandsOnSettings, HandsOnStatus, guide_to

QUICK = {"bound_samples": 0, "judge": False, "duration_s": 1.2}


def live(scenario):
    """Reason, when, and the joints' last speeds (n,), of the live page's run."""
    run = LiveRun(scenario.change(duration_s=None))
    run.advance(round(QUICK["duration_s"] / run.period_s))
    at = run.t_s
    run.advance(10)
    assert not run.stopped or run.t_s == at  # nothing goes on
    return run.stopped, at - scenario.guard.stop_s, run._setup.plant.v


def procedure(scenario):
    """The same of hand guiding: it has neither a reference nor a trocar."""
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
def test_a_reason_of_the_safety_filter_stops_every_loop(loop, reason, guard, monkeypatch):
    measure = Plant.measure

    def broken(plant):
        """Encoders that show NaN from 0.2 s on."""
        seen = measure(plant)
        return seen._replace(q=seen.q + np.nan) if plant.time > 0.2 else seen

    if reason == NOT_BELIEVED:
        monkeypatch.setattr(Plant, "measure", broken)
    ended, at, speed = loop(Scenario(control={"preset": "tuned"}, guard=guard, **QUICK))
    assert reason in ended
    assert at == pytest.approx(0.208, abs=0.003) if "believed" in reason else 0.0 < at < 0.9
    assert np.abs(speed).max() < 0.02  # the brakes hold


def test_the_stop_is_simulated_for_as_long_as_it_says(robot):
    """One more step than fits into the time, the one that ordered it; the arm is braked from that step on."""
    setup = Setup(Scenario(**QUICK))
    loop = setup.closed_loop(setup.controller())
    loop.filtered._filter.request_stop("for a test")  # before the start: it forgets this
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
