"""The plant differs from the controller's model only by the errors in the plant's settings."""

import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import PlantError
from moc_opt.robots import load_data
from moc_opt.robots.model import RobotModel
from moc_opt.sim import Mismatch, Plant, PlantSettings
from moc_opt.sim.mjcf import build_spec, compile_model
from moc_opt.vision.board import rotation_from

DATA = load_data("lwr4")
MODEL = RobotModel(DATA)
NOMINAL = PlantSettings.nominal()
_HOME = MODEL.state(DATA.q_home)
TROCAR = np.array([0.6 * _HOME.tip + 0.4 * _HOME.wrist + [1e-3, 0.0, 0.0], [0.01, 0.0, -0.01]])


def nominal(seed=0, **changes):
    return Plant(DATA, PlantSettings.nominal(**changes), seed=seed)


def energy(plant):
    M = np.zeros((plant.data.n, plant.data.n))
    mujoco.mj_fullM(plant.mj_model, plant.mj_data, M)
    return 0.5 * plant.v @ M @ plant.v


def drive(plant, tau, periods):
    for _ in range(periods):
        plant.step(tau)
    return plant


def run(plant, periods, seed=0, trocar=TROCAR):
    rng = np.random.default_rng(seed)
    hold, rows = plant.applied_torque, []
    for _ in range(periods):
        plant.step(hold + rng.normal(size=7), trocar)
        rows.append(np.concatenate([plant.q, plant.v, plant.tip, plant.trocar_force, *plant.measure()[:3]]))
    return np.array(rows)


def test_motion_under_a_constant_torque_follows_pinocchios_dynamics():
    plant, rng = nominal(period_s=1e-3), np.random.default_rng(1)
    q, v = DATA.q_home.copy(), rng.uniform(-0.5, 0.5, 7)
    tau = rng.uniform(-5, 5, 7)
    plant.reset(q, v)
    plant.step(tau)
    for _ in range(2):
        state = MODEL.state(q, v)
        v = v + 5e-4 * np.linalg.solve(state.M, tau - state.h)
        q = q + 5e-4 * v
    np.testing.assert_allclose(plant.v, v, atol=1e-10)
    np.testing.assert_allclose(plant.q, q, atol=1e-12)


@given(st.integers(0, 1000), st.just(0.0) | st.floats(0.1, 5.0), st.sampled_from([2, 5, 20]))
@settings(max_examples=15)  # friction never adds energy; without friction, energy is constant
def test_friction_only_removes_energy_and_without_it_energy_is_kept(seed, scale, substeps):
    plant = nominal(friction=scale, friction_error=0.2, gravity=False, substeps=substeps if scale else 20)
    plant.reset(DATA.q_home, np.random.default_rng(seed).uniform(-0.5, 0.5, 7))
    first = energy(plant)
    course = np.array([first, *(energy(drive(plant, np.zeros(7), 1)) for _ in range(100))])
    if scale:
        assert ((np.diff(course) < 0.0) | (course[1:] < 1e-12)).all()
        assert course[-1] < 0.95 * first
    else:
        assert course[-1] == pytest.approx(first, rel=1e-3)


def test_friction_has_the_coefficients_of_the_robot_file():
    """The first axis is vertical, so only friction resists its steady turn."""
    plant, turning = nominal(friction=2.0, substeps=20), np.eye(7)[0]
    plant.reset(np.zeros(7), 0.4 * turning)
    needed = 2.0 * (DATA.viscous_friction[0] * 0.4 + DATA.coulomb_friction[0])
    assert drive(plant, needed * turning, 200).v[0] == pytest.approx(0.4, abs=1e-3)


def test_mass_error_changes_only_masses_and_inertias():
    plant, right = nominal(mass_error=0.1, seed=3), Plant(DATA, NOMINAL)
    wrong, exact = plant.mj_model, right.mj_model
    scale = wrong.body_mass[1:-2] / exact.body_mass[1:-2]
    assert 0.03 < np.abs(scale - 1).max() <= 0.1
    assert len(set(scale)) == len(scale)
    np.testing.assert_allclose(wrong.body_inertia[1:-2], scale[:, None] * exact.body_inertia[1:-2], rtol=1e-9)
    for name in ("body_ipos", "body_pos", "dof_armature", "dof_damping", "dof_frictionloss"):
        np.testing.assert_array_equal(getattr(wrong, name), getattr(exact, name), err_msg=name)


def test_mass_and_friction_factors_fill_their_ranges():
    def drawn(error, seed):
        settings = PlantSettings(mass_error=error, friction_error=2.0 * error, friction=3.0)
        one = Mismatch.draw(DATA, settings, DATA.joint_names, np.random.SeedSequence(seed))
        friction = [one.viscous_friction / DATA.viscous_friction, one.coulomb_friction / DATA.coulomb_friction]
        off = [list(one.mass_scale.values()), *(np.array(friction) / 3.0)]
        return (np.array(off) - 1.0) / [[1.0], [2.0], [2.0]]

    small, large = (np.array([drawn(error, seed) for seed in range(60)]) for error in (0.1, 0.2))
    np.testing.assert_allclose(large, 2.0 * small, atol=1e-12)
    assert (small[0] != small[1]).all()
    low, high = small.min(axis=(0, 2)), small.max(axis=(0, 2))
    assert ((low >= -0.1) & (low < -0.097)).all()
    assert ((high > 0.097) & (high <= 0.1)).all()
    assert np.linalg.norm(Plant(DATA, seed=5).mismatch.registration_error) == pytest.approx(5e-4)


def test_joints_stop_near_their_limits():
    plant = drive(nominal(friction=1.0, gravity=False), 10.0 * np.eye(7)[0], 2000)
    assert DATA.q_max[0] - 0.01 < plant.q[0] < DATA.q_max[0] + 0.05


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_torque_acts_after_the_delay(delay):
    plant = nominal(delay_ticks=delay)
    plant.reset(DATA.q_home + 0.2)  # the holding torque acts during the delay
    hold = plant.applied_torque
    commands = hold + DATA.tau_max * np.random.default_rng(7).normal(size=(8, 7))
    acted = [drive(plant, tau, 1).applied_torque for tau in commands]
    cut = np.clip(commands, -DATA.tau_max, DATA.tau_max)
    np.testing.assert_array_equal(acted, np.concatenate([np.tile(hold, (delay, 1)), cut])[:8])


def chain_tip(model, mismatch, q):
    """Return the tip by forward kinematics with the errors of the joint frames."""
    chain = model.chain
    place, turn = np.zeros(3), np.eye(3)
    for i in range(model.n):
        place = place + turn @ (chain.origins[i] + mismatch.origin_shift[i])
        turn = turn @ rotation_from(mismatch.origin_turn[i]) @ chain.rotations[i] @ rotation_from(q[i] * chain.axes[i])
    return place + turn @ (chain.offsets[0] + mismatch.origin_shift[-1])


def test_calibration_error_changes_only_the_plants_kinematics():
    plant, rng = nominal(2, calibration_error_m=4e-4, calibration_tilt_rad=3e-4), np.random.default_rng(2)
    mismatch = plant.mismatch
    np.testing.assert_allclose(np.linalg.norm(mismatch.origin_shift, axis=1), 4e-4)
    np.testing.assert_allclose(np.linalg.norm(mismatch.origin_turn, axis=1), 3e-4)
    for _ in range(5):
        plant.mj_data.qpos[:] = q = rng.uniform(DATA.q_min, DATA.q_max)
        mujoco.mj_forward(plant.mj_model, plant.mj_data)
        np.testing.assert_allclose(plant.tip, chain_tip(MODEL, mismatch, q), atol=1e-12)
        assert 1e-5 < np.linalg.norm(plant.tip - MODEL.state(q).tip) < 8 * 4e-4 + 7 * 3e-4 * 1.6
    mount = plant.mj_data.site("tool_mount_sensor").xmat.reshape(3, 3)
    np.testing.assert_allclose(plant.tip - plant.wrist, _HOME.tool_span * mount[:, 2], atol=1e-12)


def test_encoder_bias_displaces_tip_by_jacobian_times_bias():
    plant = nominal(1, encoder_bias_rad=5e-4)
    bias = plant.mismatch.encoder_bias
    np.testing.assert_array_equal(plant.measure().q, DATA.q_home - bias + bias)
    np.testing.assert_allclose(plant.q, DATA.q_home - bias, atol=1e-15)
    np.testing.assert_allclose(plant.tip - _HOME.tip, -_HOME.J_tip @ bias, atol=2e-6)
    drive(plant, plant.applied_torque, 3)
    np.testing.assert_allclose(plant.measure().q - plant.q, bias, atol=1e-15)


STREAMS = {
    "calibration_error_m": "origin_shift", "calibration_tilt_rad": "origin_turn", "encoder_bias_rad": "encoder_bias",
    "torque_ripple": "", "mass_error": "mass_scale", "trocar_registration_error_m": "registration_error",
}  # fmt: skip


@pytest.mark.parametrize("name", STREAMS)
def test_each_error_has_its_own_random_stream(name):
    full, none = (vars(Plant(DATA, PlantSettings(**off), seed=7).mismatch) for off in ({}, {name: 0.0}))
    changed = {field for field, drawn in full.items() if not np.all(drawn == none[field])}
    alone = nominal(**{name: 0.01}).mismatch
    assert alone.displaces == (STREAMS[name] in ("origin_shift", "origin_turn", "encoder_bias"))
    assert changed == ({STREAMS[name]} - {""})
    assert "world" not in full["mass_scale"]  # it has no mass


def test_torque_ripple_is_a_sine_of_joint_angle():
    plant = nominal(3, torque_ripple=0.01, torque_ripple_per_turn=50.0)
    other = nominal(4, torque_ripple=0.01)
    assert np.abs(plant.mismatch.ripple_phase - other.mismatch.ripple_phase).min() > 1e-3
    turn = 2.0 * np.pi / 50.0

    def ripple(first):
        plant.reset(np.array([first, *DATA.q_home[1:]]))
        return (plant.mj_data.qfrc_applied - plant.applied_torque)[0]

    course = np.array([ripple(0.1 + turn * k / 40) for k in range(81)])
    np.testing.assert_allclose(course[:41], course[40:], atol=1e-9)
    assert np.abs(course).max() == pytest.approx(0.01 * DATA.tau_max[0], rel=0.01)
    spectrum = np.abs(np.fft.rfft(course[:80]))
    assert spectrum[2] > 1e6 * np.delete(spectrum, 2).max()


def test_measurement_is_exact_in_the_nominal_plant():
    exact, near = Plant(DATA, NOMINAL), Plant(DATA, seed=2)
    for plant in (exact, near):
        run(plant, 50)
    np.testing.assert_array_equal(exact.measure()[:2], [exact.q, exact.v])
    np.testing.assert_array_equal(exact.measure().force, -exact.mj_data.sensordata[:6])  # the tool's force on the mount
    first = near.measure()
    assert first is near.measure()
    assert 0 < np.abs(first.q - near.q - near.mismatch.encoder_bias).max() < 1e-4
    assert 0 < np.abs(first.v - near.v).max() < 0.1
    for array in (*first[:3], near.q, near.v, near.tip, near.wrist, near.trocar_force, near.applied_torque):
        assert not array.flags.writeable


def test_equal_seeds_give_equal_numbers_also_in_threads():
    one, two = Plant(DATA, seed=9), Plant(DATA, seed=9)
    first = run(one, 100)
    np.testing.assert_array_equal(first, run(two, 100))
    one.push("link_4", [1, 2, 3])
    one.reset(DATA.q_home)
    np.testing.assert_array_equal(first, run(one, 100))
    assert not np.array_equal(first, run(Plant(DATA, seed=10), 100))
    without = Plant(DATA, PlantSettings(encoder_noise_rad=0), seed=9)  # the wrench's noise stays the same
    np.testing.assert_array_equal(Plant(DATA, seed=9).measure().force, without.measure().force)
    alone = [run(Plant(DATA, seed=seed), 300, seed) for seed in (1, 2)]
    with ThreadPoolExecutor(2) as threads:
        together = list(threads.map(run, [Plant(DATA, seed=seed) for seed in (1, 2)], [300, 300], [1, 2]))
    np.testing.assert_array_equal(alone, together)


def test_wrench_noise_reaches_the_measurement():
    levels = {"force_noise_N": 0.1, "torque_noise_Nm": 0.002}
    noisy, quiet = (Plant(DATA, PlantSettings(**given), seed=5) for given in (levels, dict.fromkeys(levels, 0.0)))
    seen = [[drive(one, one.applied_torque, 1).measure().force for _ in range(1000)] for one in (noisy, quiet)]
    np.testing.assert_array_equal(noisy.q, quiet.q)
    np.testing.assert_allclose(np.std(np.subtract(*seen), axis=0), np.repeat([0.1, 0.002], 3), rtol=0.1)


def test_refused_step_does_not_change_the_arm():
    one, other = Plant(DATA, seed=1), Plant(DATA, seed=1)
    torque, trocar = one.applied_torque, np.stack([one.tip, np.zeros(3)])
    for k in range(260):  # longer than one block of precomputed noise
        one.step(torque, trocar)
        other.step(torque, trocar)
        wrong = trocar.copy()
        wrong.flat[k % 6] = [np.nan, np.inf][k % 2]
        for bad in ((torque * np.nan, trocar), (torque, wrong), (torque[:3], trocar), (torque, trocar[:1])):
            with pytest.raises(PlantError, match=r"this step did not move the arm|one torque per joint"):
                other.step(*bad)
    for found, wanted in zip(other.measure(), one.measure(), strict=True):
        np.testing.assert_array_equal(found, wanted)


def test_refused_start_does_not_change_the_plant():
    plant = drive(Plant(DATA, NOMINAL), np.zeros(7), 3)
    before, far = plant.q, DATA.q_home + 9.0 * np.eye(7)[0]
    for start, words in (
        ([np.zeros(6)], "q ="), ([np.full(7, np.nan)], "q ="), ([DATA.q_home, np.zeros(3)], "v ="),
        ([far], r"q\[0\] = 9.*'joint_1'"),
    ):  # fmt: skip
        with pytest.raises(PlantError, match=words):
            plant.reset(*start)
    np.testing.assert_array_equal(plant.q, before)
    assert plant.time == pytest.approx(3 * 0.002)
    plant.reset(DATA.q_min)
    plant.reset(DATA.q_max)  # the limits are allowed


@pytest.mark.parametrize("force", [1e5, 1e15])
def test_after_a_runaway_the_plant_raises_errors_until_reset(force, tmp_path, monkeypatch):
    """A force of 1e15 N drives the state out of MuJoCo's valid range within one period."""
    monkeypatch.chdir(tmp_path)
    plant = Plant(replace(DATA, rotor_inertia=np.zeros(7)), NOMINAL)
    plant.push("tool", [force, 0.0, 0.0])
    for words in ("ran away before t = .* lower the controller's gains", "call reset first"):
        with pytest.raises(PlantError, match=words):
            plant.step(np.zeros(7))
    assert force > 1e10 or not list(tmp_path.iterdir())  # only the force of 1e15 N makes MuJoCo write a log file
    plant.reset(DATA.q_home)
    assert np.abs(drive(plant, plant.applied_torque, 1).v).max() < 1e-6


def test_nominal_preset_sets_every_error_to_zero():
    realistic, none = PlantSettings().model_dump(), NOMINAL.model_dump()
    for name, value in realistic.items():
        off = re.search("error|tilt|bias|noise|friction|delay|cutoff|resolution", name)
        assert (value > 0 and none[name] == 0) if off else value == none[name]
    assert PlantSettings.nominal(delay_ticks=2).delay_ticks == 2


def test_invalid_models_are_refused():
    bad = re.sub('ixx="0.01845"', 'ixx="0.9"', DATA.urdf)
    for data, words in (
        (replace(DATA, urdf="<robot"), "MuJoCo cannot read"),
        (replace(DATA, joint_names=(*DATA.joint_names[:6], "joint_9")), r"lists .*'joint_9'"),
        (replace(DATA, urdf=bad), "MuJoCo refuses its URDF"), (replace(DATA, tip_frame="nib"), r"no links .*'nib'"),
    ):  # fmt: skip
        with pytest.raises(PlantError, match=words):
            Plant(data, NOMINAL)
    assert compile_model("lwr4", build_spec(DATA, substep_s=1e-3)).nv == 7


def test_shapes_in_the_urdf_change_nothing():
    """The tip gets a collision box and a visual mesh whose file does not exist."""
    shapes = (
        '<link name="tip"><visual><geometry><mesh filename="package://no/where.stl"/></geometry></visual>'
        '<collision><geometry><box size="1 1 1"/></geometry></collision></link>'
    )
    dressed = replace(DATA, urdf=re.sub(r'<link name="tip" ?/>', shapes, DATA.urdf))
    assert dressed.urdf != DATA.urdf
    np.testing.assert_array_equal(run(Plant(dressed, seed=1), 20), run(Plant(DATA, seed=1), 20))
