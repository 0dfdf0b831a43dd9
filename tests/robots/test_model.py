"""The robot model agrees with finite differences, numpy and pinocchio."""

import json
import pickle
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from moc_opt import core
from moc_opt.errors import RobotError
from moc_opt.robots import loader, urdf
from moc_opt.robots.chain import desired_wrist
from moc_opt.robots.check import largest_rate
from moc_opt.robots.gains import derived_gains
from moc_opt.robots.model import RobotModel, RobotState, carried, layout, load_robot, restored
from moc_opt.sim.settings import PlantSettings
from moc_opt.tasks import Trocar
from tests.conftest import Draw

FOLDER = Path(loader.__file__).parent
Array = NDArray[np.float64]
STEP = 1e-6


@pytest.fixture(params=["robot", "odd_robot"])
def arm(request: pytest.FixtureRequest) -> RobotModel:
    return request.getfixturevalue(request.param)


def samples(arm: RobotModel, count: int = 8, seed: int = 1) -> Iterator[tuple[Array, Array, RobotState]]:
    rng = np.random.default_rng(seed)
    for _ in range(count):
        q = arm.random_regular_pose(rng, mu_min=0.02)
        v = rng.normal(size=arm.n)
        yield q, v, arm.state(q, v)


def reference(arm: RobotModel) -> tuple[Any, Any]:
    """Return a pinocchio model, built from the URDF without moc_opt, and its data."""
    model = pin.buildModelFromXML(arm.data.urdf)
    return model, model.createData()


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_gradients_scale_with_the_unit_of_length(robot: RobotModel, scale: float) -> None:
    joints, points, *others = robot.arm_arrays
    joints[:, 9:12] *= scale
    scaled, parts = core.Arm(joints, points * scale, *others), layout(robot.n)
    for q, v, s in samples(robot):
        record = scaled.terms(q, v)
        found = [record[parts["grad_mu"]] / scale**3, record[parts["grad_mu_shaft"]] / scale**2]
        np.testing.assert_allclose(found, [s.grad_mu, s.grad_mu_shaft], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(record[parts["scalars"]] / scale ** np.array([3, 1, 2]), s.record[parts["scalars"]])


def test_positions_jacobians_and_drifts_agree_with_pinocchio(arm: RobotModel) -> None:
    model, data = reference(arm)
    world = pin.LOCAL_WORLD_ALIGNED
    for q, v, s in samples(arm):
        pin.forwardKinematics(model, data, q, v, np.zeros(arm.n))
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        for name, point, jacobian, drift in (
            ("tip", s.tip, s.J_tip, s.drift_tip), ("wrist", s.wrist, s.J_wrist, s.drift_wrist),
        ):  # fmt: skip
            k = model.getFrameId(name, pin.FrameType.BODY)
            np.testing.assert_allclose(point, data.oMf[k].translation, atol=1e-13)
            np.testing.assert_allclose(jacobian, pin.getFrameJacobian(model, data, k, world)[:3], atol=1e-13)
            acceleration = pin.getFrameClassicalAcceleration(model, data, k, world).linear
            np.testing.assert_allclose(drift, acceleration, atol=1e-11)
        frame, pose = data.oMf[model.getFrameId("tool", pin.FrameType.BODY)], arm.tool_pose(q)
        np.testing.assert_allclose(arm.tool_along(q[None]), [[s.tip], [s.wrist]], rtol=0, atol=1e-14)
        np.testing.assert_allclose(pose, [*frame.rotation.T, s.tip], atol=1e-12)
        np.testing.assert_allclose(pose[2], s.tool_direction, atol=1e-12)
        np.testing.assert_allclose(frame.translation + arm.data.tool_length * pose[2], s.tip, atol=1e-12)
        np.testing.assert_allclose(s.wrist + s.tool_span * s.tool_direction, s.tip, atol=1e-15)


def test_manipulability_gradients_agree_with_finite_differences(arm: RobotModel) -> None:
    for q, _, s in samples(arm):
        assert s.mu == pytest.approx(np.sqrt(np.linalg.det(s.J_tip @ s.J_tip.T)), rel=1e-12)
        held = np.eye(arm.n) - np.linalg.pinv(s.J_tip) @ s.J_tip
        sizes = np.linalg.svd(s.J_wrist @ held)[1]
        assert s.mu_shaft == pytest.approx(sizes[0] * sizes[1], rel=1e-9)
        rows = np.vstack([s.J_tip, np.linalg.svd(s.tool_direction[None])[2][1:] @ s.J_wrist])
        assert s.mu * s.mu_shaft == pytest.approx(np.sqrt(np.linalg.det(rows @ rows.T)), rel=1e-8)
        pairs = [(arm.state(q + d), arm.state(q - d)) for d in STEP * np.eye(arm.n)]
        for name in ("mu", "mu_shaft"):
            slopes = [(getattr(above, name) - getattr(below, name)) / (2 * STEP) for above, below in pairs]
            np.testing.assert_allclose(getattr(s, f"grad_{name}"), slopes, atol=2e-8)


def test_gradient_of_mu_shaft_is_zero_if_the_shaft_can_turn_in_only_one_direction() -> None:
    """While the tip is held, the wrist can move in only one direction."""
    joints, n = np.tile(np.r_[np.eye(3).ravel(), np.zeros(3), 0.0, 0.0, 1.0, 0.0], (5, 1)), 5
    joints[:3, 12:15], joints[:3, 15], joints[3:, 12:15] = np.eye(3), 1.0, [0.0, 1.0, 0.0]
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.3]])
    bodies = np.tile(np.r_[1.0, np.zeros(3), np.eye(3)[np.tril_indices(3)]], (n, 1))
    arm = core.Arm(np.column_stack([joints, bodies, np.zeros(n)]), points, np.eye(3), np.ones((2, n)), np.zeros(3))
    state = RobotState(arm.terms(np.array([0.1, -0.2, 0.3, 0.4, 0.5]), np.zeros(n)), n)
    assert 0.0 <= state.mu_shaft < 1e-7
    np.testing.assert_array_equal(state.grad_mu_shaft, np.zeros(n))


@pytest.mark.parametrize("bend", [0.0, 1e-12, 1e-9])
def test_singular_arm_gives_no_nan(robot: RobotModel, bend: float) -> None:
    s = robot.state(np.array([0.2, 0.0, 0.0, bend, 0.0, 0.0, 0.0]))
    assert s.mu < 1e-6
    np.testing.assert_array_equal([s.grad_mu, s.grad_mu_shaft], np.zeros((2, 7)))
    assert np.isfinite(s.record).all()


def test_dynamic_terms_agree_with_pinocchio(arm: RobotModel) -> None:
    model, data = reference(arm)
    for q, v, s in samples(arm):
        bare = pin.crba(model, data, q)
        np.testing.assert_allclose(s.M, bare + np.diag(arm.data.rotor_inertia), atol=1e-13)
        np.testing.assert_array_equal(s.M, s.M.T)
        np.testing.assert_allclose(s.h, pin.rnea(model, data, q, v, np.zeros(arm.n)), atol=1e-11)
        C, g = pin.computeCoriolisMatrix(model, data, q, v), pin.computeGeneralizedGravity(model, data, q)
        np.testing.assert_allclose(s.energy_slope, C.T @ v, atol=1e-12)
        np.testing.assert_allclose([s.gravity, arm.gravity(q), arm.state(q).h], [g, g, g], atol=1e-12)


def test_entries_that_must_be_zero_are_exact(robot: RobotModel, odd_robot: RobotModel, regular_poses: Draw) -> None:
    np.testing.assert_array_equal(robot.moves, [[1, 1, 1, 1, 1, 1, 0], [1, 1, 1, 1, 0, 0, 0]])
    assert odd_robot.moves.all()
    for q in regular_poses(5):
        s = robot.state(q, np.ones(7))
        assert not s.J_tip[:, 6].any()
        assert not s.J_wrist[:, 4:].any()
        assert s.grad_mu[6] == 0.0


def test_states_share_no_memory(robot: RobotModel) -> None:
    q, v = robot.data.q_home.copy(), np.ones(7)
    first = robot.state(q, v)
    kept, second = first.record.copy(), robot.state(q + 0.3, -v)
    q[:] = 0.0
    np.testing.assert_array_equal(first.record, kept)
    assert not np.shares_memory(first.record, second.record)
    assert sum(part.stop - part.start for part in layout(7).values()) == kept.size
    copy = pickle.loads(pickle.dumps(first))
    np.testing.assert_array_equal(copy.record, kept)
    for state in (first, copy):
        with pytest.raises(ValueError, match="read-only"):
            state.J_tip[...] = 0.0
        with pytest.raises(AttributeError, match="mu"):
            state.mu = 1.0


@pytest.mark.parametrize(("q", "v", "message"), [
    (np.zeros(6), None, "q has shape"), (np.zeros((7, 1)), None, "q has shape"), (np.zeros(7), np.zeros(8), "v has"),
    ([0, 0, 0, np.nan, 0, 0, 0], None, "q = "), (np.zeros(7), [0, 0, 0, 0, 0, 0, -np.inf], "v = "),
    (["a"] * 7, None, "q = "),
])  # fmt: skip
def test_error_names_the_bad_vector(robot: RobotModel, q: Any, v: Any, message: str):
    with pytest.raises(RobotError, match=message):
        robot.state(q, v)
    good = np.linspace(-0.5, 0.7, 7)
    expected = robot.state(good, good).record
    assert np.isfinite(expected).all()
    for taken in (good.tolist(), tuple(good), np.repeat(good, 2)[::2]):
        np.testing.assert_array_equal(robot.state(taken, taken).record, expected)


def test_symbolic_kinematics_agree_with_the_model(arm: RobotModel) -> None:
    k, again = arm.kinematics(), pickle.loads(pickle.dumps(arm))
    assert k is arm.kinematics()
    assert pickle.loads(pickle.dumps(k)) == k
    for q, v, s in samples(arm):
        np.testing.assert_array_equal(again.state(q, v).record, s.record)
        np.testing.assert_allclose(np.array(k.tip(q)).ravel(), s.tip, atol=1e-12)
        np.testing.assert_allclose(np.array(k.wrist(q)).ravel(), s.wrist, atol=1e-12)
        assert float(k.mu(q)) == pytest.approx(s.mu, abs=1e-12)
        np.testing.assert_allclose(np.array(k.grad_mu(q)).ravel(), s.grad_mu, atol=1e-12)


def by_the_core(tip, tip_velocity, trocar, trocar_velocity, span):
    return core.desired_wrist(tip, tip_velocity, np.array([trocar, trocar_velocity]), span)


@pytest.mark.parametrize("kernel", [desired_wrist, by_the_core], ids=["numpy", "core"])
@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_desired_wrists_velocity_is_its_derivative(kernel, seed):
    rng = np.random.default_rng(seed)
    start, rate, distance = rng.normal(size=3), rng.uniform(0.5, 3.0), rng.uniform(0.1, 0.3)
    aside, breath, way = (v / np.linalg.norm(v) for v in rng.normal(size=(3, 3)))
    trocar = Trocar(start + distance * aside, 0.02, 3.0, breath)
    sway = 0.3 * distance * way  # so the tip stays away from the trocar
    span, t, step = 0.378, rng.uniform(0.0, 3.0), 1e-5

    def desired(time):
        tip, velocity = start + sway * np.sin(rate * time), sway * rate * np.cos(rate * time)
        p, dp = trocar.at(time)
        return kernel(tip, velocity, p, dp, span)

    slope = (desired(t + step)[0] - desired(t - step)[0]) / (2.0 * step)
    np.testing.assert_allclose(desired(t)[1], slope, atol=1e-6 * (1.0 + np.abs(slope).max()))


@pytest.mark.parametrize("name", ["lwr4", "lwr4_rail"])
def test_missing_gain_tables_are_derived(name: str, tmp_path: Path) -> None:
    path = tmp_path / f"{name}.toml"
    path.write_text((FOLDER / path.name).read_text(encoding="utf-8").partition("[gains.")[0], encoding="utf-8")
    shutil.copy(FOLDER / f"{name}.urdf", tmp_path)
    robot = load_robot(path)
    assert robot.data.gains == derived_gains(robot)
    path.write_text(path.read_text(encoding="utf-8") + "\n[gains.moc]\nK_X = 1.0\n", encoding="utf-8")
    gains = load_robot(path).data.gains
    assert dict(gains["moc"]) == {"K_X": 1.0}
    assert set(gains) == {"dcac", "moc", "default", "tuned", "robust"}


@pytest.mark.parametrize("name", ["iiwa14", "panda", "gen3", "xarm7", "lwr4_rail"])
def test_stored_gain_tables_equal_the_derived_ones(name: str) -> None:
    robot = load_robot(name)
    derived = derived_gains(robot)
    assert set(robot.data.gains) == set(derived)
    for key, table in derived.items():
        for gain, value in table.items():
            if (name, key) == ("gen3", "default") and gain in ("K_X", "D_X", "K_N", "D_N"):
                # With three ticks of delay, the gen3 is stable only with softer gains.
                assert robot.data.gains[key][gain] < value
                continue
            np.testing.assert_array_equal(robot.data.gains[key][gain], value, err_msg=f"{key}, {gain}")


@settings(max_examples=30)
@given(delay=st.integers(0, 6), side=st.sampled_from([0.98, 1.02]))
def test_largest_rate_is_the_stability_limit_of_a_delayed_loop(delay: int, side: float) -> None:
    """Below the limit, all roots of z^(d+1) - z^d + T rate lie within the unit circle."""
    plant = PlantSettings(delay_ticks=delay, velocity_cutoff_Hz=0.0)
    gain = side * largest_rate(plant) * plant.period_s
    roots = np.roots([1.0, -1.0, *[0.0] * (delay - 1), gain] if delay else [1.0, gain - 1.0])
    assert (np.abs(roots).max() < 1.0) == (side < 1.0)


def test_robot_restored_from_a_trace_is_the_same() -> None:
    robot = load_robot("lwr4_rail", tool_length=0.25)
    again = restored(json.loads(json.dumps(carried(robot))))
    q, v = robot.data.q_home, np.linspace(-1.0, 1.0, robot.n)
    np.testing.assert_array_equal(again.state(q, v).record, robot.state(q, v).record)
    assert again.data.gains["default"]["K_X"] == robot.data.gains["default"]["K_X"]
    assert again.data.tool_length == 0.25


@pytest.mark.parametrize("change", [
    {"q_min": [0.0]}, {"q_min": "x"}, {"q_max": [np.nan] * 7}, {"joint_names": []}, {"more": 1}, {"urdf": "<robot/>"},
    {"gains": 3}, {"tip_frame": "gone"}, {"joint_names": [*"abcdefg"]}, {"urdf": "<robot"}, None,
])  # fmt: skip
def test_damaged_stored_robot_is_refused(robot: RobotModel, change: dict[str, Any] | None) -> None:
    with pytest.raises(RobotError):
        restored([] if change is None else {**carried(robot), **change})  # type: ignore[arg-type]


RIGHT = np.pi / 2
Rows = list[tuple[float, float, float, float]]


def upright(signs: tuple[float, ...], lengths: tuple[float, ...]) -> Rows:
    """Return the DH rows of an arm whose neighbouring axes intersect (a = 0)."""
    return [(0, sign * RIGHT, d, 0) for sign, d in zip(signs, lengths, strict=True)]


# Denavit-Hartenberg rows (a, alpha, d, offset of q) from the makers, and the distance to the flange.
# In Craig's convention, a and alpha come before the joint's transform.
DH: dict[str, tuple[str, Rows, float]] = {
    "lwr4": ("classical", upright((1, -1, -1, 1, 1, -1, 0), (0.3105, 0, 0.4, 0, 0.39, 0, 0.078)), 0.0),
    "iiwa14": ("classical", upright((-1, 1, 1, -1, -1, 1, 0), (0.36, 0, 0.42, 0, 0.4, 0, 0.126)), 0.0),
    "panda": ("craig", [
        (0, 0, 0.333, 0), (0, -RIGHT, 0, 0), (0, RIGHT, 0.316, 0), (0.0825, RIGHT, 0, 0),
        (-0.0825, -RIGHT, 0.384, 0), (0, RIGHT, 0, 0), (0.088, RIGHT, 0, 0),
    ], 0.107),
    "xarm7": ("craig", [
        (0, 0, 0.267, 0), (0, -RIGHT, 0, 0), (0, RIGHT, 0.293, 0), (0.0525, RIGHT, 0, 0),
        (0.0775, RIGHT, 0.3425, 0), (0, RIGHT, 0, 0), (0.076, -RIGHT, 0.097, 0),
    ], 0.0),
    "gen3": ("classical", [
        (0, RIGHT, -(0.15643 + 0.12838), 0), (0, RIGHT, -(0.005375 + 0.006375), np.pi),
        (0, RIGHT, -2 * 0.21038, np.pi), (0, RIGHT, -2 * 0.006375, np.pi), (0, RIGHT, -(0.20843 + 0.10593), np.pi),
        (0, RIGHT, 0, np.pi), (0, np.pi, -(0.10593 + 0.061525), np.pi),
    ], 0.0),
}  # fmt: skip


def by_dh(name: str, q: Array) -> Array:
    """Return the tip (3,) of a 0.3 m tool, from the maker's table. The Gen3's table begins with z downwards."""
    kind, rows, flange = DH[name]
    T = pin.SE3(np.diag([1.0, -1.0, -1.0] if name == "gen3" else np.ones(3)), np.zeros(3))
    for (a, alpha, d, offset), angle in zip(rows, q, strict=True):
        across = pin.SE3(pin.utils.rotate("x", alpha), np.array([a, 0.0, 0.0]))
        along = pin.SE3(pin.utils.rotate("z", angle + offset), np.array([0.0, 0.0, d]))
        T = T * across * along if kind == "craig" else T * along * across
    return T.act(np.array([0.0, 0.0, flange + 0.3]))


def poses(robot: RobotModel, count: int = 8) -> Array:
    return np.random.default_rng(5).uniform(robot.q_min, robot.q_max, (count, robot.n))


@pytest.mark.parametrize("name", DH)
def test_tip_agrees_with_the_makers_table(name: str) -> None:
    robot = load_robot(name)
    miss = 5e-4 if name == "gen3" else 1e-9  # the table neglects two offsets of 0.175 mm
    for q in poses(robot):
        np.testing.assert_allclose(robot.state(q).tip, by_dh(name, q), rtol=0, atol=miss)


def test_iiwa14_has_the_mass_of_its_data_sheet() -> None:
    robot = load_robot("iiwa14")
    masses = [link.mass for link in urdf.read(robot.data.urdf).links]
    assert sum(masses) - robot.data.tool_mass == pytest.approx(29.9, rel=0.03)


def test_lwr4_rail_equals_the_lwr4_on_a_rail() -> None:
    rail, bare = load_robot("lwr4_rail"), load_robot("lwr4")
    for q in poses(rail):
        ours, theirs = rail.state(q), bare.state(q[1:])
        np.testing.assert_allclose(ours.tip, theirs.tip + np.array([0.0, q[0], 0.0]), rtol=0, atol=1e-9)
        np.testing.assert_allclose(ours.M[1:, 1:], theirs.M, rtol=0, atol=1e-9)
        assert ours.M[0, 0] == pytest.approx(20.0 + 10.0 + 15.85 + 0.3, abs=1e-9)  # drive, carriage, arm, tool
