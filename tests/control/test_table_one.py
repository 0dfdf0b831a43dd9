"""Table I of Su et al. (2019): every number, read from what a controller built with the `paper` preset really uses."""

import numpy as np
import pytest

from moc_opt.control import Controller, ControlSettings
from moc_opt.control.law import law_views
from moc_opt.scenario import Scenario, Setup
from moc_opt.solvers import create
from moc_opt.solvers.neural.projection import RNNPrinted
from tests.problems import random_problem

# Copied from the paper, not from the package.
TRACKING = {"dcac": [2000.0, 20.0, 600.0, 10.0], "moc": [3000.0, 30.0, 800.0, 10.0]}  # K_X, D_X, K_N, D_N
LAMBDA = 0.5
K_N2 = [80.0, 120.0, 60.0, 30.0, 20.0, 10.0, 10.0]
K_D2 = [6.0, 10.0, 5.0, 3.0, 2.0, 1.0, 1.0]
K_0, K, C_0, C_1, C_2 = 0.1, 0.1, 0.01, 0.01, 0.001


@pytest.fixture
def given(robot):
    """A state beside its references, moving."""
    rng = np.random.default_rng(0)
    state = robot.state(robot.data.q_home, rng.uniform(-0.05, 0.05, 7))
    tip_ref = np.vstack([state.tip + 1e-3, np.full(3, 0.01), np.zeros(3)])
    trocar = np.vstack([state.tip - 0.13 * state.tool_direction + 2e-3, np.zeros(3)])
    return state, tip_ref, trocar


def inputs(robot, given, law, solver=None):
    """A controller of the preset after one tick, and the constants that its compiled parts are given."""
    controller = Controller(robot, ControlSettings.preset("paper", law=law), solver)
    controller.start(*given)
    controller.tick(*given)
    return controller, law_views.py_func(controller._law, robot.n)


def test_dcac(robot, given):
    controller, law = inputs(robot, given, "dcac")
    assert list(law[:4]) == TRACKING["dcac"]
    assert (law.rcm_lambda, law.feedforward) == (LAMBDA, 0.0)
    assert controller.subproblem is None
    assert not law.K_N2.any()  # tau_d = tau_T + tau_N1
    assert not law.D_N2.any()
    assert not controller.external_torque.any()


@pytest.mark.parametrize("name", ["exact", "rnn-printed"])
def test_moc(robot, given, name):
    controller, law = inputs(robot, given, "moc", create(name))
    assert list(law[:4]) == TRACKING["moc"]
    assert (law.rcm_lambda, law.feedforward, law.k0) == (LAMBDA, 0.0, K_0)
    assert law.weights.tolist() == [C_0, C_1, C_2, 0.0]
    assert controller.subproblem.row[6 * 7 + 6 + 21 : 6 * 7 + 10 + 21].tolist() == [C_0, C_1, C_2, 0.0]
    np.testing.assert_array_equal(law.limits, [robot.q_min, robot.q_max, robot.v_max])
    assert law.K_N2.tolist() == K_N2
    assert law.D_N2.tolist() == K_D2
    assert controller._share == 1.0


def test_the_printed_network_starts_at_zero_and_has_the_printed_gain(robot, given):
    """The first answer is P(v + k (c2 grad_mu - c0 J_T^T (J_T v - dX_d) - c1 J_W^T (J_W v - dN_d))): no multipliers."""
    state = given[0]
    controller, _ = inputs(robot, given, "moc", create("rnn-printed"))
    qp = controller.subproblem
    slack_tip, slack_wrist = state.J_tip @ state.v - qp.v_tip, state.J_wrist @ state.v - qp.v_wrist
    push = C_2 * state.grad_mu - C_0 * state.J_tip.T @ slack_tip - C_1 * state.J_wrist.T @ slack_wrist
    lower = np.maximum(-robot.v_max, -K_0 * (state.q - robot.q_min))
    upper = np.minimum(robot.v_max, -K_0 * (state.q - robot.q_max))
    np.testing.assert_allclose(controller.answer, np.clip(state.v + K * push, lower, upper), rtol=0.0, atol=1e-15)
    # and the multipliers after it have integrated k (J v - v_ref) over 2 ms, with a time constant of 1 s
    slack = np.concatenate([slack_tip, slack_wrist])
    np.testing.assert_allclose(controller.solution.y, 0.002 * K * slack, rtol=1e-12, atol=1e-18)


def test_multipliers_are_zero_until_the_first_tick():
    qp = random_problem(np.random.default_rng(0), regularization=0.0)
    session = RNNPrinted().start(qp)
    at_rest = session.solve(qp)
    np.testing.assert_allclose(at_rest.x, np.clip(-K * qp.p, qp.lower, qp.upper), atol=1e-15)


def test_a_scenario_with_the_preset_has_the_same_table():
    """Through the scenario, whose defaults are not the paper's, and for the baseline with MOC's gains."""
    base = Scenario(control={"preset": "paper"})
    cases = {
        "moc": (base, "moc"),
        "own": (base.change(control={"law": "dcac"}), "dcac"),
        "matched": (base.change(control=base.control.matched_dcac()), "moc"),
    }
    for case, table in cases.values():
        found = case.control.resolve_gains(Setup(case).robot.data.gains, 7)
        assert list(found[:4]) == TRACKING[table]
        assert case.control.rcm_lambda == LAMBDA
