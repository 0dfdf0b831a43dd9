"""The estimate of the external force from the wrench sensor's readings."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import PlantError
from moc_opt.model.robot_model import RobotModel
from moc_opt.robots import load_data
from moc_opt.sim import Plant, PlantSettings, ToolLoad

DATA = load_data("lwr4")
MODEL = RobotModel(DATA)
ROD = ToolLoad(DATA.tool_mass, [0.0, 0.0, DATA.tool_length / 2])


def rotation(rng):
    matrix = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return matrix * np.sign(np.linalg.det(matrix))


def lean_on_trocar(plant, periods=3000):
    """The trocar the shaft leans on: the forearm is pushed, which the sensor cannot feel, until all rests."""
    u = (plant.wrist - plant.tip) / np.linalg.norm(plant.wrist - plant.tip)
    trocar = np.vstack([plant.tip + 0.15 * u, np.zeros(3)])
    plant.push("link_5", [8.0, 4.0, 1.6])
    for _ in range(periods):
        q, v, *_ = plant.measure()
        plant.step(MODEL.state(q, v).h + 500.0 * (DATA.q_home - q) - 30.0 * v, trocar)
    assert np.linalg.norm(plant.trocar_force) > 1.0
    return trocar


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50)
def test_identify_finds_the_load_it_was_shown(seed):
    rng = np.random.default_rng(seed)
    load = ToolLoad(rng.uniform(0.1, 2.0), rng.uniform(-0.2, 0.2, 3), rng.normal(size=6))
    turns = [rotation(rng) for _ in range(8)]
    found = ToolLoad.identify([load.expected(turn) for turn in turns], turns)
    assert found.mass == pytest.approx(load.mass, abs=1e-9)
    np.testing.assert_allclose(found.com, load.com, atol=1e-9)
    np.testing.assert_allclose(found.bias, load.bias, atol=1e-8)


def test_external_undoes_expected():
    rng = np.random.default_rng(6)
    turn, acceleration, push = rotation(rng), rng.normal(size=3), rng.normal(size=6)
    load = ToolLoad(0.4, [0.01, -0.02, 0.1], rng.normal(size=6))
    reading = load.expected(turn, acceleration)
    reading += np.concatenate([turn.T @ push[:3], turn.T @ push[3:]])
    np.testing.assert_allclose(load.external(reading, turn, acceleration), push, atol=1e-12)


def test_tare_zeroes_this_reading():
    rng = np.random.default_rng(7)
    turn, reading = rotation(rng), rng.normal(size=6)
    load = ToolLoad(0.4, [0.0, 0.0, 0.1], rng.normal(size=6)).tared(reading, turn)
    np.testing.assert_allclose(load.external(reading, turn), 0.0, atol=1e-12)


def test_sensor_of_a_resting_plant_shows_the_tool_only():
    plant = Plant(DATA, PlantSettings.nominal())
    np.testing.assert_allclose(plant.measure().force, ROD.expected(plant.mount_rotation), atol=1e-9)
    plant.step(plant.applied_torque)
    np.testing.assert_allclose(plant.measure().force, ROD.expected(plant.mount_rotation), atol=1e-9)


def test_sensor_of_an_accelerating_plant_shows_inertia():
    """Free fall with gravity on: compensated for the acceleration of the rod's centre, no force is left."""
    plant = Plant(DATA, PlantSettings.nominal(period_s=1e-4, substeps=1))
    share = (DATA.tool_length / 2) / np.linalg.norm(plant.tip - plant.wrist)
    state = MODEL.state(DATA.q_home)
    acceleration = np.linalg.solve(state.M, -state.h)
    centre = (1 - share) * state.J_tip + share * state.J_wrist
    turn = plant.mount_rotation
    plant.step(np.zeros(7))
    reading = plant.measure().force
    assert np.linalg.norm(ROD.external(reading, turn)[:3]) > 0.5
    np.testing.assert_allclose(ROD.external(reading, turn, centre @ acceleration)[:3], 0.0, atol=1e-9)


@pytest.mark.parametrize("stiffness", [800.0, 20e3])
def test_a_resting_trocar_is_felt(stiffness):
    settings = PlantSettings.nominal(trocar_stiffness_N_per_m=stiffness, trocar_damping_Ns_per_m=100)
    plant = Plant(DATA, settings)
    trocar = lean_on_trocar(plant)
    truth = plant.trocar_force
    assert np.abs(plant.v).max() < 1e-4
    external = ROD.external(plant.measure().force, plant.mount_rotation)
    np.testing.assert_allclose(external[:3], truth, atol=0.05)
    # The torque about the mount tells where on the shaft the force acts.
    mount = plant.tip - DATA.tool_length * plant.mount_rotation[:, 2]
    u = (plant.tip - plant.wrist) / np.linalg.norm(plant.tip - plant.wrist)
    contact = plant.tip + u * (u @ (trocar[0] - plant.tip))
    np.testing.assert_allclose(external[3:], np.cross(contact - mount, truth), atol=0.01)


def test_a_wrong_tool_mass_is_tared_away():
    plant = Plant(DATA, PlantSettings.realistic(mass_error=0.3, friction=0), seed=11)
    assert abs(plant.mismatch.mass_scale["tool"] - 1) > 0.05
    readings, turns = [], []
    for bend in (-0.6, 0.0, 0.6, 1.2):
        pose = DATA.q_home + bend * np.array([0, 0, 0, 0.3, 1, 0.5, 1])
        plant.reset(pose)
        hold = plant.applied_torque
        samples = []
        for _ in range(50):
            plant.step(hold)
            samples.append(plant.measure().force)
        readings.append(np.mean(samples, axis=0))
        turns.append(plant.mount_rotation)
    load = ToolLoad.identify(readings, turns)
    assert load.mass == pytest.approx(DATA.tool_mass * plant.mismatch.mass_scale["tool"], abs=0.01)
    plant.reset(DATA.q_home)
    trocar = lean_on_trocar(plant)
    external, truth = [], []
    for _ in range(300):
        q, v, force, _ = plant.measure()
        external.append(load.external(force, plant.mount_rotation)[:3])
        truth.append(plant.trocar_force)
        plant.step(MODEL.state(q, v).h + 500.0 * (DATA.q_home - q) - 30.0 * v, trocar)
    np.testing.assert_allclose(np.mean(external, axis=0), np.mean(truth, axis=0), atol=0.05)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: ToolLoad(-1.0, [0, 0, 0]), "mass = -1.0"),
        (lambda: ToolLoad(1.0, [0, 0]), "com"),
        (lambda: ToolLoad(1.0, [0, 0, np.nan]), "com"),
        (lambda: ToolLoad(1.0, [0, 0, 0], [0, 0, 0]), "bias"),
        (lambda: ROD.external([0] * 5, np.eye(3)), "reading"),
        (lambda: ROD.external([0] * 6, np.eye(2)), "rotation"),
        (lambda: ToolLoad.identify([[0.0] * 6] * 4, [np.eye(3)] * 4), "too little"),
        (lambda: ToolLoad.identify([[0.0] * 6] * 2, [np.eye(3)] * 2), "three or more"),
        (lambda: ToolLoad.identify([[0.0] * 6] * 3, [np.eye(3)] * 2), "rotations"),
    ],
)
def test_bad_loads_are_named(call, words):
    with pytest.raises(PlantError, match=words):
        call()


def test_readings_of_the_wrong_sign_are_refused():
    rng = np.random.default_rng(8)
    turns = [rotation(rng) for _ in range(5)]
    with pytest.raises(PlantError, match="exerts on the mount"):
        ToolLoad.identify([-ROD.expected(turn) for turn in turns], turns)
