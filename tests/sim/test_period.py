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


def test_a_package_without_its_library_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(mujoco, "__file__", str(tmp_path / "__init__.py"))
    with pytest.raises(PlantError, match="install MuJoCo from its wheel"):
        period.addresses(None, None)
