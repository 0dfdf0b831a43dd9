"""What a run is: validated tables, errors that help, and one composer whose runs repeat to the bit."""

from pathlib import Path

import numpy as np
import pytest

from moc_opt.control import ControlSettings
from moc_opt.errors import (
    ControlError,
    MocOptError,
    ScenarioError,
    TaskError,
    UnknownNameError,
)
from moc_opt.redundancy.self_motion import self_motion
from moc_opt.robots import loader
from moc_opt.scenario import Scenario, Setup, run
from moc_opt.scenario.derived import largest_mu
from moc_opt.sim import PlantSettings
from moc_opt.tasks import shaft_distance
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace

CLOCK = {"tick_us", "solve_us"}
BARE = {"judge": False, "bound_samples": 0}
POOR = {"swivel": 0.15}
CALIBRATED = {"calibration_error_m": 0.0, "calibration_tilt_rad": 0.0, "encoder_bias_rad": 0.0}


def short(duration_s=0.1, **tables):
    """A short run without the judge."""
    return run(Scenario(duration_s=duration_s, **{**BARE, **tables}))


def toml(table, prefix=""):
    """A table of plain values as TOML; None is left out."""
    lines, inner = [], []
    for key, value in table.items():
        if isinstance(value, dict):
            name = prefix + key
            inner.append(f"[{name}]\n{toml(value, name + '.')}")
        elif isinstance(value, bool):
            lines.append(f"{key} = {str(value).lower()}")
        elif isinstance(value, list | tuple):
            lines.append(f"{key} = {list(value)}")
        elif value is not None:
            lines.append(f"{key} = {value!r}".replace("'", '"'))
    return "\n".join([*lines, *inner]) + "\n"


def written(folder, text):
    file = folder / "scenario.toml"
    file.write_text(text, encoding="utf-8")
    return file


def test_every_column_of_a_run_is_documented():
    trace = run(Scenario(duration_s=0.02, faults={"solver": "nan"}))
    assert [name for name in trace.columns if name not in Trace.COLUMNS] == []


# --- errors at every depth ---


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"task": {"radius": 0.01}}, r"unknown \[task\] key 'radius': did you mean 'sizes.radius'"),
        ({"solver": {"tolerance": 1e-9}}, r"unknown \[solver\] key 'tolerance': did you mean 'settings.tolerance'"),
        ({"solver": {"name": "osqp", "eps": 1e-9}}, r"key 'eps': did you mean 'settings.eps'"),
        ({"sede": 1}, r"unknown scenario key 'sede': did you mean 'seed'"),
        ({"robot": {"tool_length": 0.3}}, r"\[robot\] key 'tool_length': did you mean 'tool_length_m'"),
        ({"start": {"swivl": 0.3}}, r"\[start\] key 'swivl': did you mean 'swivel'"),
        ({"trocar": {"depth": 0.1}}, r"\[trocar\] key 'depth': did you mean 'depth_m'"),
        ({"task": {"pathh": "line"}}, r"\[task\] key 'pathh': did you mean 'path'"),
        ({"control": {"K_x": 1.0}}, r"\[control\] key 'K_x': did you mean 'K_X'"),
        ({"control": {"preset": "papre"}}, r"control preset 'papre': did you mean 'paper'"),
        ({"control": {"preset": "paper", "gain": "moc"}}, r"\[control\] key 'gain': did you mean 'gains'"),
        ({"solver": {"nane": "exact"}}, r"\[solver\] key 'nane': did you mean 'name'"),
        ({"plant": {"frictoin": 1.0}}, r"\[plant\] key 'frictoin': did you mean 'friction'"),
        (
            {"plant": {"preset": "nominla"}},
            r"plant preset 'nominla': did you mean 'nominal'.*nominal, realistic",
        ),
        (
            {"plant": {"preset": "nominal", "mass_eror": 0.1}},
            r"\[plant\] key 'mass_eror': did you mean 'mass_error'",
        ),
        ({"task": {"path": "cirle"}}, r"path 'cirle': did you mean 'circle'.*line.*sinusoid.*spiral"),
        (
            {"task": {"path": "circle", "sizes": {"radus": 0.01}}},
            r"size of a circle 'radus': did you mean 'radius'",
        ),
        (
            {"task": {"path": "line", "sizes": {"radius": 0.01}}},
            r"size of a line 'radius': valid names: length",
        ),
        ({"solver": {"name": "exakt"}}, r"solver 'exakt': did you mean .*'exact'"),
    ],
)
def test_unknown_keys_list_the_nearest(tables, message):
    """Where the scenario is made, not where it runs."""
    with pytest.raises(UnknownNameError, match=message):
        Scenario(**tables)


@pytest.mark.parametrize(
    ("tables", "places"),
    [
        ({"swivel": 0.3}, "; a key of that name belongs in [start]"),
        ({"task": {"duration_s": 3.0}}, "; a key of that name belongs at the top of the file, above all tables"),
        ({"settings": {}}, "; a key of that name belongs in [solver]"),
        ({"start": {"path": "line"}}, "; a key of that name belongs in [task]"),
        ({"start": {"nowhere": 1}}, ""),
    ],
)
def test_a_key_in_the_wrong_table_is_told_its_place(tables, places):
    with pytest.raises(UnknownNameError) as found:
        Scenario(**tables)
    assert str(found.value).rpartition("valid names: ")[2].partition(";")[2] == places.removeprefix(";")


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"robot": {"name": "lwr5"}}, r"robot 'lwr5': did you mean 'lwr4'"),
        (
            {"solver": {"name": "exact", "settings": {"tolerence": 1e-9}}},
            r"setting of solver 'exact' 'tolerence': did you mean 'tolerance'",
        ),
        ({"control": {"gains": "mock"}}, r"table of gains 'mock': did you mean 'moc'"),
    ],
)
def test_unknown_names_list_the_nearest(tables, message):
    with pytest.raises(UnknownNameError, match=message):
        run(Scenario(duration_s=0.01, **tables))


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"seed": -1}, r"scenario: seed = -1: input should be greater than or equal to 0"),
        ({"seed": 1.5}, r"scenario: seed = 1.5"),
        ({"duration_s": 0.0}, r"duration_s = 0.0: input should be greater than 0"),
        ({"deadline_us": float("inf")}, r"deadline_us = inf: input should be a finite number"),
        ({"bound_samples": -1}, r"bound_samples = -1"),
        ({"control": 5}, r"control = 5: this is a table: write \[control\]"),
        ({"control": {"c2": -1.0}}, r"\[control\] c2 = -1.0: input should be greater than or equal to 0"),
        ({"control": {"law": "mok"}}, r"\[control\] law = 'mok': input should be 'dcac' or 'moc'"),
        ({"robot": {"tool_length_m": 0.0}}, r"\[robot\] tool_length_m = 0.0: input should be greater than 0"),
        ({"start": {"swivel": 1.5}}, r"\[start\] swivel.* = 1.5: a swivel is a share from 0 to 1"),
        ({"start": {"swivel": "best"}}, r"\[start\] swivel = 'best': give 'given', 'random', or a share from 0 to 1"),
        ({"start": {"swivel": "0.3"}}, r"\[start\] swivel = '0.3': .* without quotes"),
        ({"trocar": {"depth_m": -0.1}}, r"\[trocar\] depth_m = -0.1: input should be greater than 0"),
        ({"trocar": {"breathing_direction": [1, 0]}}, r"\[trocar\] breathing_direction"),
        ({"task": {"v_max_m_per_s": 0}}, r"\[task\] v_max_m_per_s = 0: input should be greater than 0"),
        (
            {"task": {"sizes": {"radius": "big"}}},
            r"\[task\] sizes.radius = 'big': input should be a valid number",
        ),
        (
            {"plant": {"friction": -1.0}},
            r"\[plant\] friction = -1.0: input should be greater than or equal to 0",
        ),
        ({"plant": {"preset": "nominal", "delay_ticks": -1}}, r"\[plant\] delay_ticks = -1"),
    ],
)
def test_wrong_values_name_field_value_and_range(tables, message):
    with pytest.raises(ScenarioError, match=message):
        Scenario(**tables)


@pytest.mark.parametrize(
    ("tables", "error", "message"),
    [
        (
            {"trocar": {"depth_m": 0.4}},
            ScenarioError,
            r"\[trocar\] depth_m = 0.4: wrist and tip are 0.378 m apart",
        ),
        ({"start": {"q_rad": [0.0] * 6}}, ScenarioError, r"\[start\] q_rad = .*give 7 finite numbers"),
        (
            {"start": {"q_rad": [0.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0]}},
            ScenarioError,
            r"\[start\] q_rad: joint 2 = 3 rad is outside the limits of 'joint_2': choose -2.0944 to 2.0944",
        ),
        ({"start": {"q_rad": [0.0] * 7}}, ScenarioError, r"\[start\] q_rad = .*singular.*home pose"),
        ({"start": {"q_rad": [0.0] * 7, "swivel": 0.5}}, ScenarioError, "singular"),
        ({"task": {"normal": [0, 0, 0]}}, TaskError, "normal"),
        ({"task": {"sizes": {"radius": -0.01}}}, TaskError, "radius"),
        ({"control": {"observer_gain_per_s": 600.0}}, ControlError, "observer_gain_per_s = 600"),
        ({"control": {"law": "moc", "gains": "dcac"}}, ControlError, "K_N2: not set"),
    ],
)
def test_what_does_not_fit_together_is_found_before_anything_moves(tables, error, message):
    moved = []
    with pytest.raises(error, match=message):
        run(Scenario(duration_s=0.01, **tables), watch=moved.append)
    assert moved == []
    assert issubclass(error, MocOptError)


# --- files ---


FULL = {
    "name": "all of it", "seed": 7, "duration_s": 0.5, "deadline_us": 1500.0, "judge": False, "bound_samples": 3,
    "robot": {"name": "lwr4", "tool_length_m": 0.35, "tool_mass_kg": 0.25},
    "start": {"swivel": 0.3},
    "trocar": {"depth_m": 0.12, "breathing_amplitude_m": 0.004, "breathing_direction": [0.0, 1.0, 0.0]},
    "task": {"path": "sinusoid", "sizes": {"amplitude": 0.01, "wavelength": 0.03, "periods": 1.0}, "wait_s": 0.1},
    "control": {"law": "moc", "gains": "moc", "K_X": 2500.0, "projector": "static", "fallback": "hold"},
    "solver": {"name": "exact", "settings": {"tolerance": 1e-8}},
    "plant": {"mass_error": 0.05, "delay_ticks": 2},
}  # fmt: skip


def test_file_round_trip(tmp_path):
    scenario = Scenario(**FULL)
    assert Scenario.load(written(tmp_path, toml(FULL))) == scenario
    assert Scenario.load(written(tmp_path, toml(scenario.model_dump(mode="json")))) == scenario
    assert scenario.control.K_X == 2500.0
    assert scenario != Scenario()


def test_an_empty_file_is_the_default(tmp_path):
    assert Scenario.load(written(tmp_path, "")) == Scenario()


def test_the_trace_remembers_its_scenario():
    scenario = Scenario(**{**FULL, "duration_s": 0.02})
    trace = run(scenario)
    assert Scenario(**trace.meta["scenario"]) == scenario
    assert trace.meta["deadline_us"] == 1500.0
    assert trace.meta["robot"] == "lwr4"
    bias = Setup(scenario).plant.mismatch.encoder_bias
    np.testing.assert_array_equal(trace.meta["start_q_rad"] - bias, trace.q_rad[0])


def test_preset_in_a_file(tmp_path):
    nominal = Scenario.load(written(tmp_path, '[plant]\npreset = "nominal"\ndelay_ticks = 3\n'))
    assert nominal.plant == PlantSettings.nominal(delay_ticks=3)
    assert (
        Scenario.load(written(tmp_path, '[plant]\npreset = "realistic"\n')).plant == PlantSettings.realistic()
    )
    assert Scenario().plant == PlantSettings.realistic()


def test_control_preset_in_a_file(tmp_path):
    paper = Scenario.load(written(tmp_path, '[control]\npreset = "paper"\nlaw = "dcac"\n'))
    assert paper.control == ControlSettings.paper(law="dcac")
    assert Scenario().change(control={"preset": "paper"}).control == ControlSettings.paper()


def test_the_former_name_of_the_regularization_in_a_file(tmp_path):
    file = tmp_path / "scenario.toml"
    file.write_text('[control]\npreset = "tuned"\ndamping = 1e-4\n')
    found = Scenario.load(file)
    assert found.control == ControlSettings.tuned(regularization=1e-4)
    assert found.change(control={"damping": 1e-3}).control.regularization == 1e-3
    file.write_text("[control]\ndamping = 1e-4\nregularization = 1e-4\n")
    with pytest.raises(ScenarioError, match=r"scenario.toml: .control. regularization = 0.0001 is given beside"):
        Scenario.load(file)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ScenarioError, match=r"gone.toml': no such file"):
        Scenario.load(tmp_path / "gone.toml")
    with pytest.raises(ScenarioError, match="no regular file"):
        Scenario.load(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b'name = "caf\xe9"')
    with pytest.raises(ScenarioError, match=r"latin.toml' cannot be read"):
        Scenario.load(tmp_path / "latin.toml")


@pytest.mark.parametrize("text", ["seed = ", "seed = 1\nseed = 2", "[control\nlaw = 'moc'", "law: moc"])
def test_a_file_that_is_no_toml(tmp_path, text):
    with pytest.raises(ScenarioError, match=r"scenario.toml' is not TOML: .*(line \d|end of document)"):
        Scenario.load(written(tmp_path, text))


def test_a_wrong_value_names_file_and_field(tmp_path):
    with pytest.raises(
        ScenarioError, match=r"scenario.toml: .*\[control\] K_X = -5.0: input should be greater than 0"
    ):
        Scenario.load(written(tmp_path, "[control]\nK_X = -5.0\n"))


# --- change ---


def test_the_safety_filter_is_told_of_the_encoders():
    assert Scenario().guard.repeat_joint_ticks is None
    assert Scenario().told_guard.repeat_joint_ticks == 89
    assert Scenario(plant={"preset": "nominal"}).told_guard.repeat_joint_ticks is None
    assert Scenario(guard={"repeat_joint_ticks": 40}).told_guard.repeat_joint_ticks == 40
    assert Scenario().guard.repeat_reading_ticks is None
    assert Scenario(guard={"patience_ticks": 5}).told_guard.repeat_reading_ticks == 5
    assert Scenario(guard={"repeat_joint_ticks": 40, "repeat_reading_ticks": 2}).told_guard.repeat_reading_ticks == 2
    # Without noise, or a filter, a reading may well be the same.
    assert Scenario(plant={"preset": "nominal"}).told_guard.repeat_reading_ticks is None
    assert Scenario(plant={"velocity_cutoff_Hz": 0.0}).told_guard.repeat_reading_ticks is None
    # A slow filter lags: sound runs with 15 Hz were stopped at the level that 50 Hz need.
    assert [
        Scenario(plant={"velocity_cutoff_Hz": cutoff}).told_guard.motion_lag_s for cutoff in (0.0, 50.0, 15.0)
    ] == pytest.approx([0.012, 0.012, 3.0 / (2.0 * np.pi * 15.0)])
    # A coarse step hides what moves the joint within it.
    plants = [{"encoder_resolution_rad": step} for step in (2.4e-5, 1e-4, 5e-4)]
    assert [Scenario(plant=plant).told_guard.repeat_torque for plant in plants] == pytest.approx([0.06, 0.06, 0.25])
    assert [Scenario(plant=plant).told_guard.stuck_rad_per_s for plant in plants] == pytest.approx([0.2, 0.2, 0.3])
    assert Scenario(plant=plants[2], guard={"repeat_torque": 0.4}).told_guard.repeat_torque == 0.4


def test_change_makes_a_copy():
    base = Scenario(control={"c2": 0.002, "K_X": 2000.0})
    changed = base.change(seed=3, control={"c2": 0.01})
    assert (changed.seed, changed.control.c2, changed.control.K_X) == (3, 0.01, 2000.0)
    assert (base.seed, base.control.c2) == (0, 0.002)
    assert base.change() == base


def test_change_of_the_plant_keeps_what_it_is():
    base = Scenario(plant=PlantSettings.nominal())
    assert base.change(plant={"delay_ticks": 2}).plant == PlantSettings.nominal(delay_ticks=2)
    assert base.change(plant={"preset": "realistic"}).plant == PlantSettings.realistic()
    assert base.change(plant=PlantSettings.realistic(friction=0.0)).plant.friction == 0.0


def test_change_is_validated():
    with pytest.raises(UnknownNameError, match=r"unknown scenario key .colour"):
        Scenario().change(colour="red")
    with pytest.raises(UnknownNameError, match=r"\[control\] key 'C2'"):
        Scenario().change(control={"C2": 1.0})
    with pytest.raises(UnknownNameError, match=r"\[plant\] key 'masses'"):
        Scenario().change(plant={"masses": 1.0})
    with pytest.raises(MocOptError, match=r"c2 = -1.0"):
        Scenario().change(control={"c2": -1.0})


def test_frozen():
    with pytest.raises(ValueError, match="frozen"):
        Scenario().seed = 3


# --- how a run is put together ---


@pytest.mark.parametrize("fraction", [0.0, 0.15, 0.5, 0.9])
def test_swivel_keeps_tip_and_wrist(robot, fraction):
    home = robot.state(robot.data.q_home)
    q = Setup(Scenario(start={"swivel": fraction})).q_start
    state = robot.state(q)
    np.testing.assert_allclose(state.tip, home.tip, atol=1e-9)
    np.testing.assert_allclose(state.wrist, home.wrist, atol=1e-9)
    assert (q >= robot.q_min).all()
    assert (q <= robot.q_max).all()
    assert np.abs(q - robot.data.q_home).max() > 0.01


def test_random_swivel_is_drawn_by_the_seed():
    first, again, other = (Setup(Scenario(seed=s, start={"swivel": "random"})).q_start for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-3


def test_given_pose_and_tool(robot):
    q = robot.data.q_home + 0.1
    setup = Setup(Scenario(start={"q_rad": q.tolist()}, robot={"tool_length_m": 0.4}))
    np.testing.assert_array_equal(setup.q_start, q)
    np.testing.assert_array_equal(setup.plant.q, q - setup.plant.mismatch.encoder_bias)
    assert setup.robot.state(q).tool_span == pytest.approx(0.478)


def test_the_shaft_starts_in_the_trocar():
    setup = Setup(Scenario(trocar={"depth_m": 0.1}, plant=PlantSettings.nominal()))
    point, _ = setup.trocar.at(0.0)
    assert float(shaft_distance(setup.plant.tip, setup.plant.wrist, point)) < 1e-12
    assert np.linalg.norm(point - setup.plant.tip) == pytest.approx(0.1)
    np.testing.assert_array_equal(point, setup.registered.at(0.0)[0])


def test_registration_error_is_the_plant_s():
    setup = Setup(Scenario(plant={"trocar_registration_error_m": 0.002}))
    offset = setup.trocar.at(0.0)[0] - setup.registered.at(0.0)[0] - setup.offset.trocar
    assert np.linalg.norm(offset) == pytest.approx(0.002)
    np.testing.assert_allclose(offset, setup.plant.mismatch.registration_error, atol=1e-15)


def test_what_the_arm_touched_lies_where_it_truly_is():
    """Kinematics that are off by a millimetre and more: the shaft stands in the incision all the same."""
    bad = PlantSettings.nominal(calibration_error_m=5e-4, calibration_tilt_rad=5e-4, encoder_bias_rad=5e-4)
    setup = Setup(Scenario(plant=bad, seed=4, control={"law": "dcac"}, **BARE, duration_s=0.2))
    plant, state = setup.plant, setup.robot.state(setup.q_start)
    point = setup.trocar.at(0.0)[0]
    assert float(shaft_distance(plant.tip, plant.wrist, point)) < 1e-12
    np.testing.assert_array_equal(setup.registered.at(0.0)[0], state.tip - 0.15 * state.tool_direction)
    assert np.linalg.norm(plant.tip - state.tip) > 5e-4
    trace = setup.trace()
    assert trace.tip_error_m[0] == pytest.approx(np.linalg.norm(plant_tip_off(setup)), abs=1e-12)
    assert trace.tip_error_m.min() > 4e-4
    assert trace.tip_error_registered_m.max() < 5e-5
    assert trace.tip_error_model_m.max() < 5e-5
    np.testing.assert_allclose(trace.trocar_registered_m, trace.trocar_m, atol=1e-12)


def plant_tip_off(setup):
    """True minus modelled tip at the start, read off the plant."""
    setup.plant.reset(setup.q_start)
    return setup.plant.tip - setup.robot.state(setup.q_start).tip


RECORDED = {
    "law": "dcac", "K_X": 2000.0, "D_X": 80.0, "K_N": 600.0, "D_N": 60.0, "observer_gain_per_s": 20.0,
    "feedforward": False,
}  # fmt: skip
RECORDING = {
    "q_rad": [0.5950106130093401, -0.890409338843198, -0.9999657883573064, 1.449792586360487, 0.77000691514235,
              -1.219996968525384, -4.6296816495251985e-09],
    "tau_Nm": [0.46410431072849306, 34.24100550040869, -9.2592290428106, -10.472008662614645, 0.35821568498270884,
               0.16421857356958844, -0.00020173614684706846],
    "tip_m": [0.5803973205249366, -0.0015808106320361669, 0.051146375440902],
    "trocar_force_N": [0.08613538320375422, 0.352468213948382, -0.00010155474383965113],
    "force_N": [0.0776055225593431, 0.31083589125043126, 3.0196943571500348],
}  # fmt: skip


def test_without_its_new_errors_the_plant_runs_as_it_did():
    """Recorded when the plant had neither calibration error, bias, elastic joints nor ripple."""
    trace = run(Scenario(duration_s=0.4, plant={**CALIBRATED, "torque_ripple": 0.0}, control=RECORDED, **BARE))
    for name, numbers in RECORDING.items():
        np.testing.assert_allclose(getattr(trace, name)[-1], numbers, rtol=1e-7, atol=1e-10, err_msg=name)
    np.testing.assert_array_equal(trace.tip_error_m, trace.tip_error_registered_m)
    np.testing.assert_array_equal(trace.tip_error_m, trace.tip_error_model_m)


def test_reference_starts_at_the_tip_and_waits():
    setup = Setup(Scenario(task={"wait_s": 0.3, "path": "line", "sizes": {"length": 0.02}}))
    x, dx, _ = setup.reference.at(np.array([0.0, 0.29, 0.5, 99.0]))
    np.testing.assert_allclose(x[0] + setup.offset.tip, setup.plant.tip, atol=1e-12)
    np.testing.assert_array_equal(x[0], x[1])
    assert np.abs(dx[2]).max() > 0.0
    assert np.linalg.norm(x[3] - x[0]) == pytest.approx(0.02)
    assert setup.duration_s == pytest.approx(0.3 + setup.reference.duration + 0.5)


@pytest.mark.parametrize("path", ["line", "circle", "sinusoid", "spiral"])
def test_every_path_has_default_sizes(path):
    trace = short(0.02, task={"path": path})
    assert len(trace) == 10


@pytest.mark.parametrize("known", [True, False])
def test_breathing(known):
    breathing = {"breathing_amplitude_m": 0.01, "breathing_period_s": 0.4, "breathing_known": known}
    trace = short(0.3, trocar={**breathing, "breathing_direction": [0, 0, 1]}, plant={"preset": "nominal"})
    moved = trace.trocar_m - trace.trocar_m[0]
    np.testing.assert_allclose(moved[:, :2], 0.0, atol=1e-15)
    assert moved[:, 2].max() == pytest.approx(0.01, abs=1e-5)
    assert trace.t_s[moved[:, 2].argmax()] == pytest.approx(0.2, abs=0.003)
    told = trace.trocar_registered_m - trace.trocar_registered_m[0]
    np.testing.assert_array_equal(told, moved if known else np.zeros_like(moved))


def test_columns_of_a_run(tmp_path):
    trace = run(Scenario(duration_s=0.05, bound_samples=3, control={"law": "moc"}))
    assert len(trace) == 25
    wanted = {
        "t_s", "q_rad", "v_rad_per_s", "tau_Nm", "tip_m", "tip_ref_m", "wrist_m", "trocar_m", "mu", "tip_error_m",
        "rcm_error_m", "trocar_force_N", "x_rad_per_s", "status", "solve_us", "tick_us", "primal", "natural", "loss",
        "verified", "mu_bound", "dual", "subproblem", "applied_x_rad_per_s", "iterations",
    }  # fmt: skip
    assert wanted <= set(trace.columns)
    assert trace.verified.all()
    np.testing.assert_array_equal(trace.applied_x_rad_per_s, trace.x_rad_per_s)
    assert np.isfinite(trace.mu_bound).sum() == 3
    assert (trace.mu <= np.nanmax(trace.mu_bound) + 1e-9).all()
    trace.save(tmp_path / "run.parquet")
    again = Trace.load(tmp_path / "run.parquet")
    assert summarize(again) == summarize(trace)


def test_without_a_third_level_there_is_no_subproblem():
    trace = short(0.02, control={"law": "dcac"})
    assert set(np.unique(trace.status)) == {"none"}
    assert "subproblem" not in trace.columns
    assert np.isnan(trace.solve_us).all()


@pytest.mark.parametrize("fallback", ["damping", "least-violation"])
def test_an_infeasible_run_says_so_and_goes_on(fallback):
    """With a damper this narrow no subproblem of the moving path has an answer; the arm follows it nevertheless."""
    trace = run(
        Scenario(
            duration_s=0.6, bound_samples=0, task={"wait_s": 0.0}, plant={"preset": "nominal"},
            control={"k0_per_s": 1e-3, "fallback": fallback},
        )
    )  # fmt: skip
    lost = trace.status == "infeasible"
    assert lost.mean() > 0.8
    assert np.isnan(trace.x_rad_per_s[lost]).all()
    assert (np.abs(trace.applied_x_rad_per_s[lost]).max() > 0.0) == (fallback == "least-violation")
    assert np.isnan(trace.loss[lost]).all()
    assert trace.tip_error_m.max() < 1e-3


def test_mu_of_a_run_is_the_model_s(robot):
    trace = short(0.05)
    for k in (0, 10, 24):
        assert trace.mu[k] == robot.state(trace.q_rad[k]).mu


def test_a_singular_pose_has_a_bound_and_a_lost_one_has_none():
    """Straight elbow: no single curve leads through it, yet tip and wrist have poses."""
    made = Setup(Scenario(duration_s=0.01, **{**BARE, "bound_samples": 5}))
    trace = made.trace()
    poses = trace.q_rad.copy()
    poses[0] = [0.3, 0.6, -0.2, 0.0, 0.4, -0.9, 0.0]
    poses[2] = np.nan
    bound, how = largest_mu(poses, made.robot, 5)
    np.testing.assert_array_equal(np.isnan(bound), [False, False, True, False, False])
    known = [0, 1, 3, 4]
    assert (bound[known] >= made.robot.mu_along(poses[known])).all()
    assert how == {"mu_bound_method": "scanned, all branches"}
    assert trace.meta["mu_bound_method"] == "scanned, all branches"
    assert "mu_bound_method" not in Setup(Scenario(duration_s=0.01, **BARE)).trace().meta


# --- repetition ---


def same(one, other):
    assert set(one.columns) == set(other.columns)
    for name in set(one.columns) - CLOCK:
        np.testing.assert_array_equal(one.columns[name], other.columns[name], err_msg=name)


@pytest.mark.parametrize("law", ["moc", "dcac"])
def test_same_seed_same_trace_to_the_bit(law):
    scenario = Scenario(
        duration_s=0.2, bound_samples=3, seed=5, start={"swivel": "random"}, control={"law": law}
    )
    same(run(scenario), run(scenario))


def test_a_setup_can_run_twice():
    setup = Setup(Scenario(duration_s=0.1, **BARE))
    same(setup.trace(), setup.trace())


def test_other_seed_other_trace():
    one, other = (short(0.1, seed=seed) for seed in (0, 1))
    for name in ("q_rad", "tau_Nm", "trocar_m"):
        assert (one.columns[name][1:] != other.columns[name][1:]).any(), name


# --- end to end ---


@pytest.fixture(scope="module")
def nominal():
    """Both laws from the same poor swivel, in the plant that equals the model, with matched gains."""
    base = Scenario(
        duration_s=3.0, start=POOR, plant={"preset": "nominal"}, bound_samples=9
    )
    return {law: run(base.change(control={"law": law})) for law in ("moc", "dcac")}


def test_moc_raises_the_manipulability_and_dcac_does_not(nominal, robot):
    moc, dcac = nominal["moc"], nominal["dcac"]
    best = self_motion(robot, moc.q_rad[0]).mu_best
    assert moc.mu[0] == dcac.mu[0] < 0.7 * best
    assert moc.mu[-1] > 0.95 * best
    assert abs(dcac.mu[-1] / dcac.mu[0] - 1.0) < 0.03
    numbers = summarize(moc, dcac)
    assert numbers["mu_gain_percent"] > 20.0
    assert numbers["verified_solved"] == numbers["claimed_solved"] == len(moc)
    assert numbers["silently_wrong"] == 0.0


def test_tip_follows_and_the_shaft_stays_in_the_trocar(nominal):
    moc, dcac = nominal["moc"], nominal["dcac"]
    assert dcac.tip_error_m.max() < 1e-4
    assert dcac.rcm_error_m.max() < 1e-3
    assert moc.tip_error_m.max() < 1e-3  # while the elbow swings over at half its joints' speed
    assert moc.rcm_error_m.max() < 4e-3
    settled = moc.t_s > 2.2
    assert moc.tip_error_m[settled].max() < 2e-4
    assert moc.rcm_error_m[settled].max() < 2e-3


def test_the_observer_takes_friction_and_wrong_masses_out():
    base = Scenario(
        duration_s=1.5, task={"wait_s": 0.2}, control={"law": "dcac"}, plant=CALIBRATED, **BARE
    )
    errors = []
    for gain in (20.0, 0.0):
        trace = run(base.change(control={"observer_gain_per_s": gain}))
        errors.append((trace.tip_error_m[250:].mean(), trace.rcm_error_m[250:].mean()))
    (tip, rcm), (tip_without, rcm_without) = errors
    assert tip < 0.3 * tip_without
    assert rcm < 0.8 * rcm_without
    assert tip < 2e-4


def test_observer_helps_moc_too():
    base = Scenario(duration_s=2.0, seed=2, start=POOR, plant=CALIBRATED, **BARE)
    tips = [
        run(base.change(control={"observer_gain_per_s": g})).tip_error_m[800:].mean() for g in (20.0, 0.0)
    ]
    assert tips[0] < 0.5 * tips[1]


def test_a_robots_file_is_found_from_the_scenarios_folder(tmp_path, monkeypatch):
    """Wherever the command is started; names of the package and absolute paths stay as they are."""
    folder = tmp_path / "arms"
    folder.mkdir()
    for kind in ("toml", "urdf"):
        text = (Path(loader.__file__).parent / f"panda.{kind}").read_text(encoding="utf-8")
        (folder / f"panda.{kind}").write_text(text, encoding="utf-8")
    path = tmp_path / "scenario.toml"
    monkeypatch.chdir("/")
    for given, expected in (
        ("arms/panda.toml", folder / "panda.toml"),
        (str(folder / "panda.urdf"), folder / "panda.urdf"),
    ):
        path.write_text(f'[robot]\nname = "{given}"\n', encoding="utf-8")
        loaded = Scenario.load(path)
        assert Path(loaded.robot.name) == expected
        assert loaded.robot.arm().data.name == "panda"
    path.write_text('[robot]\nname = "panda"\n', encoding="utf-8")
    assert Scenario.load(path).robot.name == "panda"


def test_recorded_solve_times_are_replayed_from_the_first_tick_on():
    """The discarded tick before the loop uses up none of them, and they begin anew at their end."""
    times = [11.0, 12.0, 13.0]
    setup = Setup(Scenario(duration_s=0.01, solver={"replay_us": times}, **BARE))
    assert setup.trace().solve_us.tolist() == [11.0, 12.0, 13.0, 11.0, 12.0]
    assert setup.trace().solve_us.tolist() == [11.0, 12.0, 13.0, 11.0, 12.0]


def test_a_length_in_millimetres_is_told_what_it_would_be_in_metres():
    with pytest.raises(ScenarioError, match=r"depth_m = 150.0: .* less than or equal to 10 m; 150 mm is 0.15"):
        Scenario(trocar={"depth_m": 150.0})
    with pytest.raises(ScenarioError, match=r"depth_m = -1.0: [^;]*$"):
        Scenario(trocar={"depth_m": -1.0})


def test_a_speed_in_millimetres_is_told_what_it_would_be_in_metres():
    with pytest.raises(ScenarioError, match=r"v_max_m_per_s = 50.0: .* less than or equal to 10 m/s; 50 mm/s is 0.05"):
        Scenario(task={"v_max_m_per_s": 50.0})
