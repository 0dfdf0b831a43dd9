"""Forces on the arm."""

import re

import mujoco
import numpy as np
import pytest

from moc_opt.errors import MocOptError, PlantError
from moc_opt.robots import load_data
from moc_opt.robots.model import RobotModel
from moc_opt.sim import Plant, PlantSettings

DATA = load_data("lwr4")
MODEL = RobotModel(DATA)


def numpy_shaft_force(tip, wrist, twist, origin, trocar, elapsed, stiffness, damping):
    u = (tip - wrist) / np.linalg.norm(tip - wrist)
    p = trocar[0] + elapsed * trocar[1]
    c = tip + u * (u @ (p - tip))
    w = twist[3:] + np.cross(twist[:3], c - origin)
    across = np.eye(3) - np.outer(u, u)
    return across @ (stiffness * (p - c) + damping * (trocar[1] - w)), c


def shaft_of(plant, depth=0.15, off=1e-3):
    u = (plant.wrist - plant.tip) / np.linalg.norm(plant.wrist - plant.tip)
    side = np.cross(u, [1.0, 0.2, 0.0])
    return np.vstack([plant.tip + depth * u + off * side / np.linalg.norm(side), np.zeros(3)])


def test_push_replaces_the_previous_push_on_the_same_link():
    plant = Plant(DATA, PlantSettings.nominal())
    for push, message in (
        (("lnk_1", [1, 0, 0]), "did you mean 'link_1'"), (("link_1", [1, 0]), "push force"),
        (("link_1", [1, 0, 0], [np.nan, 0, 0]), "push point"),
    ):  # fmt: skip
        with pytest.raises(MocOptError, match=message):
            plant.push(*push)
    with pytest.raises(MocOptError, match="knee"):
        plant.clear_pushes("knee")
    assert not plant._pushes
    plant.push("link_1", [1, 0, 0])
    plant.push("link_1", [0, 2, 0])
    plant._load(0.0)
    np.testing.assert_array_equal(plant.mj_data.body("link_1").xfrc_applied, [0, 2, 0, 0, 0, 0])
    plant.clear_pushes("link_1")
    assert not plant._pushes
    plant.push("link_1", [1, 0, 0])
    plant.push(plant.mj_model.body(1).name, [1, 0, 0])  # the fixed base
    plant.reset(DATA.q_home)
    assert not plant._pushes


def test_trocar_and_pushes_act_at_their_points_of_application():
    """One plant step from rest with gravity compensated: v = step * M^-1 J^T F."""
    plant, state = Plant(DATA, PlantSettings.nominal(period_s=1e-3, substeps=1)), MODEL.state(DATA.q_home)
    trocar, lever = shaft_of(plant, depth=0.1, off=2e-3), np.array([0.01, 0.02, 0.03])
    force, _ = numpy_shaft_force(state.tip, state.wrist, np.zeros(6), np.zeros(3), trocar, 0.0, 800.0, 10.0)
    assert np.linalg.norm(force) == pytest.approx(1.6, rel=1e-9)
    share = 0.1 / np.linalg.norm(state.tip - state.wrist)
    pushed = ((1 - share) * state.J_tip + share * state.J_wrist).T @ force
    for link, push in (("tool", np.array([3.0, -2.0, 1.0])), ("link_3", np.array([-1.0, 4.0, 2.0]))):
        plant.push(link, push, lever)
        body, J = plant.mj_data.body(link), np.empty((3, 7))
        point = body.xpos + body.xmat.reshape(3, 3) @ lever
        mujoco.mj_jac(plant.mj_model, plant.mj_data, J, None, point, body.id)
        pushed += J.T @ push
    plant.step(state.h, trocar)
    np.testing.assert_allclose(plant.v, 1e-3 * np.linalg.solve(state.M, pushed), atol=1e-12)
    plant.clear_pushes()
    plant.step(state.h)
    assert not plant.mj_data.xfrc_applied.any()


@pytest.mark.parametrize(("stiffness", "damping"), [(800.0, 10.0), (800.0, 0.0), (0.0, 10.0)])
def test_trocar_force_is_computed_from_the_present_state(stiffness, damping):
    wall = PlantSettings.nominal(trocar_stiffness_N_per_m=stiffness, trocar_damping_Ns_per_m=damping)
    plant = Plant(DATA, wall)
    state = MODEL.state(DATA.q_home)
    trocar = shaft_of(plant)
    trocar[1] = [0.01, -0.02, 0.005]
    for _ in range(5):
        plant.step(state.h, trocar)
    now = MODEL.state(plant.q, plant.v)
    span, velocity = now.wrist - now.tip, (now.J_wrist - now.J_tip) @ plant.v
    twist = np.r_[np.cross(span, velocity) / (span @ span), now.J_tip @ plant.v]
    want, _ = numpy_shaft_force(now.tip, now.wrist, twist, now.tip, trocar, 0.002, stiffness, damping)
    np.testing.assert_allclose(plant.trocar_force, want, atol=1e-9)
    assert np.linalg.norm(want) > 0.1
    plant.step(state.h)
    assert not plant.trocar_force.any()


def test_trocar_moves_within_a_period():
    """One period of 20 plant steps equals ten periods of 2 steps."""
    coarse = Plant(DATA, PlantSettings.nominal(period_s=0.02, substeps=20))
    fine = Plant(DATA, PlantSettings.nominal())
    state = MODEL.state(DATA.q_home)
    trocar = shaft_of(coarse)
    trocar[1] = [0.05, 0.0, 0.02]
    coarse.step(state.h, trocar)
    for i in range(10):
        fine.step(state.h, trocar + np.array([i * 0.002 * trocar[1], np.zeros(3)]))
    np.testing.assert_allclose(coarse.q, fine.q, atol=1e-12)
    np.testing.assert_allclose(coarse.trocar_force, fine.trocar_force, atol=1e-9)


@pytest.mark.parametrize(
    ("stiffness", "damping"), [(800.0, 10.0), (800.0, 100.0), (20e3, 10.0), (20e3, 100.0), (20e3, 0.0)]
)
def test_trocar_gives_the_arm_no_energy(stiffness, damping):
    """The trocar is 1 mm beside the shaft and gravity is compensated."""
    wall = PlantSettings.nominal(trocar_stiffness_N_per_m=stiffness, trocar_damping_Ns_per_m=damping)
    plant = Plant(DATA, wall)
    trocar, springs, energies, damper = shaft_of(plant), [], [], 2.0 if damping else 0.0
    for _ in range(1000):
        plant.step(MODEL.state(plant.q, plant.v).h - damper * plant.v, trocar)
        springs.append(0.5 * np.sum(plant.trocar_force**2) / stiffness)
        energies.append(0.5 * plant.v @ MODEL.state(plant.q).M @ plant.v + springs[-1])
    first = 0.5 * stiffness * 1e-6
    assert max(energies) < 1.1 * first
    assert np.mean(energies[-100:]) < 1.05 * first
    if damping:
        assert max(springs) < 1.002 * first
        assert springs[-1] < 1e-4 * springs[0]


STIFF = np.array([1e4, 1e4, 1e4, 1e4, 7e3, 3e3, 3e3])


def elastic(**changes):
    given = {"joint_stiffness_Nm_per_rad": 1e4, "substeps": 12, "joint_spring_damping_Nm_s_per_rad": 30.0}
    return PlantSettings.nominal(**given | changes)


def hold(plant, periods, more=0.0):
    torque = plant.applied_torque + more
    for _ in range(periods):
        plant.step(torque)


@pytest.mark.parametrize("stiffness", [1e3, 1e4])
def test_elastic_joint_swings_at_the_frequency_of_rotor_and_links(stiffness):
    """The frequency is sqrt(k (1/B + 1/J)) with inertias B of the rotor and J of the links."""
    settings = elastic(
        joint_stiffness_Nm_per_rad=(stiffness, *[1e5] * 6), period_s=1e-3, substeps=100, gravity=False,
        joint_spring_damping_Nm_s_per_rad=0.0,
    )  # fmt: skip
    bent = np.array([0.0, 0.6, 0.0, 1.2, 0.0, -0.4, 0.0])
    plant = Plant(DATA, settings)
    plant.reset(bent)
    rotor = DATA.rotor_inertia[0]
    link = MODEL.state(bent).M[0, 0] - rotor
    plant.mj_data.qpos[1] = 1e-4  # deflects the spring of joint 1
    spring = np.zeros(300)
    for k in range(300):
        plant.step(np.zeros(7))
        spring[k] = plant.mj_data.qpos[1]
    up = np.flatnonzero((spring[:-1] < 0.0) & (spring[1:] >= 0.0))
    crossings = up + spring[up] / (spring[up] - spring[up + 1])
    measured = 2.0 * np.pi / (1e-3 * np.diff(crossings).mean())
    assert measured == pytest.approx(np.sqrt(stiffness * (1.0 / rotor + 1.0 / link)), rel=0.02)


@pytest.mark.parametrize("side", ["link", "motor"])
def test_weight_deflects_elastic_joints(side):
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


def test_very_stiff_joints_move_like_rigid_joints():
    rigid = Plant(DATA, PlantSettings.nominal(period_s=1e-3, substeps=400))
    stiff = Plant(DATA, elastic(joint_stiffness_Nm_per_rad=1.5e6, period_s=1e-3, substeps=400,
                                joint_spring_damping_Nm_s_per_rad=300.0))  # fmt: skip
    for plant in (rigid, stiff):
        hold(plant, 30, np.array([2.0, -2.0, 1.0, 1.0, 0.5, -0.5, 0.2]))
    assert np.abs(rigid.q - DATA.q_home).max() > 1e-4
    np.testing.assert_allclose(stiff.q, rigid.q, atol=2e-6)
    np.testing.assert_allclose(stiff.tip, rigid.tip, atol=2e-6)


def test_true_position_is_that_of_the_links():
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


def test_error_for_few_substeps_names_a_sufficient_number():
    with pytest.raises(PlantError, match="substeps = 2 makes plant steps of 1 ms") as said:
        Plant(DATA, elastic(substeps=2))
    fastest, need = map(int, re.search(r"up to (\d+) rad/s: raise substeps to (\d+)", str(said.value)).groups())
    assert need == np.ceil(0.002 * fastest)  # the phase of the fastest spring advances by at most 1 rad per step
    Plant(DATA, elastic(substeps=need))
    with pytest.raises(PlantError, match=r"has 2 entries.*7 joints"):
        Plant(DATA, elastic(joint_stiffness_Nm_per_rad=(1e4, 1e4)))
