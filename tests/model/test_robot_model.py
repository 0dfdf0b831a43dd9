"""The model against finite differences, plain numpy and pinocchio's own answers, at random regular poses."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from moc_opt.errors import RobotError
from moc_opt.model import kinematics_kernels as kernels
from moc_opt.model import manipulability_kernels, place_kernels
from moc_opt.model.robot_model import RobotModel, RobotState, load_robot
from tests.conftest import Draw

Array = NDArray[np.float64]
STEP = 1e-6
LWR4 = load_robot()  # for the laws, which cannot take a fixture


@pytest.fixture(params=["robot", "odd_robot"])
def arm(request: pytest.FixtureRequest) -> RobotModel:
    """The LWR4+, and an arm with no structure to hide behind."""
    model: RobotModel = request.getfixturevalue(request.param)
    return model


def samples(arm: RobotModel, count: int = 8, seed: int = 1) -> Iterator[tuple[Array, Array, RobotState]]:
    rng = np.random.default_rng(seed)
    for _ in range(count):
        q = arm.random_regular_pose(rng, mu_min=0.02)
        v = rng.normal(size=arm.n)
        yield q, v, arm.state(q, v)


def reference(arm: RobotModel) -> tuple[Any, Any]:
    """A pinocchio model of our own, built apart from the one under test."""
    model = pin.buildModelFromXML(arm.data.urdf)
    return model, model.createData()


def axes_of(arm: RobotModel, q: Array) -> Array:
    model, data = reference(arm)
    return np.ascontiguousarray(pin.computeJointJacobians(model, data, q).T)


def differences(function: Any, q: Array) -> Array:
    """Central differences, last axis over the joints."""
    columns = [(function(q + d) - function(q - d)) / (2 * STEP) for d in STEP * np.eye(len(q))]
    return np.stack(columns, axis=-1)


def test_tip_and_wrist_are_pinocchios_frames(arm: RobotModel) -> None:
    model, data = reference(arm)
    for q, v, s in samples(arm):
        pin.forwardKinematics(model, data, q, v, np.zeros(arm.n))
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        for name, point, jacobian, drift in (
            ("tip", s.tip, s.J_tip, s.drift_tip),
            ("wrist", s.wrist, s.J_wrist, s.drift_wrist),
        ):
            k = model.getFrameId(name, pin.FrameType.BODY)
            np.testing.assert_allclose(point, data.oMf[k].translation, atol=1e-13)
            world = pin.LOCAL_WORLD_ALIGNED
            np.testing.assert_allclose(jacobian, pin.getFrameJacobian(model, data, k, world)[:3], atol=1e-13)
            acceleration = pin.getFrameClassicalAcceleration(model, data, k, world).linear
            np.testing.assert_allclose(drift, acceleration, atol=1e-11)


def test_the_tools_pose_is_pinocchios_frame_and_leaves_the_state_alone(arm: RobotModel) -> None:
    rng = np.random.default_rng(3)
    for _ in range(5):
        q = rng.uniform(arm.q_min, arm.q_max)
        before = arm.state(q)
        pose = arm.tool_pose(rng.uniform(arm.q_min, arm.q_max))
        assert np.linalg.norm(pose[3] - before.tip) > 1e-3
        pose = arm.tool_pose(q)
        model, data = reference(arm)
        pin.framesForwardKinematics(model, data, q)
        frame = data.oMf[model.getFrameId("tool", pin.FrameType.BODY)]
        np.testing.assert_allclose(pose[:3], frame.rotation.T, atol=1e-12)
        np.testing.assert_allclose(pose[2], before.tool_direction, atol=1e-12)
        np.testing.assert_allclose(pose[3], before.tip, atol=1e-12)
        np.testing.assert_allclose(
            frame.translation + arm.data.tool_length * pose[2], before.tip, atol=1e-12
        )  # the mount, where the wrench is measured


def test_jacobians_against_finite_differences(arm: RobotModel) -> None:
    for q, _, s in samples(arm):
        np.testing.assert_allclose(s.J_tip, differences(lambda x: arm.state(x).tip, q), atol=1e-8)
        np.testing.assert_allclose(s.J_wrist, differences(lambda x: arm.state(x).wrist, q), atol=1e-8)


def test_drift_against_finite_differences(arm: RobotModel) -> None:
    for q, v, s in samples(arm):
        fast = (arm.state(q + STEP * v).A @ v - arm.state(q - STEP * v).A @ v) / (2 * STEP)
        np.testing.assert_allclose(np.r_[s.drift_tip, s.drift_wrist], fast, atol=1e-7)


def test_drift_kernel_is_its_double_sum(arm: RobotModel) -> None:
    for q, v, s in samples(arm, count=3):
        axes, out = axes_of(arm, q), np.empty(3)
        kernels.drift(axes, np.array(s.J_tip), v, out)
        plain = np.zeros(3)
        for j in range(arm.n):
            for k in range(arm.n):
                plain += np.cross(axes[min(j, k), 3:], s.J_tip[:, max(j, k)]) * v[j] * v[k]
        np.testing.assert_allclose(out, plain, atol=1e-13)


def test_point_jacobian_kernel_is_lin_plus_ang_cross_point(arm: RobotModel) -> None:
    for q, _, s in samples(arm, count=3):
        axes, out, moves = axes_of(arm, q), np.empty((3, arm.n)), np.ones(arm.n, dtype=bool)
        kernels.point_jacobian(axes, np.array(s.tip), moves, out)
        np.testing.assert_allclose(out, (axes[:, :3] + np.cross(axes[:, 3:], s.tip)).T, atol=1e-15)
        moves[2] = False
        kernels.point_jacobian(axes, np.array(s.tip), moves, out)
        assert not out[:, 2].any()


def test_mu_and_its_gradient_against_finite_differences(arm: RobotModel) -> None:
    for q, _, s in samples(arm, count=20):
        assert s.mu == pytest.approx(np.sqrt(np.linalg.det(s.J_tip @ s.J_tip.T)), rel=1e-12)
        assert manipulability_kernels.yoshikawa(np.array(s.J_tip)) == s.mu
        np.testing.assert_allclose(s.grad_mu, differences(lambda x: arm.state(x).mu, q), atol=2e-8)


def test_gradient_of_mu_is_mu_trace_dJ_pinv(arm: RobotModel) -> None:
    for q, _, s in samples(arm):
        axes, pinv = axes_of(arm, q), np.linalg.pinv(s.J_tip)
        for k in range(arm.n):
            dJ = [np.cross(axes[min(j, k), 3:], s.J_tip[:, max(j, k)]) for j in range(arm.n)]
            assert s.grad_mu[k] == pytest.approx(s.mu * np.trace(np.array(dJ).T @ pinv), abs=1e-13)


def test_mu_of_the_shaft_and_its_gradient_against_finite_differences(arm: RobotModel) -> None:
    for q, _, s in samples(arm, count=20):
        held = np.eye(arm.n) - np.linalg.pinv(s.J_tip) @ s.J_tip
        sizes = np.linalg.svd(s.J_wrist @ held)[1]
        assert s.mu_shaft == pytest.approx(sizes[0] * sizes[1], rel=1e-9)
        rows = np.vstack([s.J_tip, np.linalg.svd(s.tool_direction[None])[2][1:] @ s.J_wrist])
        assert s.mu * s.mu_shaft == pytest.approx(np.sqrt(np.linalg.det(rows @ rows.T)), rel=1e-8)
        np.testing.assert_allclose(s.grad_mu_shaft, differences(lambda x: arm.state(x).mu_shaft, q), atol=2e-8)


@pytest.mark.parametrize("way", [(1.0, 0.0, 0.0), (0.3, -0.7, 0.0)])
def test_a_shaft_that_cannot_turn_while_the_tip_is_held_gives_no_gradient(way: tuple[float, ...]) -> None:
    """Three joints for the tip alone, two that move the wrist in one and the same direction."""
    A, axes, grad = np.zeros((6, 5)), np.random.default_rng(0).normal(size=(5, 6)), np.ones(5)
    A[:3, :3], A[3:, 3], A[3:, 4] = np.eye(3), way, 2.0 * np.array(way)
    mu = manipulability_kernels.shaft_manipulability(axes, A, np.array([0.0, 0.0, 1.0]), grad)
    assert 0.0 <= mu < 1e-7
    np.testing.assert_array_equal(grad, np.zeros(5))


@pytest.mark.parametrize("bend", [0.0, 1e-12, 1e-9])
def test_a_singular_arm_gives_no_nan(robot: RobotModel, bend: float) -> None:
    s = robot.state(np.array([0.2, 0.0, 0.0, bend, 0.0, 0.0, 0.0]))
    assert s.mu < 1e-6
    np.testing.assert_array_equal(s.grad_mu, np.zeros(7))
    np.testing.assert_array_equal(s.grad_mu_shaft, np.zeros(7))
    assert np.isfinite(s.record).all()


def test_inertia_and_bias(arm: RobotModel) -> None:
    model, data = reference(arm)
    for q, v, s in samples(arm):
        bare = pin.crba(model, data, q)
        np.testing.assert_allclose(s.M, bare + np.diag(arm.data.rotor_inertia), atol=1e-13)
        np.testing.assert_array_equal(s.M, s.M.T)
        assert np.linalg.eigvalsh(s.M)[0] > 0.9 * arm.data.rotor_inertia.min()
        np.testing.assert_allclose(s.h, pin.rnea(model, data, q, v, np.zeros(arm.n)), atol=1e-11)


def test_coriolis_and_gravity_make_the_bias(arm: RobotModel) -> None:
    for q, v, s in samples(arm):
        C, g = arm.coriolis(q, v), arm.gravity(q)
        np.testing.assert_allclose(C @ v + g, s.h, atol=1e-11)
        np.testing.assert_allclose(arm.state(q).h, g, atol=1e-12)
        np.testing.assert_allclose(s.energy_slope, C.T @ v, atol=1e-12)
        np.testing.assert_allclose(s.gravity, g, atol=1e-12)
        dM = (arm.state(q + STEP * v).M - arm.state(q - STEP * v).M) / (2 * STEP)
        np.testing.assert_allclose(dM, C + C.T, atol=1e-7)


def test_the_slope_of_the_kinetic_energy(arm: RobotModel) -> None:
    for q, v, s in samples(arm, count=3):
        slope = differences(lambda x: np.array(0.5 * v @ arm.state(x).M @ v), q)  # noqa: B023 - used at once
        np.testing.assert_allclose(s.energy_slope, slope, atol=1e-7)


def test_gravity_is_the_gradient_of_the_potential(arm: RobotModel) -> None:
    model, data = reference(arm)
    for q, _, _ in samples(arm, count=3):
        slope = differences(lambda x: np.array(pin.computePotentialEnergy(model, data, x)), q)
        np.testing.assert_allclose(arm.gravity(q), slope, atol=1e-7)


def test_lwr4_has_the_published_dh_parameters(robot: RobotModel, regular_poses: Draw) -> None:
    alpha = np.radians([90, -90, -90, 90, 90, -90, 0])
    d = [0.3105, 0, 0.40, 0, 0.39, 0, 0.078 + 0.30]
    for q in regular_poses(5):
        T = np.eye(4)
        for angle, offset, twist in zip(q, d, alpha, strict=True):
            ct, st_, ca, sa = np.cos(angle), np.sin(angle), np.cos(twist), np.sin(twist)
            T = T @ np.array(
                [[ct, -st_ * ca, st_ * sa, 0], [st_, ct * ca, -ct * sa, 0], [0, sa, ca, offset], [0, 0, 0, 1]]
            )
        s = robot.state(q)
        np.testing.assert_allclose(s.tip, T[:3, 3], atol=1e-12)
        np.testing.assert_allclose(s.tool_direction, T[:3, 2], atol=1e-12)
        assert s.tool_span == pytest.approx(0.378, abs=1e-12)


def test_structural_zeros_are_exact(robot: RobotModel, odd_robot: RobotModel, regular_poses: Draw) -> None:
    np.testing.assert_array_equal(robot.moves, [[1, 1, 1, 1, 1, 1, 0], [1, 1, 1, 1, 0, 0, 0]])
    assert odd_robot.moves.all()
    for q in regular_poses(5):
        s = robot.state(q, np.ones(7))
        assert not s.J_tip[:, 6].any()
        assert not s.J_wrist[:, 4:].any()
        assert s.grad_mu[6] == 0.0


def test_tip_and_wrist_are_rigidly_tied(arm: RobotModel) -> None:
    for _, _, s in samples(arm):
        np.testing.assert_allclose(s.tool_direction @ (s.J_tip - s.J_wrist), 0, atol=1e-14)
        np.testing.assert_allclose(s.wrist + s.tool_span * s.tool_direction, s.tip, atol=1e-15)
        assert np.linalg.matrix_rank(s.A, tol=1e-9) == 5


def test_home_is_a_good_surgical_pose(robot: RobotModel) -> None:
    s = robot.state(robot.data.q_home)
    assert 0.2 < s.mu < 0.3
    assert s.tool_direction[2] < -0.95
    assert 0.5 < s.tip[0] < 0.6
    assert abs(s.tip[1]) < 0.01


def test_a_heavier_tool_adds_its_weight(robot: RobotModel) -> None:
    q = robot.data.q_home
    heavy = load_robot(tool_mass=1.3)
    s = robot.state(q)
    middle = s.J_wrist + (s.J_tip - s.J_wrist) * (0.078 + 0.15) / 0.378
    np.testing.assert_allclose(heavy.gravity(q) - robot.gravity(q), middle.T @ [0, 0, 9.81], atol=1e-12)


def test_states_share_no_memory_and_cannot_be_changed(robot: RobotModel) -> None:
    q, v = robot.data.q_home.copy(), np.ones(7)
    first = robot.state(q, v)
    kept = first.record.copy()
    second = robot.state(q + 0.3, -v)
    q[:] = 0.0
    np.testing.assert_array_equal(first.record, kept)
    assert not np.shares_memory(first.record, second.record)
    for name in kernels.StateViews._fields:
        public = {"u": "tool_direction", "drift": "drift_tip", "scalars": "record"}.get(name, name)
        with pytest.raises(ValueError, match="read-only"):
            getattr(first, public)[...] = 0.0
    with pytest.raises(AttributeError, match="immutable"):
        first.mu = 1.0  # type: ignore[misc]
    with pytest.raises(AttributeError, match="immutable"):
        del first.record


def test_the_record_is_what_the_attributes_show(arm: RobotModel) -> None:
    _, _, s = next(samples(arm))
    views = kernels.state_views(s.record, s.n)
    assert s.record.shape == (kernels.record_size(s.n),)
    assert sum(np.size(view) for view in views) == s.record.size
    for name in ("q", "v", "tip", "wrist", "A", "grad_mu", "grad_mu_shaft", "M", "h", "energy_slope", "gravity"):
        np.testing.assert_array_equal(getattr(views, name), getattr(s, name))
    np.testing.assert_array_equal(views.u, s.tool_direction)
    np.testing.assert_array_equal(views.drift, np.r_[s.drift_tip, s.drift_wrist])
    np.testing.assert_array_equal(views.scalars, [s.mu, s.tool_span, s.mu_shaft])
    np.testing.assert_array_equal(s.A, np.vstack([s.J_tip, s.J_wrist]))
    copy = pickle.loads(pickle.dumps(s))
    np.testing.assert_array_equal(copy.record, s.record)
    assert not copy.record.flags.writeable


def test_any_kind_of_vector_is_taken(robot: RobotModel) -> None:
    q = np.linspace(-0.5, 0.7, 7)
    expected = robot.state(q, q).record
    frozen = q.copy()
    frozen.flags.writeable = False
    for given_q in (q.tolist(), tuple(q), frozen, np.repeat(q, 2)[::2]):
        np.testing.assert_array_equal(robot.state(given_q, given_q).record, expected)


@pytest.mark.parametrize(
    ("q", "v", "message"),
    [
        (np.zeros(6), None, r"q has shape \(6,\).*7 joints"),
        (np.zeros((7, 1)), None, r"q has shape \(7, 1\)"),
        (0.0, None, r"q has shape \(\)"),
        (np.zeros(7), np.zeros(8), r"v has shape \(8,\)"),
        ([0, 0, 0, np.nan, 0, 0, 0], None, r"q = .*nan.* not finite"),
        (np.zeros(7), [0, 0, 0, 0, np.inf, 0, 0], r"v = .*inf.* not finite"),
        (np.zeros(7), [0, 0, 0, 0, 0, 0, -np.inf], "v = .*not finite"),
        (["a"] * 7, None, "q = .*not numeric"),
    ],
)
def test_bad_vectors_are_named(robot: RobotModel, q: Any, v: Any, message: str) -> None:
    with pytest.raises(RobotError, match=message):
        robot.state(q, v)
    good = robot.state(robot.data.q_home)
    assert np.isfinite(good.record).all()


def test_kinematics_are_the_models(arm: RobotModel) -> None:
    k = arm.kinematics()
    assert k is arm.kinematics()
    for q, _, s in samples(arm):
        np.testing.assert_allclose(np.array(k.tip(q)).ravel(), s.tip, atol=1e-12)
        np.testing.assert_allclose(np.array(k.wrist(q)).ravel(), s.wrist, atol=1e-12)
        assert float(k.mu(q)) == pytest.approx(s.mu, abs=1e-12)
        np.testing.assert_allclose(np.array(k.grad_mu(q)).ravel(), s.grad_mu, atol=1e-12)


def test_a_model_and_its_kinematics_can_be_sent_to_another_process(arm: RobotModel) -> None:
    q, v, s = next(samples(arm))
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(arm)).state(q, v).record, s.record)
    kinematics = pickle.loads(pickle.dumps(arm.kinematics()))
    assert kinematics == arm.kinematics()
    np.testing.assert_allclose(np.array(kinematics.tip(q)).ravel(), s.tip, atol=1e-12)


def test_kinematics_are_known_by_their_geometry(robot: RobotModel) -> None:
    same, other = load_robot().kinematics(), load_robot(tool_length=0.31).kinematics()
    assert same == robot.kinematics()
    assert hash(same) == hash(robot.kinematics())
    assert other != robot.kinematics()
    assert load_robot(tool_mass=0.5).kinematics() == same
    with pytest.raises(AttributeError):
        same.id = "other"  # type: ignore[misc]


def test_frames_and_joints_must_be_those_of_the_urdf(robot: RobotModel) -> None:
    fields = {name: getattr(robot.data, name) for name in robot.data.__dataclass_fields__}
    for change, message in (
        ({"tip_frame": "nose"}, "'nose' is no link"),
        ({"wrist_frame": "link_3"}, "'link_3' does not ride on the last joint"),
        ({"wrist_frame": "tip"}, "coincide"),
        ({"joint_names": tuple("abcdefg")}, "same serial chain"),
        ({"urdf": "<robot"}, "cannot be read by pinocchio"),
    ):
        with pytest.raises(RobotError, match=message):
            RobotModel(type(robot.data)(**{**fields, **change}))


def test_random_poses_keep_their_promise(robot: RobotModel, regular_poses: Draw) -> None:
    for q in regular_poses(50, seed=3):
        assert robot.state(q).mu > 0.05
        assert np.all(np.minimum(q - robot.q_min, robot.q_max - q) >= 0.0999 * (robot.q_max - robot.q_min))
    np.testing.assert_array_equal(regular_poses(3), regular_poses(3))
    with pytest.raises(RobotError, match="lower mu_min"):
        robot.random_regular_pose(np.random.default_rng(0), mu_min=5.0)


@settings(max_examples=60)
@given(st.lists(st.floats(-2.0, 2.0), min_size=7, max_size=7), st.floats(-2.9, 2.9), st.floats(-2.9, 2.9))
def test_mu_does_not_depend_on_the_first_and_last_joint(pose: list[float], first: float, last: float) -> None:
    s = LWR4.state(pose)
    turned = LWR4.state([first, *pose[1:6], last])
    assert turned.mu == pytest.approx(s.mu, abs=1e-6)
    if s.mu > 0.02:
        np.testing.assert_allclose(turned.grad_mu, s.grad_mu, atol=1e-10)
        assert abs(s.grad_mu[0]) < 1e-12


@settings(max_examples=60)
@given(
    st.lists(st.floats(-2.0, 2.0), min_size=7, max_size=7), st.lists(st.floats(-3, 3), min_size=7, max_size=7)
)
def test_drift_is_quadratic_and_even_in_the_velocity(pose: list[float], v: list[float]) -> None:
    s, twice = LWR4.state(pose, v), LWR4.state(pose, -2 * np.array(v))
    np.testing.assert_allclose(twice.drift_tip, 4 * s.drift_tip, atol=1e-10)
    np.testing.assert_allclose(twice.drift_wrist, 4 * s.drift_wrist, atol=1e-10)


def test_joints_are_where_pinocchio_has_them(arm: RobotModel) -> None:
    model = pin.buildModelFromXML(arm.data.urdf)
    data, rng, places = model.createData(), np.random.default_rng(3), np.empty((arm.n, 12))
    for _ in range(10):
        q = rng.uniform(arm.q_min, arm.q_max)
        pin.forwardKinematics(model, data, q)
        place_kernels.place_joints(arm.chain.joints, q, places)
        for place, known in zip(places, list(data.oMi)[1:], strict=True):
            np.testing.assert_allclose(place[:9].reshape(3, 3).T, known.rotation, atol=1e-14)
            np.testing.assert_allclose(place[9:], known.translation, atol=1e-14)


def test_points_along_poses_are_those_of_the_states(arm):
    poses = np.random.default_rng(8).uniform(arm.q_min, arm.q_max, (20, arm.n))
    tips, wrists = arm.tool_along(poses)
    for q, tip, wrist in zip(poses, tips, wrists, strict=True):
        state = arm.state(q)
        np.testing.assert_allclose([tip, wrist], [state.tip, state.wrist], rtol=0, atol=1e-14)


def test_poses_in_another_order_of_memory_are_taken(robot):
    """Compiled code reads rows that lie beside each other; columns would be read as rows without a word."""
    poses = np.random.default_rng(0).uniform(robot.q_min, robot.q_max, (5, 7))
    for same in (np.asfortranarray(poses), poses.T.copy().T):
        np.testing.assert_array_equal(robot.mu_along(same), robot.mu_along(poses))
        np.testing.assert_array_equal(robot.tool_along(same)[0], robot.tool_along(poses)[0])
