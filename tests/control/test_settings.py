"""A controller's settings: gains, ranges, presets and the paper's Table I."""

import json
import re

import numpy as np
import pytest

from moc_opt.control import Controller, ControlSettings
from moc_opt.control.law_numbers import numbers_of
from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.control.supervisor import SupervisorSettings
from moc_opt.errors import ControlError, MocOptError, ScenarioError, UnknownNameError
from moc_opt.inputs.settings import LARGEST
from moc_opt.realtime.wire import WireSettings
from moc_opt.robots.model import load_robot
from moc_opt.scenario import Scenario
from moc_opt.sim import PlantSettings
from moc_opt.sim.faults import FaultSettings
from moc_opt.solvers import create

TABLES = {
    "dcac": {"K_X": 2000.0, "D_X": 80.0, "K_N": 600.0, "D_N": 60.0},
    "moc": {"K_X": 3000.0, "D_X": 80.0, "K_N": 800.0, "D_N": 60.0, "K_N2": 80.0, "D_N2": 1.0},
    "listed": {"K_X": 2000.0, "D_X": [80.0, 70.0]},
    "default": {"K_X": 2500.0, "D_X": 50.0, "K_N": 700.0, "D_N": 40.0, "K_N2": [1.0, 2.0, 3.0], "D_N2": 2.0},
}


def test_gains_come_from_chosen_table_unless_replaced():
    assert ControlSettings().resolve_gains(TABLES, 3).K_X == 2500.0
    assert ControlSettings(law="dcac").resolve_gains(TABLES, 3).K_X == 2500.0
    assert ControlSettings(gains=None).resolve_gains(TABLES, 3).K_X == 3000.0
    assert ControlSettings(gains="", law="dcac").resolve_gains(TABLES, 3).K_X == 2000.0
    found = ControlSettings(gains="moc", K_X=123.0, D_N2=0.0).resolve_gains(TABLES, 7)
    assert (found.K_X, found.K_N, found.D_N2.any()) == (123.0, 800.0, False)


@pytest.mark.parametrize("settings", [
    ControlSettings(), ControlSettings(gains=None), ControlSettings(gains="moc", K_X=1234.0),
    ControlSettings.preset("paper"), ControlSettings.preset("tuned"), ControlSettings(law="dcac", gains=None),
    ControlSettings(third_level="planned"), ControlSettings(third_level="receding", observer_gain_per_s=0.0),
])  # fmt: skip
def test_matched_dcac_baseline_has_same_gains_and_observer(settings, robot):
    given = settings.resolve_gains(robot.data.gains, 7)
    changed = ControlSettings(**{**settings.model_dump(), **settings.matched_dcac()})
    matched = changed.resolve_gains(robot.data.gains, 7)
    assert changed.law == "dcac"
    assert matched[:4] == given[:4]
    assert not matched.K_N2.any()
    assert changed.observer_rate_per_s == settings.observer_rate_per_s


def test_gain_may_be_one_number_or_one_number_per_joint():
    given = ControlSettings(gains="moc", K_N2=[3, 2, 1.5], dcac_damping=(0.0, 1.0, 0.0))
    assert ControlSettings(**json.loads(given.model_dump_json())) == given
    assert ControlSettings(dcac_damping=LARGEST).dcac_damping == LARGEST
    numbers = given.resolve_gains(TABLES, 3)
    np.testing.assert_array_equal(numbers.K_N2, [3.0, 2.0, 1.5])
    np.testing.assert_array_equal(numbers.D_N2, [1.0, 1.0, 1.0])
    np.testing.assert_array_equal(ControlSettings().resolve_gains(TABLES, 3).K_N2, [1.0, 2.0, 3.0])


@pytest.mark.parametrize(("settings", "joints", "words"), [
    ({"gains": "mocc"}, 7, "'mocc': did you mean 'moc'"), ({"gains": "dcac"}, 7, r"K_N2: not set, and \[gains.dcac\]"),
    ({"gains": "moc", "K_N2": [3, 2, 1]}, 7, "K_N2 = .* has 3 entries for 7 joints"),
    ({}, 2, r"K_N2 in \[gains.default\] of the robot = .* has 3 entries for 2"),
    ({"gains": "listed"}, 7, r"D_X in \[gains.listed\] of the robot = .*: give one number"),
    ({"gains": {"K_N2": 80.0}}, 7, r"gains = .*keys of \[control\]"),
])  # fmt: skip
def test_gains_that_do_not_fit_the_arm_are_refused(settings, joints, words):
    with pytest.raises((ControlError, UnknownNameError), match=words):
        ControlSettings(**settings).resolve_gains(TABLES, joints)
    assert not ControlSettings(law="dcac", gains="dcac").resolve_gains(TABLES, 7).K_N2.any()  # DCAC needs no K_N2


@pytest.mark.parametrize(("settings", "words"), [
    ({"law": "dcac", "dcac_damping": [1.0, 2.0]}, "dcac_damping = .* has 2 entries for 8 joints"),
    ({"limit_margin_rad": 3.0}, "limit_margin_rad = 3.0: no room is left for joint 3 .* less than 2.09"),
    ({"limit_margin_m": 0.5}, "limit_margin_m = 0.5: no room is left for joint 1 .* less than 0.5"),
    ({"observer_gain_per_s": 500.0}, "observer_gain_per_s = 500.0 .* below 500"),
    ({"third_level": "planned", "course_observer_gain_per_s": 600.0}, "course_observer_gain_per_s = 600.0"),
])  # fmt: skip
def test_settings_that_do_not_fit_the_arm_or_the_period_are_refused(settings, words):
    solver = None if settings.get("law") == "dcac" else create("exact")
    with pytest.raises(ControlError, match=words):
        Controller(load_robot("lwr4_rail"), ControlSettings(**settings), solver, period=0.002)


# All other numbers have the range [0, inf).
RANGES = {
    ControlSettings: {
        "(0, inf)": "K_X K_N k0_per_s", "(0, 1]": "rcm_lambda speed_fraction", "[0.2, 2]": "horizon_s",
        "[20, 50]": "replan_per_s", "(0, 1)": "course_speed_fraction", "[0, 1]": "shaft_margin"},
    SupervisorSettings: {"(0, inf)": "primal_limit box_limit relative_limit opposite_limit budget_us"},
    SafetyFilterSettings: {
        "(0, inf)": "motion_s motion_rad repeat_m repeat_torque repeat_whole_torque repeat_whole_m stuck_friction "
        "stuck_rad_per_s residual_torque residual_whole_torque residual_s torque_rate_Nm_per_s wall_brake_rad_per_s2 "
        "jump_rad tip_error_m tip_error_s rcm_error_m rcm_warning_m trocar_force_N trocar_force_warning_N tip_force_N "
        "incision_s stop_damping_Nm_s_per_rad stop_yield_N stop_s", "[1, inf)": "repeat_whole_ticks repeat_joint_ticks",
        "(0, 500)": "residual_rate_per_s", "(1, inf)": "speed_factor", "[0, 1]": "stop_holding",
        "[0, 60]": "stop_yield_s"},
    FaultSettings: {
        "[0, 1]": "drop_share solver_share", "[0, 50]": "late_ticks", "[1, inf)": "frozen_ticks nan_ticks",
        "[0, 1000]": "lag_ticks", "(0, 1]": "lag_growth", "[1, 5000]": "replay_ticks", "[-1, 1]": "drift_rad_per_s",
        "[-0.1, 0.1]": "encoder_bias_rad", "[0, 0.01]": "encoder_noise_rad", "[0, 200]": "bump_N", "(0, inf)": "bump_s",
        "[0, 10]": "payload_kg", "[0, 0.1]": "slip_m", "(-inf, inf)": "jump_rad"},
    PlantSettings: {
        "(0, 0.1]": "period_s", "[1, 1000]": "substeps", "[0, 0.9]": "mass_error", "[0, 10]": "friction",
        "[0, 1)": "friction_error", "[0, 0.05]": "calibration_error_m", "[0, 0.5]": "torque_ripple",
        "[0, 0.1]": "calibration_tilt_rad encoder_bias_rad encoder_noise_rad encoder_resolution_rad "
        "trocar_registration_error_m", "[0, 1e9]": "joint_stiffness_Nm_per_rad",
        "[0, 1e4]": "joint_spring_damping_Nm_s_per_rad trocar_damping_Ns_per_m", "(0, 1e5]": "torque_ripple_per_turn",
        "[0, 100]": "delay_ticks", "[0, 1e6]": "trocar_stiffness_N_per_m"},
    WireSettings: {"(0, 1e3]": "damping_Nm_s_per_rad", "(0, inf)": "wait_s silence_s resend_s"},
}  # fmt: skip
OTHER_FIELDS = {
    SafetyFilterSettings: dict.fromkeys(("rcm_error_m", "rcm_warning_m", "trocar_force_N", "trocar_force_warning_N")),
    PlantSettings: {"period_s": 1e-3, "substeps": 100},
}  # fmt: skip


@pytest.mark.parametrize("kind", RANGES, ids=lambda kind: kind.__name__)
def test_each_number_is_accepted_only_inside_its_range(kind):
    named = {field: interval for interval, fields in RANGES[kind].items() for field in fields.split()}
    for field, model in kind.model_fields.items():
        if not (types := re.findall(r"\b(?:int|float)\b", str(model.annotation))):
            continue
        interval, whole, wrong = named.pop(field, "[0, inf)"), types[0] == "int", [float("nan")]
        low, high = map(float, interval[1:-1].split(", "))
        for end, closed, outwards in ((low, interval[0] == "[", -1), (high, interval[-1] == "]", 1)):
            if np.isfinite(end):
                step = outwards if whole else 1e-9 * outwards * max(1.0, abs(end))
                last, beyond = (end, end + step) if closed else (end - step, end)
                assert getattr(kind(**{**OTHER_FIELDS.get(kind, {}), field: last}), field) == last
                wrong.append(beyond)
        for value in wrong:
            with pytest.raises(MocOptError, match=rf"\b{field}\b"):
                kind(**{**OTHER_FIELDS.get(kind, {}), field: value})
    assert not named


@pytest.mark.parametrize(("table", "field", "value"), [
    ("control", "D_N2", "soft"), ("control", "D_N2", [1.0, -1.0]), ("control", "D_N2", True),
    ("control", "D_N2", 1.01 * LARGEST), ("control", "law", "both"), ("control", "course", "a.json"),
    ("control", "limit_torque", "perhaps"), ("control", "feedforward", 3), ("faults", "bumps_N", 1.0),
    ("plant", "substeps", 1), ("plant", "joint_stiffness_Nm_per_rad", (1e4, -1.0)),
])  # fmt: skip
def test_wrong_value_names_its_field(table, field, value):
    with pytest.raises(MocOptError, match=rf"\b{field}\b"):
        Scenario(**{table: {field: value}})


def test_presets_robust_and_tuned_differ_only_in_gains_and_observer():
    softer = {"gains": "robust", "feedforward": True, "observer_gain_per_s": 22.0, "course_observer_gain_per_s": 22.0}
    assert ControlSettings.preset("robust") == ControlSettings.preset("tuned", **softer)
    with pytest.raises(UnknownNameError, match="did you mean 'tuned'"):
        ControlSettings.preset("tunned")


def test_planned_third_level_has_its_own_law_numbers():
    arm, common = load_robot("lwr4_rail"), {"limit_margin_m": 0.03, "climb": "scaled"}
    given = (ControlSettings(third_level=level, **common) for level in ("local", "planned"))
    assert ControlSettings(third_level="receding").horizon_s == 1.0
    local, planned = (numbers_of(settings, arm, 0.002) for settings in given)
    for given, share, margin, k0 in ((local, 0.5, 0.15, 2.0), (planned, 1.0, 0.05, 10.0)):
        margins = [0.03, *[margin] * 7]
        np.testing.assert_allclose(given["v_max"], share * arm.v_max)
        np.testing.assert_allclose(given["q_min"] - arm.q_min, margins)
        np.testing.assert_allclose(arm.q_max - given["q_max"], margins)
        assert given["k0"] == k0
        np.testing.assert_array_equal(given["tau_max"], arm.tau_max)
        assert given["feedforward"]
    assert (local["climbs"], planned["climbs"]) == (True, False)
    # The planned third level damps v - x instead of v.
    np.testing.assert_array_equal(planned["D_N2"], 0.0)
    np.testing.assert_allclose(planned["K_N2"], local["K_N2"] + local["D_N2"])
    assert local["D_N2"].max() > 0.0
    assert numbers_of(ControlSettings(third_level="planned", k0_per_s=12.0), arm, 0.002)["k0"] == 12.0


def test_third_level_that_follows_a_course_uses_the_course_observer_gain():
    for gain, level, rate in ((20.0, "local", 20.0), (20.0, "receding", 40.0), (0.0, "receding", 0.0)):
        assert ControlSettings(third_level=level, observer_gain_per_s=gain).observer_rate_per_s == rate
    for name in ("tuned", "robust"):
        planned = ControlSettings.preset(name, third_level="planned")
        assert planned.observer_rate_per_s <= ControlSettings.preset(name).observer_gain_per_s


def test_safety_margin_larger_than_controller_margin_is_refused():
    for unit, box in (("rad", 0.15), ("m", 0.05)):
        with pytest.raises(ScenarioError, match=f"position_margin_{unit} = 0.2 .*_{unit} = {box}"):
            Scenario(guard={f"position_margin_{unit}": 0.2})
    for control in ({"limit_margin_rad": 0.2}, {"law": "dcac"}, {"preset": "paper"}):  # equal; no level 3; margin 0
        Scenario(guard={"position_margin_rad": 0.2}, control=control)


@pytest.mark.parametrize("wrong", [{"rcm_warning_m": 0.0101}, {"trocar_force_warning_N": 15.1}])
def test_warning_threshold_above_its_limit_is_refused(wrong):
    with pytest.raises(ControlError, match=next(iter(wrong))):
        SafetyFilterSettings(**wrong)
    SafetyFilterSettings(rcm_warning_m=0.010, trocar_force_warning_N=15.0)
    SafetyFilterSettings(rcm_error_m=None, trocar_force_N=None, **wrong)


@pytest.mark.parametrize("length", [0.15, 0.6])
def test_shaft_margin_grows_with_the_squared_distance_from_tip_to_wrist(length):
    robot = load_robot("gen3", tool_length=length)
    lever = length + 0.061525 + 0.10593
    law = numbers_of(ControlSettings(shaft_margin=0.2, speed_fraction=0.4), robot, 0.002)
    assert law["shaft_margin"] == pytest.approx(0.2 * lever**2)
    assert law["spare_speed"] == pytest.approx(1.5)


# --- Table I of Su et al. (2019), copied from the paper ---

TABLE_I = {
    "dcac": {
        "K_X": 2000.0, "D_X": 20.0, "K_N": 600.0, "D_N": 10.0, "rcm_lambda": 0.5, "feedforward": False, "damped": False,
        "K_N2": np.zeros(7), "D_N2": np.zeros(7), "observer_gain": 0.0,  # the torque is tau_tip + tau_rcm
    },
    "moc": {
        "K_X": 3000.0, "D_X": 30.0, "K_N": 800.0, "D_N": 10.0, "rcm_lambda": 0.5, "feedforward": False, "k0": 0.1,
        "c0": 0.01, "c1": 0.01, "c2": 0.001, "rho": 0.0, "fade": 1.0, "climbs": False, "observer_gain": 0.0,
        "shaft_margin": 0.0, "spare_speed": 0.0, "damped": False,
        "K_N2": [80.0, 120.0, 60.0, 30.0, 20.0, 10.0, 10.0], "D_N2": [6.0, 10.0, 5.0, 3.0, 2.0, 1.0, 1.0]},
}  # fmt: skip


@pytest.mark.parametrize("law", TABLE_I)
def test_preset_paper_has_the_numbers_of_table_i(robot, law):
    given = numbers_of(ControlSettings.preset("paper", law=law), robot, 0.002)
    for name, number in TABLE_I[law].items():
        np.testing.assert_array_equal(given[name], number, err_msg=name)
    for limit in ("q_min", "q_max", "v_max"):
        assert law == "dcac" or (given[limit] == getattr(robot, limit)).all()
