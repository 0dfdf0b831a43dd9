"""Elastic joints swing at their own frequency, bend under the weight, and are refused where the step is too coarse."""

import re

import numpy as np
import pytest

from moc_opt.errors import PlantError
from moc_opt.robots import load_data
from moc_opt.robots.model import RobotModel
from moc_opt.sim import Plant, PlantSettings

DATA = load_data("lwr4")
MODEL = RobotModel(DATA)
STIFF = np.array([1e4, 1e4, 1e4, 1e4, 7e3, 3e3, 3e3])


def elastic(**changes):
    given = {"joint_stiffness_Nm_per_rad": 1e4, "substeps": 12, "joint_spring_damping_Nm_s_per_rad": 30.0}
    return PlantSettings.nominal(**given | changes)


def hold(plant, periods, more=0.0):
    torque = plant.applied_torque + more
    for _ in range(periods):
        plant.step(torque)


@pytest.mark.parametrize("stiffness", [1e3, 1e4])
def test_a_joint_swings_at_the_frequency_of_its_two_inertias(stiffness):
    """Joint 1 of an upright arm turns all links about their common axis: sqrt(k (1/B + 1/J))."""
    settings = elastic(
        joint_stiffness_Nm_per_rad=(stiffness, *[1e5] * 6), period_s=1e-3, substeps=100, gravity=False,
        joint_spring_damping_Nm_s_per_rad=0.0,
    )  # fmt: skip
    bent = np.array([0.0, 0.6, 0.0, 1.2, 0.0, -0.4, 0.0])
    plant = Plant(DATA, settings)
    plant.reset(bent)
    rotor = DATA.rotor_inertia[0]
    link = MODEL.state(bent).M[0, 0] - rotor
    plant.mj_data.qpos[1] = 1e-4  # the first spring; nothing moves but for it
    spring = np.zeros(300)
    for k in range(300):
        plant.step(np.zeros(7))
        spring[k] = plant.mj_data.qpos[1]
    up = np.flatnonzero((spring[:-1] < 0.0) & (spring[1:] >= 0.0))
    crossings = up + spring[up] / (spring[up] - spring[up + 1])
    measured = 2.0 * np.pi / (1e-3 * np.diff(crossings).mean())
    assert measured == pytest.approx(np.sqrt(stiffness * (1.0 / rotor + 1.0 / link)), rel=0.02)


@pytest.mark.parametrize("side", ["link", "motor"])
def test_the_weight_bends_the_joints_and_the_arm_rests(side):
    plant = Plant(DATA, elastic(joint_stiffness_Nm_per_rad=tuple(STIFF), encoder_side=side))
    sag = plant.mj_data.qpos[1::2]
    np.testing.assert_allclose(sag, -MODEL.state(plant.q).h / STIFF, atol=1e-12)
    assert np.abs(sag).max() > 1e-3
    np.testing.assert_allclose(plant.measure().q, DATA.q_home, atol=1e-12)
    shown = plant.q if side == "link" else plant.q - sag
    np.testing.assert_allclose(shown, DATA.q_home, atol=1e-12)
    before = plant.q
    hold(plant, 200)
    np.testing.assert_allclose(plant.q, before, atol=1e-9)
    np.testing.assert_allclose(plant.applied_torque, MODEL.state(before).h, atol=1e-9)


def test_very_stiff_joints_are_rigid_ones():
    rigid = Plant(DATA, PlantSettings.nominal(period_s=1e-3, substeps=400))
    stiff = Plant(DATA, elastic(joint_stiffness_Nm_per_rad=1.5e6, period_s=1e-3, substeps=400,
                                joint_spring_damping_Nm_s_per_rad=300.0))  # fmt: skip
    for plant in (rigid, stiff):
        hold(plant, 30, np.array([2.0, -2.0, 1.0, 1.0, 0.5, -0.5, 0.2]))
    assert np.abs(rigid.q - DATA.q_home).max() > 1e-4
    np.testing.assert_allclose(stiff.q, rigid.q, atol=2e-6)
    np.testing.assert_allclose(stiff.tip, rigid.tip, atol=2e-6)


def test_truth_is_the_link_and_the_trace_row_says_so():
    plant = Plant(DATA, elastic(encoder_side="motor"))
    hold(plant, 20, 5.0)
    motors, links = plant.measure().q, plant.q
    np.testing.assert_array_equal(links, plant.mj_data.qpos[::2] + plant.mj_data.qpos[1::2])
    np.testing.assert_array_equal(motors, plant.mj_data.qpos[::2])
    row = np.empty(2 * DATA.n + 9)
    plant.write_truth(row)
    np.testing.assert_array_equal(row[:7], links)
    np.testing.assert_allclose(MODEL.state(links).tip, plant.tip, atol=1e-12)


def test_brakes_act_on_the_motors_until_reset():
    plant = Plant(DATA, elastic())
    spring = plant.mj_model.dof_damping[1::2].copy()
    plant.brake(15.0)
    np.testing.assert_array_equal(plant.mj_model.dof_damping[1::2], spring)
    assert plant.mj_model.dof_damping[::2].min() >= 15.0
    plant.reset(DATA.q_home)
    assert plant.mj_model.dof_damping[::2].max() < 15.0


def test_a_step_too_coarse_for_the_springs_is_refused_with_the_cure():
    with pytest.raises(PlantError, match="substeps = 2 makes plant steps of 1 ms") as said:
        Plant(DATA, elastic(substeps=2))
    fastest, need = map(int, re.search(r"up to (\d+) rad/s: raise substeps to (\d+)", str(said.value)).groups())
    assert need == np.ceil(0.002 * fastest)  # one radian a step
    Plant(DATA, elastic(substeps=need))
    with pytest.raises(PlantError, match=r"has 2 entries.*7 joints"):
        Plant(DATA, elastic(joint_stiffness_Nm_per_rad=(1e4, 1e4)))
