"""What a controller can be told: gains, presets, and the paper's Table I, read from what the core is given."""

import json

import numpy as np
import pytest

from moc_opt.control import Controller, ControlSettings
from moc_opt.control.law import box_limits, numbers_of
from moc_opt.errors import ControlError, ScenarioError, UnknownNameError
from moc_opt.robots.model import load_robot
from moc_opt.scenario import Scenario, Setup
from moc_opt.solvers import create
from moc_opt.solvers.rnn import RNNPrinted
from tests.problems import random_problem

# --- gains: from the settings, or from the tables of the robot's file ---

TABLES = {
    "dcac": {"K_X": 2000.0, "D_X": 80.0, "K_N": 600.0, "D_N": 60.0},
    "moc": {"K_X": 3000.0, "D_X": 80.0, "K_N": 800.0, "D_N": 60.0, "K_N2": 80.0, "D_N2": 1.0},
    "default": {"K_X": 2500.0, "D_X": 50.0, "K_N": 700.0, "D_N": 40.0, "K_N2": [1.0, 2.0, 3.0], "D_N2": 2.0},
}
MOC = ControlSettings(gains="moc")


def test_which_table_is_taken_and_that_a_setting_beats_it():
    assert ControlSettings().resolve_gains(TABLES, 3).K_X == 2500.0
    assert ControlSettings(law="dcac").resolve_gains(TABLES, 3).K_X == 2500.0
    assert ControlSettings(gains=None).resolve_gains(TABLES, 3).K_X == 3000.0
    assert ControlSettings(gains=None, law="dcac").resolve_gains(TABLES, 3).K_X == 2000.0
    found = MOC.model_copy(update={"K_X": 123.0, "D_N2": 0.0}).resolve_gains(TABLES, 7)
    assert (found.K_X, found.K_N, found.D_N2.any()) == (123.0, 800.0, False)


@pytest.mark.parametrize("settings", [
    ControlSettings(), ControlSettings(gains=None), ControlSettings(gains="moc", K_X=1234.0), ControlSettings.paper(),
    ControlSettings.tuned(), ControlSettings.robust(), ControlSettings(law="dcac", gains=None),
    ControlSettings(third_level="planned"), ControlSettings(third_level="receding", observer_gain_per_s=0.0),
])  # fmt: skip
def test_the_matched_baseline_has_the_same_gains(settings, robot):
    """DCAC with the table, and the settings on top of it, that the given law uses; the observer's gain too."""
    given = settings.resolve_gains(robot.data.gains, 7)
    changed = ControlSettings(**{**settings.model_dump(), **settings.matched_dcac()})
    matched = changed.resolve_gains(robot.data.gains, 7)
    assert changed.law == "dcac"
    assert matched[:4] == given[:4]
    assert not matched.K_N2.any()
    assert changed.observer_rate_per_s == settings.observer_rate_per_s


def test_one_number_or_one_per_joint():
    """From the settings, also through JSON, and from the robot's table alike."""
    given = ControlSettings(gains="moc", K_N2=[3, 2, 1.5], dcac_damping=(0.0, 1.0, 0.0))
    assert ControlSettings(**json.loads(given.model_dump_json())) == given
    numbers = given.resolve_gains(TABLES, 3)
    np.testing.assert_array_equal(numbers.K_N2, [3.0, 2.0, 1.5])
    np.testing.assert_array_equal(numbers.D_N2, [1.0, 1.0, 1.0])
    np.testing.assert_array_equal(ControlSettings().resolve_gains(TABLES, 3).K_N2, [1.0, 2.0, 3.0])
    assert given.damps_dcac
    assert not ControlSettings(dcac_damping=[0.0, 0.0]).damps_dcac


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf"), (1.0, 2.0), "stiff"])
@pytest.mark.parametrize("gain", ["D_X", "K_N2"])
def test_a_bad_number_in_the_robot_s_table(gain, value):
    with pytest.raises(ControlError, match=rf"{gain} = .* in \[gains.moc\] of the robot"):
        MOC.resolve_gains({"moc": {**TABLES["moc"], gain: value}}, 7)


@pytest.mark.parametrize(("settings", "joints", "words"), [
    ({"gains": "mocc"}, 7, "'mocc': did you mean 'moc'"), ({"gains": "dcac"}, 7, r"K_N2: not set, and \[gains.dcac\]"),
    ({"gains": "moc", "K_N2": [3, 2, 1]}, 7, "K_N2 = .* has 3 entries for 7 joints"),
    ({}, 2, r"K_N2 = .* in \[gains.default\] of the robot has 3 entries for 2"),
    ({"gains": {"K_N2": 80.0}}, 7, r"gains = .*keys of \[control\]"),
])  # fmt: skip
def test_gains_that_are_missing_or_do_not_fit(settings, joints, words):
    with pytest.raises((ControlError, UnknownNameError), match=words):
        ControlSettings(**settings).resolve_gains(TABLES, joints)
    assert not ControlSettings(law="dcac", gains="dcac").resolve_gains(TABLES, 7).K_N2.any()  # not needed


def test_dampings_of_another_number_of_joints(robot):
    with pytest.raises(ControlError, match=r"dcac_damping = .* has 2 entries for 7 joints"):
        Controller(robot, ControlSettings(law="dcac", dcac_damping=[1.0, 2.0]), None)


# --- the other settings ---


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("K_X", 0.0), ("K_X", -1.0), ("D_X", -1.0), ("K_N", 0.0), ("K_N2", -1.0), ("D_N2", -0.1), ("k0_per_s", 0.0),
        ("c0", -0.01), ("c1", float("nan")), ("c2", -1e-3), ("regularization", -1e-9), ("observer_gain_per_s", -1.0),
        ("dcac_damping", -1.0), ("K_N2", [1.0, -1.0]), ("D_N2", "soft"), ("dcac_damping", [float("nan")]),
        ("law", "both"), ("projector", "kinetic"), ("fallback", "stop"), ("limit_torque", "perhaps"),
        ("feedforward", 3), ("rcm_lambda", 0.0), ("rcm_lambda", 1.1), ("speed_fraction", 0.0), ("speed_fraction", 1.5),
        ("ramp_s", -0.1), ("limit_margin_rad", -0.1), ("limit_margin_m", -0.1),
    ],
)  # fmt: skip
def test_wrong_values(field, value):
    with pytest.raises(ControlError, match=rf"\[control\] {field} = "):
        ControlSettings(**{field: value})


def test_unknown_names():
    with pytest.raises(UnknownNameError, match=r"\[control\] key 'k0'"):
        ControlSettings(k0=2.0)
    with pytest.raises(UnknownNameError, match=r"control preset 'papr': did you mean 'paper'"):
        ControlSettings.preset("papr")


def test_presets_by_name():
    assert ControlSettings.preset("paper", law="dcac") == ControlSettings.paper(law="dcac")
    assert ControlSettings.preset("tuned") == ControlSettings.tuned()
    softer = ControlSettings.tuned(gains="robust", observer_gain_per_s=22.0, course_observer_gain_per_s=22.0)
    assert ControlSettings.preset("robust") == softer
    assert ControlSettings.tuned(K_N=900.0).K_N == 900.0
    default = ControlSettings()
    assert 1e-3 <= default.regularization / default.c2 <= 1e-1


def test_under_a_course_the_box_leaves_the_course_its_speed_and_what_differs_from_it_is_damped(robot):
    rows = {}
    for level in ("local", "planned"):
        settings = ControlSettings(third_level=level)
        rows[level] = numbers_of(settings, robot, 0.002)
        assert settings.limit_margins(robot.chain.prismatic)[0] == {"local": 0.15, "planned": 0.05}[level]
    local, planned = rows["local"], rows["planned"]
    np.testing.assert_allclose(planned["v_max"], robot.v_max)
    np.testing.assert_allclose(local["v_max"], 0.5 * robot.v_max)
    # At x = v no torque: a speed that is wanted is not damped, a speed that is not wanted as much as ever.
    np.testing.assert_array_equal(planned["D_N2"], 0.0)
    np.testing.assert_allclose(planned["K_N2"], local["K_N2"] + local["D_N2"])
    assert local["D_N2"].max() > 0.0
    assert (local["k0"], planned["k0"]) == (2.0, 10.0)


def test_the_observer_under_a_course_has_its_own_gain_and_stays_off_where_it_is_off():
    assert ControlSettings().observer_rate_per_s == 20.0
    assert ControlSettings(third_level="receding").observer_rate_per_s == 40.0
    assert ControlSettings(third_level="receding", observer_gain_per_s=0.0).observer_rate_per_s == 0.0
    for name in ("tuned", "robust"):  # found together with the gains: the delay that the loop bears depends on it
        planned = ControlSettings.preset(name, third_level="planned")
        assert planned.observer_rate_per_s <= ControlSettings.preset(name).observer_gain_per_s


# --- the box ---


def test_box_limits(robot):
    found = box_limits(robot.q_min, robot.q_max, robot.v_max, margin=0.1, speed_fraction=0.25)
    np.testing.assert_array_equal(found, [robot.q_min + 0.1, robot.q_max - 0.1, 0.25 * robot.v_max])
    with pytest.raises(ControlError, match=r"limit_margin_rad = 3.0: nothing is left of joint 2"):
        Controller(robot, ControlSettings(limit_margin_rad=3.0), create("exact"))


def test_a_sliding_joint_has_its_margin_in_metres():
    rail = load_robot("lwr4_rail")
    margins = ControlSettings(limit_margin_rad=0.2, limit_margin_m=0.03).limit_margins(rail.chain.prismatic)
    np.testing.assert_array_equal(margins, [0.03, *[0.2] * 7])
    lower = numbers_of(ControlSettings(limit_margin_m=0.03), rail, 0.002)["q_min"]
    np.testing.assert_allclose(lower - rail.q_min, [0.03, *[0.15] * 7], rtol=0, atol=1e-15)


def test_a_wall_inside_the_box_is_refused():
    with pytest.raises(ScenarioError, match=r"guard.position_margin_rad = 0.2: .*limit_margin_rad = 0.15"):
        Scenario(guard={"position_margin_rad": 0.2})
    with pytest.raises(ScenarioError, match=r"guard.position_margin_m = 0.1: .*limit_margin_m = 0.05"):
        Scenario(guard={"position_margin_m": 0.1})
    for control in ({"limit_margin_rad": 0.2}, {"law": "dcac"}, {"preset": "paper"}):  # no box, or the paper's
        Scenario(guard={"position_margin_rad": 0.2}, control=control)


@pytest.mark.parametrize("length", [0.15, 0.3, 0.6])
def test_the_shafts_margin_grows_with_the_square_of_the_lever(length):
    """With the tip held the wrist moves by its distance from the tip times the shaft's turn, in two directions."""
    robot = load_robot("gen3", tool_length=length)
    lever = length + 0.061525 + 0.10593
    law = numbers_of(ControlSettings(shaft_margin=0.2, speed_fraction=0.4), robot, 0.002)
    assert law["shaft_margin"] == pytest.approx(0.2 * lever**2)
    assert law["spare_speed"] == pytest.approx(1.5)
    paper = numbers_of(ControlSettings.preset("paper"), robot, 0.002)
    assert (paper["shaft_margin"], paper["spare_speed"]) == (0.0, 0.0)


# --- Table I of Su et al. (2019), copied from the paper, not from the package ---

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
    """A controller of the preset after one tick, and the numbers that the core is given."""
    settings = ControlSettings.preset("paper", law=law)
    controller = Controller(robot, settings, solver)
    state, *references = given
    controller.start(state.q, state.v, *references)
    controller.tick(state.q, state.v, *references)
    return controller, numbers_of(settings, robot, 0.002)


def test_table_one_dcac(robot, given):
    controller, law = inputs(robot, given, "dcac")
    assert [law[gain] for gain in ("K_X", "D_X", "K_N", "D_N")] == TRACKING["dcac"]
    assert (law["rcm_lambda"], law["feedforward"]) == (LAMBDA, False)
    assert controller.subproblem is None
    assert not law["K_N2"].any()  # tau_d = tau_T + tau_N1
    assert not law["D_N2"].any()
    assert not controller.external_torque.any()


@pytest.mark.parametrize("name", ["exact", "rnn-printed"])
def test_table_one_moc(robot, given, name):
    controller, law = inputs(robot, given, "moc", create(name))
    assert [law[gain] for gain in ("K_X", "D_X", "K_N", "D_N")] == TRACKING["moc"]
    assert (law["rcm_lambda"], law["feedforward"], law["k0"]) == (LAMBDA, False, K_0)
    assert [law[weight] for weight in ("c0", "c1", "c2", "rho")] == [C_0, C_1, C_2, 0.0]
    assert controller.subproblem.fields.weights.tolist() == [C_0, C_1, C_2, 0.0]
    for limit in ("q_min", "q_max", "v_max"):
        np.testing.assert_array_equal(law[limit], getattr(robot, limit))
    assert law["K_N2"].tolist() == K_N2
    assert law["D_N2"].tolist() == K_D2
    assert (law["fade"], law["climbs"]) == (1.0, False)


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
