"""A period of the plant against MuJoCo's own steps through its Python binding."""

import mujoco
import numpy as np
import pytest

from moc_opt.errors import PlantError
from moc_opt.robots import load_data
from moc_opt.sim import Plant, PlantSettings, period

DATA = load_data("lwr4")


@pytest.mark.parametrize("substeps", [2, 3, 5])
def test_a_period_is_mujocos_own_halves_in_turn(substeps):
    """To the last bit, with friction and a push that both take in the same way."""
    plant = Plant(DATA, PlantSettings.realistic(substeps=substeps, delay_ticks=0, torque_ripple=0.0), seed=3)
    state = mujoco.MjData(plant.mj_model)
    mujoco.mj_copyData(state, plant.mj_model, plant.mj_data)
    for torque in plant.applied_torque + np.random.default_rng(0).uniform(-5.0, 5.0, (40, DATA.n)):
        plant.step(torque)
        state.qfrc_applied[:] = torque
        for _ in range(substeps):
            mujoco.mj_step2(plant.mj_model, state)
            mujoco.mj_step1(plant.mj_model, state)
    np.testing.assert_array_equal(plant.q, state.qpos)
    np.testing.assert_array_equal(plant.v, state.qvel)
    assert np.abs(plant.v).max() > 0.01


def test_a_refused_period_leaves_the_noise_and_the_arm_as_they_were():
    plants = [Plant(DATA, seed=1) for _ in range(2)]
    trocar = np.stack([plants[0].tip, np.zeros(3)])
    for k in range(70):  # beyond one block of noise
        torque = plants[0].applied_torque
        for plant in plants:
            plant.step(torque, trocar)
        wrong = np.full((2, 3), np.inf)
        for bad in ((torque * np.nan, trocar), (torque, wrong), (torque[:3], trocar), (torque, trocar[:1])):
            with pytest.raises(PlantError, match=r"the arm has not moved|one torque a joint"):
                plants[1].step(*bad)
        for one, other in zip(plants[0].measure(), plants[1].measure(), strict=True):
            np.testing.assert_array_equal(one, other, err_msg=str(k))


@pytest.mark.parametrize("place", range(6))
def test_a_trocar_with_one_entry_that_is_no_number_is_refused(place):
    plant = Plant(DATA, PlantSettings.nominal())
    trocar = np.stack([plant.tip, np.zeros(3)])
    trocar.flat[place] = np.nan
    with pytest.raises(PlantError, match="the arm has not moved"):
        plant.step(plant.applied_torque, trocar)


def test_a_package_without_its_library_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(mujoco, "__file__", str(tmp_path / "__init__.py"))
    with pytest.raises(PlantError, match="install MuJoCo from its wheel"):
        period.addresses(None, None)


@pytest.mark.parametrize("joint", range(DATA.n))
def test_a_runaway_of_one_joint_is_found_whichever_it_is(joint):
    plant = Plant(DATA, PlantSettings.nominal())
    plant.reset(DATA.q_home, 2e3 * np.eye(DATA.n)[joint])
    with pytest.raises(PlantError, match="call reset first"):
        plant.step(plant.applied_torque)


@pytest.mark.parametrize(("speed", "found"), [(999.0, False), (1000.5, True)])
def test_a_thousand_radians_a_second_is_no_arm(speed, found):
    """Whichever way it turns."""
    q, v = np.zeros(DATA.n), np.zeros(DATA.n)
    v[2] = -speed
    assert period._sound(q, v) != found


def test_the_noise_of_the_wrench_sensor_reaches_the_measurement():
    """Two plants that differ in it alone move alike: what their readings differ by is the noise."""
    force, torque = 0.1, 0.002
    noisy = Plant(DATA, PlantSettings.realistic(force_noise_N=force, torque_noise_Nm=torque), seed=5)
    quiet = Plant(DATA, PlantSettings.realistic(force_noise_N=0.0, torque_noise_Nm=0.0), seed=5)
    noise = []
    for _ in range(1000):
        for plant in (noisy, quiet):
            plant.step(plant.applied_torque)
        noise.append(noisy.measure().force - quiet.measure().force)
    np.testing.assert_array_equal(noisy.q, quiet.q)
    np.testing.assert_allclose(np.std(noise, axis=0), np.repeat([force, torque], 3), rtol=0.1)


@pytest.mark.parametrize("side", ["link", "motor"])
def test_the_encoders_of_elastic_joints_show_the_side_that_they_are_on(side):
    settings = PlantSettings.nominal(joint_stiffness_Nm_per_rad=1e4, substeps=12, encoder_side=side)
    plant = Plant(DATA, settings)
    for torque in plant.applied_torque + np.random.default_rng(2).uniform(-5.0, 5.0, (20, DATA.n)):
        plant.step(torque)
    q, v, *_ = plant.measure()
    for shown, coordinates in ((q, plant.mj_data.qpos), (v, plant.mj_data.qvel)):
        motor, spring = coordinates[::2], coordinates[1::2]
        np.testing.assert_array_equal(shown, motor if side == "motor" else motor + spring)
        assert np.abs(spring).min() > 1e-7  # the two sides differ in every joint
