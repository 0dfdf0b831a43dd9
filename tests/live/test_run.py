"""LiveRun without its web page."""

from collections.abc import Callable
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from moc_opt.errors import ControlError, UnknownNameError
from moc_opt.live import LiveError, LiveRun
from moc_opt.live.run import DCAC, QUANTITIES, TROCAR_SPEED_M_PER_S, solver_of
from moc_opt.scenario import Scenario, Setup


@pytest.fixture
def run() -> LiveRun:
    """Return a run that starts far from the largest mu."""
    return LiveRun(Scenario(start={"swivel": 0.2}, plant={"preset": "nominal"}))


def column(run: LiveRun, name: str, ticks: int) -> Any:
    return run.history(10**6)[-ticks:, QUANTITIES.index(name)]


def test_live_run_equals_the_run_of_its_scenario() -> None:
    scenario = Scenario(start={"swivel": 0.2}, duration_s=0.6, judge=False, bound_samples=0)
    trace = Setup(scenario).trace()
    run = LiveRun(scenario.change(duration_s=None))
    run.advance(len(trace))
    for name in ("t_s", "tip_error_m", "rcm_error_m"):
        np.testing.assert_allclose(column(run, name, len(trace)), trace.columns[name], atol=1e-9)
    force = np.linalg.norm(trace.trocar_force_N, axis=1)
    np.testing.assert_allclose(column(run, "force_N", len(trace)), force, atol=1e-6)


def test_solver_is_exchanged_at_the_next_tick_but_not_soon_after_another_exchange(run: LiveRun) -> None:
    run.advance(5)
    assert solver_of(run.used) == "exact"
    run.choose("rnn")
    assert solver_of(run.used) == "exact", "not before the next tick"
    run.advance(1)
    assert solver_of(run.used) == run.solver != "exact"
    run.choose(DCAC)
    run.advance(1)
    assert solver_of(run.used) != DCAC, "not within BLEND_S after the previous exchange"
    run.advance(79)
    assert run.used.solution is None
    assert np.isnan(column(run, "solve_us", 30)).all()
    run.choose("exact")
    run.advance(80)
    assert (column(run, "solve_us", 30) > 0.0).all()
    assert not run.messages


@pytest.mark.parametrize("change", [
    lambda run: run.choose(DCAC), lambda run: run.tune(K_X=1500.0, K_N=300.0, observer_gain_per_s=0.0),
])  # fmt: skip
def test_change_of_law_or_gains_does_not_jerk_the_arm(change: Callable[[LiveRun], None]) -> None:
    run = LiveRun(Scenario(start={"swivel": 0.9}))
    run.advance(400)
    sent: list[Any] = []
    for k in range(150):
        if k == 50:
            change(run)
        run.advance(1)
        sent.append(run._loop.tau)
    steps = np.abs(np.diff(sent, axis=0)).max(axis=1)
    assert steps[49] <= 1.5 * steps[:49].max()
    assert steps[50:].max() < 3.0 * steps[:49].max()
    assert column(run, "tip_error_m", 100).max() < 2e-3
    assert not run.messages


def test_run_goes_on_after_wrong_requests(run: LiveRun) -> None:
    run.advance(20)
    before = run.control
    for kind, orders in {
        UnknownNameError: (lambda: run.choose("exat"), lambda: run.tune(rho=1e-5)),
        ControlError: (lambda: run.tune(regularization=-1.0),),
        LiveError: (
            lambda: run.tune(law="dcac"), lambda: run.tune(third_level="planned"), lambda: run.place_trocar(0.2, 0.0),
            lambda: run.place_trocar(float("nan"), 0.0), lambda: run.place_trocar("a", 0.0),  # type: ignore[arg-type]
            lambda: LiveRun(Scenario().change(control={"third_level": "planned"})),
        ),
    }.items():  # fmt: skip
        for order in orders:
            with pytest.raises(kind):
                order()
    assert run.control == before
    run.advance(20)
    assert run.t_s == pytest.approx(0.08, abs=0.003)
    assert solver_of(run.used) == run.solver == "exact"


def test_unusable_solver_gives_a_message(run: LiveRun) -> None:
    run.advance(10)
    controller = run._build(run.control, "exact")
    controller.solver = Mock(supports=lambda qp: "it is not in the mood")
    run._in_use.next = controller
    run.advance(10)
    assert "not in the mood; exact stays in use" in run.messages.popleft()
    assert solver_of(run.used) == run.solver == "exact"
    assert run.t_s == pytest.approx(0.038)


def test_runaway_arm_is_stopped(run: LiveRun) -> None:
    run.advance(50)
    run._setup.plant.mj_data.qvel[:] = 1e6
    run.advance(100)
    at = run.t_s
    assert "stopped at" in run.stopped
    assert "reset" in run.messages[-1]
    run.advance(100)
    assert run.t_s == at, "nothing moves"
    run.tune(K_X=2000.0)
    run.reset()
    run.advance(500)
    assert run.used.settings.K_X == run.control.K_X == 2000.0
    assert not run.stopped
    assert run.t_s == pytest.approx(0.998)
    assert column(run, "tip_error_m", 50).max() < 1e-3


def test_trocar_moves_at_the_speed_limit(run: LiveRun) -> None:
    run.advance(10)
    start, asked = run.trocar, np.array([0.005, -0.0025, 0.001])
    run.place_trocar(*asked)
    places = []
    for _ in range(400):
        run.advance(1)
        places.append(run.trocar)
    speeds = np.diff(places, axis=0) / run.period_s
    np.testing.assert_allclose(speeds[1:100], np.tile(TROCAR_SPEED_M_PER_S * asked / np.linalg.norm(asked), (99, 1)))
    np.testing.assert_allclose(places[-1] - start, asked, atol=1e-9)
    assert column(run, "rcm_error_m", 100).max() < 3e-3, "the controller knows where the trocar is"
    run.reset()
    run.advance(300)
    np.testing.assert_allclose(run.trocar - start, asked, atol=1e-9)


def test_errors_stay_small_with_requests_at_every_tick(run: LiveRun) -> None:
    """The controller is exchanged at most once in 0.1 s."""
    rng = np.random.default_rng(0)
    for _ in range(400):
        run.choose(str(rng.choice([DCAC, "exact", "rnn"])))
        run.advance(1)
    assert not run.messages
    assert column(run, "tip_error_m", 400).max() < 1e-3
    assert column(run, "rcm_error_m", 400).max() < 3e-3


def test_path_is_followed_back_and_forth() -> None:
    run = LiveRun(Scenario(task={"path": "spiral"}))
    one_way = run._setup.duration_s
    times = np.linspace(0.0, 2.5 * one_way, 4001)
    rows = np.array([run.rows(float(t)) for t in times])
    np.testing.assert_allclose(rows[:, 0], [run.rows(abs(2.0 * one_way - t))[0] for t in times], atol=1e-9)
    np.testing.assert_allclose(np.gradient(rows[:, 0], times, axis=0)[2:-2], rows[2:-2, 1], atol=1e-3)
