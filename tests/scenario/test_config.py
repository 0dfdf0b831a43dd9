"""A scenario: validation, files and repeatable runs."""

import re
import shutil
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.control import ControlSettings
from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.errors import MocOptError, ScenarioError, UnknownNameError
from moc_opt.scenario import Scenario, Setup, run
from moc_opt.scenario.derived import largest_mu
from moc_opt.sim import PlantSettings
from moc_opt.tasks import shaft_distance
from tests.robots.arms import FOLDER

BARE = {"judge": False, "bound_samples": 0}

WRONG = [  # (tables, words of the error message)
    ({"task": {"radius": 0.01}}, "mean 'sizes.radius'"), ({"solver": {"name": "osqp", "eps": 1}}, "'settings.eps'"),
    ({"sede": 1}, "did you mean 'seed'"), ({"control": {"preste": "tuned"}}, "did you mean 'preset'"),
    ({"plant": {"prest": "x"}}, "mean 'preset'"), ({"control": {"preset": "papre"}}, "did you mean 'paper'"),
    ({"control": {"preset": "paper", "gain": "moc"}}, "did you mean 'gains'"), ({"plant": {"preset": ["x"]}}, "['x']"),
    ({"task": {"path": "cirle"}}, "did you mean 'circle'"), ({"task": {"sizes": {"radus": 0.01}}}, "mean 'radius'"),
    ({"solver": {"name": "exakt"}}, "'exact'"), ({"swivel": 0.3}, "belongs in [start]"),
    ({"task": {"duration_s": 3.0}}, "belongs at the top of the file"), ({"control": 5}, "a file write [control]"),
    ({"seed": -1}, "seed = -1"), ({"start": {"swivel": "0.3"}}, "no quotes"), ({"name": b"x"}, "name = b'x': give a"),
    ({"start": {"swivel": 2}}, "[start] swivel = 2: input should be less than or equal to 1, or 'given' or"),
    ({"plant": {"preset": "nominal", "delay_ticks": -1}}, "[plant] delay_ticks = -1"),
    ({"task": {"sizes": {"radius": "big"}}}, "sizes.radius = 'big'"), ({"task": {"normal": [0] * 3}}, "normal = [0"),
    ({"trocar": {"breathing_direction": [0, 0, 0]}}, "[trocar] breathing_direction = [0, 0, 0]: give"),
]  # fmt: skip
WRONG_AT_THE_RUN = [
    ({"robot": {"name": "lwr5"}}, "did you mean 'lwr4'"), ({"control": {"gains": "mock"}}, "did you mean 'moc'"),
    ({"solver": {"settings": {"tolerence": 1e-9}}}, "[solver] unknown setting of solver exact: 'tolerence': did"),
    ({"trocar": {"depth_m": 0.4}}, "0.378 m apart"), ({"start": {"q_rad": [0.0] * 7}}, "singular"),
    ({"start": {"pose": "random"}, "trocar": {"depth_m": 0.5}}, "0.378 m apart"),
    ({"duration_s": None, "task": {"sizes": {"radius": 30.0}}}, "radius = 30 (lengths in m): 188 m at"),
    ({"start": {"pose": "random"}, "task": {"sizes": {"radius": -1.0}}}, "radius"),
    ({"start": {"q_rad": [0.0] * 7, "swivel": 0.5}}, "singular"),
    ({"start": {"q_rad": [0.0, 3.0, *[0.0] * 5]}}, "joint 2 = 3 rad"),
    ({"duration_s": None, "task": {"sizes": {"radius": 3.0}}}, "check_path = false"),
]  # fmt: skip


@pytest.mark.parametrize(("tables", "words"), WRONG)
def test_wrong_key_or_value_is_named(tables, words):
    with pytest.raises((ScenarioError, UnknownNameError), match=re.escape(words)):
        Scenario(**tables)


@pytest.mark.parametrize(("tables", "words"), WRONG_AT_THE_RUN)
def test_scenario_that_cannot_run_is_refused_before_the_first_tick(tables, words):
    with pytest.raises(MocOptError, match=re.escape(words)):
        run(Scenario(**{"duration_s": 0.01, **tables}), watch=lambda tick: pytest.fail(f"moved at {tick}"))


def test_trace_stores_its_scenario():
    scenario = Scenario(
        name="all of it", seed=7, duration_s=0.02, deadline_us=1500.0, judge=False, start={"swivel": 0.3},
        trocar={"breathing_direction": [0.0, 1.0, 0.0]}, task={"path": "sinusoid", "sizes": {"amplitude": 0.01}},
        control={"gains": "moc", "K_X": 2500.0}, solver={"settings": {"tolerance": 1e-8}}, plant={"mass_error": 0.05},
    )  # fmt: skip
    trace = run(scenario)
    assert Scenario(**trace.meta["scenario"]) == scenario
    assert (trace.meta["deadline_us"], trace.meta["robot"]) == (1500.0, "lwr4")
    bias = Setup(scenario).plant.mismatch.encoder_bias
    np.testing.assert_array_equal(trace.meta["start_q_rad"] - bias, trace.q_rad[0])


@pytest.mark.parametrize(("tables", "told"), [
    ({}, {"repeat_joint_ticks": 89, "motion_lag_s": 0.012, "repeat_torque": 0.06, "stuck_rad_per_s": 0.2}),
    ({"guard": {"repeat_joint_ticks": 40}}, {"repeat_joint_ticks": 40}),
    *(({"guard": {key: 5}}, {"repeat_reading_ticks": 5}) for key in ("patience_ticks", "repeat_reading_ticks")),
    # Without noise, or without the velocity filter, successive readings may be equal.
    ({"plant": {"preset": "nominal"}}, {"repeat_joint_ticks": None, "repeat_reading_ticks": None}),
    ({"plant": {"velocity_cutoff_Hz": 0.0}}, {"repeat_reading_ticks": None, "motion_lag_s": 0.012}),
    # A slow filter delays the velocity.
    ({"plant": {"velocity_cutoff_Hz": 15.0}}, {"motion_lag_s": 3.0 / (2.0 * np.pi * 15.0)}),
    # A coarse encoder does not show small motions.
    ({"plant": {"encoder_resolution_rad": 1e-4}}, {"repeat_torque": 0.06, "stuck_rad_per_s": 0.2}),
    ({"plant": {"encoder_resolution_rad": 5e-4}}, {"repeat_torque": 0.25, "stuck_rad_per_s": 0.3}),
    ({"plant": {"encoder_resolution_rad": 5e-4}, "guard": {"repeat_torque": 0.4}}, {"repeat_torque": 0.4}),
])  # fmt: skip
def test_safety_thresholds_follow_from_the_encoders(tables, told):
    scenario = Scenario(**tables)
    assert {name: getattr(scenario.safety_settings, name) for name in told} == pytest.approx(told)
    assert scenario.guard == Scenario(guard=tables.get("guard", {})).guard


def test_change_of_one_setting_keeps_the_others():
    base = Scenario(plant=PlantSettings.nominal(), control={"supervisor": {"hold_ticks": 3}})
    assert base.change(control={"supervisor": {"check": False}}).control.supervisor.hold_ticks == 3
    assert base.change(plant={"delay_ticks": 2}).plant == PlantSettings.nominal(delay_ticks=2)
    assert base.change(plant={"preset": "realistic"}).plant == PlantSettings()
    assert base.change(control={"preset": "paper"}).control == ControlSettings.preset("paper")
    with pytest.raises(MocOptError, match="c2"):
        base.change(control={"c2": -1.0})
    with pytest.raises(ValueError, match="frozen"):
        base.seed = 3


def test_true_shaft_passes_through_trocar_despite_wrong_kinematics():
    """The model's tip is wrong by more than 0.5 mm."""
    bad = {"calibration_error_m": 5e-4, "calibration_tilt_rad": 5e-4, "encoder_bias_rad": 5e-4, "preset": "nominal"}
    setup = Setup(Scenario(plant=bad, seed=4, control={"law": "dcac"}, **BARE, duration_s=0.2))
    plant, state = setup.plant, setup.robot.state(setup.q_start)
    point = setup.trocar.at(0.0)[0]
    assert float(shaft_distance(plant.tip, plant.wrist, point)) < 1e-12
    np.testing.assert_array_equal(setup.registered.at(0.0)[0], state.tip - 0.15 * state.tool_direction)
    assert np.linalg.norm(plant.tip - state.tip) > 5e-4
    trace = setup.trace()
    plant.reset(setup.q_start)
    assert trace.tip_error_m[0] == pytest.approx(np.linalg.norm(plant.tip - state.tip), abs=1e-12)
    assert trace.tip_error_m.min() > 4e-4
    assert max(trace.tip_error_registered_m.max(), trace.tip_error_model_m.max()) < 5e-5
    np.testing.assert_allclose(trace.trocar_registered_m, trace.trocar_m, atol=1e-12)


@pytest.mark.parametrize("known", [True, False])
def test_registered_trocar_breathes_if_breathing_is_known(known):
    breathing = {"breathing_amplitude_m": 0.01, "breathing_period_s": 0.4, "breathing_known": known}
    trace = run(Scenario(duration_s=0.3, trocar=breathing, plant={"preset": "nominal"}, **BARE))
    moved = trace.trocar_m - trace.trocar_m[0]
    np.testing.assert_allclose(moved[:, :2], 0.0, atol=1e-15)
    assert moved[:, 2].max() == pytest.approx(0.01, abs=1e-5)
    assert trace.t_s[moved[:, 2].argmax()] == pytest.approx(0.2, abs=0.003)
    told = trace.trocar_registered_m - trace.trocar_registered_m[0]
    np.testing.assert_array_equal(told, moved if known else np.zeros_like(moved))


def test_upper_bound_of_mu_exists_at_a_singular_pose(robot):
    """With a straight elbow, the self-motion curve is not unique."""
    poses = np.tile(robot.data.q_home, (3, 1))
    poses[0], poses[2] = [0.3, 0.6, -0.2, 0.0, 0.4, -0.9, 0.0], np.nan
    bound, how = largest_mu(poses, robot, 5)
    np.testing.assert_array_equal(np.isnan(bound), [False, False, True])
    assert (bound[:2] >= robot.mu_along(poses[:2])).all()
    assert how == {"mu_bound_method": "scanned, all branches"}
    assert largest_mu(poses[2:], robot, 5)[1] == {}


@pytest.mark.parametrize("law", ["moc", "dcac"])
def test_same_seed_gives_the_same_trace_bitwise(law):
    scenario = Scenario(duration_s=0.2, bound_samples=3, seed=5, start={"swivel": "random"}, control={"law": law})
    setup = Setup(scenario)
    first, *others = (
        {name: column.tobytes() for name, column in trace.columns.items() if name not in ("tick_us", "solve_us")}
        for trace in (setup.trace(), setup.trace(), run(scenario))
    )
    assert others == [first, first]


def test_robot_file_is_found_from_scenarios_folder(tmp_path, monkeypatch):
    folder = tmp_path / "arms"
    folder.mkdir()
    for kind in ("toml", "urdf"):
        shutil.copy(FOLDER / f"panda.{kind}", folder)
    monkeypatch.chdir("/")
    for name, expected in (
        ("arms/panda.toml", str(folder / "panda.toml")), (f"{folder}/panda.urdf", f"{folder}/panda.urdf"),
        ("panda", "panda"),
    ):  # fmt: skip
        (tmp_path / "scenario.toml").write_text(f'[robot]\nname = "{name}"\n', encoding="utf-8")
        loaded = Scenario.load(tmp_path / "scenario.toml")
        assert (loaded.robot.name, loaded.robot.arm().data.name) == (expected, "panda")


NOT_NEGATIVE = st.just(0.0) | st.floats(1e-6, 90.0)
NAMES = st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9_.+-]{0,8}[A-Za-z0-9_]", fullmatch=True).filter(lambda s: ".." not in s)
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
FINITE = st.floats(1e-20, 1e6) | st.integers(-9, 9) | st.booleans() | TEXT


def table(**fields):
    return st.fixed_dictionaries({}, optional=fields)


SCENARIOS = table(
    name=NAMES, seed=st.integers(0, 2**63 - 1), duration_s=st.none() | st.floats(0.01, 100.0),
    control=table(preset=st.sampled_from(["paper", "tuned", "robust"]), regularization=st.floats(1e-9, 1.0),
                  K_N2=st.floats(0.1, 200.0) | st.lists(NOT_NEGATIVE, min_size=7, max_size=7),
                  gains=st.sampled_from([None, "moc", "default"]), rcm_lambda=st.none() | st.floats(0.1, 1.0),
                  fallback=st.sampled_from(["damping", "hold"]), supervisor=table(budget_us=st.floats(1.0, 1e4))),
    plant=table(preset=st.sampled_from(["nominal", "realistic"]), friction=st.floats(1e-6, 3.0),
                delay_ticks=st.integers(0, 4), gravity=st.booleans()),
    task=table(path=st.sampled_from(["circle", "spiral"]), heading=st.tuples(*[st.floats(0.1, 1.0)] * 3),
               sizes=st.dictionaries(st.just("radius"), st.floats(0.01, 0.1))),
    solver=table(name=st.sampled_from(["exact", "rnn", "osqp"]),
                 replay_us=st.none() | st.lists(NOT_NEGATIVE, max_size=3),
                 settings=st.dictionaries(NAMES, FINITE | st.lists(FINITE, max_size=3), max_size=3)),
    guard=table(position_margin_rad=st.floats(0.001, 0.1)),
)  # fmt: skip


@settings(max_examples=100)
@given(SCENARIOS)
def test_a_saved_scenario_loads_as_an_equal_one(tmp_path_factory, values):
    scenario, file = Scenario(**values), tmp_path_factory.mktemp("saved") / "scenario.toml"
    scenario.save(file)
    assert Scenario.load(file) == scenario
    assert eval(repr(scenario), {"Scenario": Scenario}) == scenario


def test_only_values_that_differ_from_defaults_are_written(tmp_path):
    tables = {"seed": 3, "control": {"preset": "tuned", "K_N2": 20.0}, "plant": {"preset": "nominal"}}
    assert Scenario(**tables).changes() == tables
    Scenario().save(tmp_path / "a.toml")
    assert (tmp_path / "a.toml").read_text(encoding="utf-8").strip() == ""
    assert repr(Scenario()) == "Scenario()"


def test_threshold_that_is_off_stays_off_after_loading(tmp_path):
    optional = {key: type(None) in get_args(kind.annotation) for key, kind in SafetyFilterSettings.model_fields.items()}
    lifted = [key for key, value in Scenario().guard if optional[key] and value is not None]
    assert "stop_yield_N" in lifted
    scenario = Scenario(guard=dict.fromkeys(lifted), control={"gains": None})
    scenario.save(tmp_path / "lifted.toml")
    assert Scenario.load(tmp_path / "lifted.toml") == scenario


def test_solver_setting_that_is_none_is_not_written(tmp_path):
    to = tmp_path / "new" / "folder" / "a.toml"
    Scenario(solver={"name": "qpsolvers:quadprog", "settings": {"cost_scale": None, "rows": 6}}).save(to)
    assert Scenario.load(to).solver.settings == {"rows": 6}
    with pytest.raises(ScenarioError, match=r"solver.settings.kinematics = <object .* has no form in TOML"):
        Scenario(solver={"name": "osqp", "settings": {"kinematics": object()}}).save(to)
    assert Scenario.load(to).solver.settings == {"rows": 6}
