"""The momentum observer on an arm integrated here: it finds the torque that the model does not know of."""

import numpy as np
import pytest

from moc_opt.control.observer import MomentumObserver, momentum_residual
from moc_opt.errors import ControlError

PERIOD, FINE = 0.002, 4
DAMPING = np.array([8.0, 8.0, 6.0, 6.0, 2.0, 2.0, 1.0])


def simulate(robot, torque, external, ticks, gain=20.0, period=PERIOD, q=None, v=None):
    """Drive the model's own equations of motion; the observer's estimate after every tick.

    torque(state) is held over a tick, external(q, v) acts all the time; midpoint rule on a finer grid.
    """
    q = robot.data.q_home.copy() if q is None else q.copy()
    v = np.zeros(robot.n) if v is None else v.copy()
    observer = MomentumObserver(robot, gain, period)
    observer.start(robot.state(q, v))
    step, found = period / FINE, []
    for _ in range(ticks):
        tau = torque(robot.state(q, v))
        for _ in range(FINE):
            s = robot.state(q, v)
            half_v = v + 0.5 * step * np.linalg.solve(s.M, tau + external(q, v) - s.h)
            half_q = q + 0.5 * step * v
            s = robot.state(half_q, half_v)
            q, v = q + step * half_v, v + step * np.linalg.solve(s.M, tau + external(half_q, half_v) - s.h)
        found.append(observer.update(robot.state(q, v), tau).copy())
    return np.array(found), q, v


def hold(state):
    """Gravity compensation, and joint damping, so that the arm does not run away."""
    return state.h - DAMPING * state.v


@pytest.mark.parametrize("gain", [10.0, 40.0])
def test_finds_a_constant_torque_at_its_rate(robot, gain):
    """r follows the external torque like a first-order filter of rate K_o."""
    outside = np.array([3.0, -2.0, 1.5, 1.0, -0.5, 0.4, 0.2])
    ticks = 200
    found, _, v = simulate(robot, hold, lambda q, v: outside, ticks, gain)
    assert np.abs(v).max() > 0.1  # the arm gives way meanwhile
    filtered = 1.0 - (1.0 - gain * PERIOD) ** np.arange(1, ticks + 1)
    error = np.abs(found - filtered[:, None] * outside) / np.abs(outside).max()
    assert error.max() < 0.01
    half = int(np.argmax(found[:, 0] > 0.5 * outside[0])) + 1
    assert half * PERIOD == pytest.approx(np.log(2.0) / gain, rel=0.1)


def test_converges_to_the_torque(robot):
    outside = np.array([-4.0, 3.0, 2.0, -2.0, 1.0, 1.0, 0.3])
    found, _, _ = simulate(robot, hold, lambda q, v: outside, 250, gain=50.0)
    np.testing.assert_allclose(found[-1], outside, atol=0.01)


def test_zero_for_a_perfect_model(robot):
    """What is left in a fast motion is the quadrature's error, and goes down with the period."""
    start = np.array([0.6, -0.8, 0.5, 0.9, -0.7, 0.6, 0.5])
    swing = np.array([6.0, -4.0, 3.0, 2.0, -1.0, 1.0, 0.2])
    worst = []
    for period, ticks in ((0.002, 100), (0.001, 200)):
        found, _, v = simulate(
            robot, lambda s: s.h + swing, lambda q, v: np.zeros(7), ticks, period=period, v=start
        )
        assert np.abs(v).max() > 0.5
        worst.append(np.abs(found).max())
    assert worst[0] < 0.02 * np.abs(swing).max()
    assert worst[1] < 0.6 * worst[0]


def test_exactly_zero_at_rest(robot):
    q = robot.data.q_home
    found, _, v = simulate(robot, lambda s: s.h, lambda q, v: np.zeros(7), 50, q=q)
    np.testing.assert_allclose(found, 0.0, atol=1e-9)
    np.testing.assert_allclose(v, 0.0, atol=1e-10)


def test_takes_friction_for_an_external_torque(robot):
    """r settles on the torque of friction, Coulomb and viscous."""
    viscous = robot.data.viscous_friction

    def friction(q, v):
        return -viscous * v - robot.data.coulomb_friction * np.tanh(v / 0.01)

    push = np.array([4.0, -4.0, 3.0, 3.0, -2.0, 2.0, 1.0])
    found, q, v = simulate(robot, lambda s: s.h - DAMPING * s.v + push, friction, 300, gain=30.0)
    np.testing.assert_allclose(found[-1], friction(q, v), atol=0.15)
    assert np.abs(found[-1]).max() > 0.5


def test_start_forgets(robot):
    observer = MomentumObserver(robot, 20.0, PERIOD)
    moving = robot.state(robot.data.q_home, np.full(7, 0.5))
    observer.start(moving)
    first = [observer.update(moving, np.zeros(7)).copy() for _ in range(5)]
    assert np.abs(first[-1]).max() > 0.1
    observer.start(moving)
    np.testing.assert_array_equal(observer.external_torque, 0.0)
    again = [observer.update(moving, np.zeros(7)).copy() for _ in range(5)]
    np.testing.assert_array_equal(first, again)


def test_two_observers_share_nothing(robot):
    one, other = MomentumObserver(robot, 20.0, PERIOD), MomentumObserver(robot, 20.0, PERIOD)
    s = robot.state(robot.data.q_home, np.full(7, 0.5))
    one.start(s)
    other.start(s)
    one.update(s, np.full(7, 10.0))
    np.testing.assert_array_equal(other.external_torque, 0.0)


@pytest.mark.parametrize("form", ["compiled", "plain"])
def test_one_step_against_numpy(form, robot, regular_poses):
    """r = K_o (p - integral(tau + C^T v - g + r) dt)."""
    kernel = momentum_residual if form == "compiled" else momentum_residual.py_func
    rng = np.random.default_rng(2)
    for q in regular_poses(5):
        v, tau, integral, r = rng.normal(size=(4, 7))
        s, C = robot.state(q, v), robot.coriolis(q, v)
        wanted_integral = integral + (tau + C.T @ v - robot.gravity(q) + r) * PERIOD
        wanted = 25.0 * (s.M @ v - wanted_integral)
        kernel(s.M, s.energy_slope, s.gravity, s.v, tau, 25.0, PERIOD, integral, r)
        np.testing.assert_allclose(integral, wanted_integral, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(r, wanted, rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("gain", [0.0, -1.0, 500.0, 1e6, float("nan")])
def test_gain_out_of_range(robot, gain):
    with pytest.raises(ControlError, match=r"observer_gain_per_s = .* at a period of 0.002 s: keep it below 500$"):
        MomentumObserver(robot, gain, PERIOD)
