"""What a controller can be told: gains, presets, and the paper's Table I, read from what the core is given."""

import json

import numpy as np
import pytest

from moc_opt.control import Controller, ControlSettings
from moc_opt.control.law import numbers_of
from moc_opt.errors import ControlError, MocOptError, ScenarioError, UnknownNameError
from moc_opt.robots.model import load_robot
from moc_opt.scenario import Scenario
from moc_opt.solvers import create

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

WRONG = {
    "control": {
        **dict.fromkeys(("D_X", "K_N2", "c2", "observer_gain_per_s", "dcac_damping", "limit_margin_m"), (-1.0,)),
        **dict.fromkeys(("ramp_s", "limit_margin_rad", "regularization", "c0"), (-0.1,)),
        **dict.fromkeys(("K_X", "k0_per_s", "K_N"), (0.0,)),
        **dict.fromkeys(("rcm_lambda", "speed_fraction"), (0.0, 1.1)),
        "horizon_s": (0.1, 3.0), "replan_per_s": (10.0, 60.0), "course_speed_fraction": (0.0, 1.0),
        "shaft_margin": (-0.1, 1.1),
        "c1": (float("nan"),), "D_N2": (-0.1, "soft", [1.0, -1.0]), "law": ("both",), "projector": ("kinetic",),
        "fallback": ("stop",), "limit_torque": ("perhaps",), "feedforward": (3,),
    },
    "supervisor": {
        **dict.fromkeys(("primal_limit", "box_limit", "opposite_limit", "budget_us"), (0.0,)),
        "relative_limit": (0.0, -1.0), "hold_ticks": (-1,), "late": ("never",),
    },
    "guard": {
        **dict.fromkeys((
            "torque_rate_Nm_per_s", "wall_brake_rad_per_s2", "jump_rad", "tip_error_s", "rcm_warning_m", "incision_s",
            "trocar_force_warning_N", "stop_damping_Nm_s_per_rad", "stop_s",
        ), (0.0,)),
        **dict.fromkeys(("position_margin_rad", "wall_stiffness_Nm_per_rad", "wall_damping_Nm_s_per_rad"), (-1e-9,)),
        "tip_error_m": (0.0, float("nan")), "rcm_error_m": (0.0, -1.0), "trocar_force_N": (0.0, float("nan")),
        "patience_ticks": (-1,), "speed_factor": (1.0,),
    },
    "faults": {
        **dict.fromkeys(("frozen_ticks", "replay_ticks"), (0,)), "drop_share": (1.5,), "solver": ("lei",),
        "bump_N": (float("inf"),), "bumps_N": (1.0,), "solver_share": (-0.1,), "lag_growth": (0.0,),
        "frozen_joint": (-1,), "frozen_velocity": ("none",),
    },
    "plant": {
        **dict.fromkeys(("delay_ticks", "friction", "calibration_error_m"), (-1,)), "mass_error": (1.5,),
        "force_noise_N": (float("nan"),), "encoder_bias_rad": (float("inf"),), "torque_ripple": (0.6,),
        "substeps": (0, 1), "calibration_tilt_rad": (1.0,), "joint_stiffness_Nm_per_rad": ((1e4, -1.0),),
        "encoder_side": ("gear",), "torque_ripple_per_turn": (0.0,), "mass_eror": (0.1,),
    },
}  # fmt: skip
OFF = dict.fromkeys(("rcm_error_m", "rcm_warning_m", "trocar_force_N", "trocar_force_warning_N"))


@pytest.mark.parametrize(("table", "field", "value"), [
    (table, field, value) for table, wrong in WRONG.items() for field, values in wrong.items() for value in values
])  # fmt: skip
def test_a_wrong_value_names_its_field(table, field, value):
    given = {**OFF, field: value} if field in OFF else {field: value}
    with pytest.raises(MocOptError, match=rf"\b{field}\b"):
        Scenario(**{"control": {table: given}} if table == "supervisor" else {table: given})


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


def test_a_box_of_which_nothing_is_left_is_refused(robot):
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

TABLE_I = {
    "dcac": {
        "K_X": 2000.0, "D_X": 20.0, "K_N": 600.0, "D_N": 10.0, "rcm_lambda": 0.5, "feedforward": False,
        "K_N2": np.zeros(7), "D_N2": np.zeros(7), "observer_gain": 0.0,  # tau_d = tau_T + tau_N1
    },
    "moc": {
        "K_X": 3000.0, "D_X": 30.0, "K_N": 800.0, "D_N": 10.0, "rcm_lambda": 0.5, "feedforward": False, "k0": 0.1,
        "c0": 0.01, "c1": 0.01, "c2": 0.001, "rho": 0.0, "fade": 1.0, "climbs": False, "observer_gain": 0.0,
        "K_N2": [80.0, 120.0, 60.0, 30.0, 20.0, 10.0, 10.0], "D_N2": [6.0, 10.0, 5.0, 3.0, 2.0, 1.0, 1.0],
    },
}  # fmt: skip


@pytest.mark.parametrize("law", TABLE_I)
def test_the_paper_s_preset_has_the_numbers_of_its_table(robot, law):
    given = numbers_of(ControlSettings.preset("paper", law=law), robot, 0.002)
    for name, number in TABLE_I[law].items():
        np.testing.assert_array_equal(given[name], number, err_msg=name)
    for limit in ("q_min", "q_max", "v_max"):
        assert law == "dcac" or (given[limit] == getattr(robot, limit)).all()
