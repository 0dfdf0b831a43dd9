"""The map is the arm's own kinematics, misses no pose, and no random search beats its largest mu."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from moc_opt.errors import RobotError
from moc_opt.planning import pose_map
from moc_opt.planning.course import Targets
from moc_opt.planning.elbow import Elbow
from moc_opt.planning.pose_map import PoseMap, closed_form, map_of
from moc_opt.planning.self_motion import self_motion
from moc_opt.robots.inverse_kinematics import solve_pose
from moc_opt.robots.model import RobotModel, load_robot
from tests.planning.arms import IIWA14, PANDA, H, at_poses, build, line_from


@pytest.fixture(scope="module", params=["lwr4", "iiwa14"])
def arm(request: pytest.FixtureRequest) -> RobotModel:
    return load_robot(request.param)


def traced(robot: RobotModel, targets: Targets, monkeypatch: pytest.MonkeyPatch) -> PoseMap:
    monkeypatch.setattr(pose_map, "closed_form", lambda robot: None)
    return map_of(robot, robot.data.q_home, targets)


def apart(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    found: np.ndarray = np.abs(np.mod(one - two + np.pi, 2.0 * np.pi) - np.pi)[..., :6].max(axis=-1)
    return found


def test_every_pose_has_tip_wrist_mu_and_room_of_the_model(arm: RobotModel) -> None:
    rng = np.random.default_rng(0)
    starts = np.array([arm.random_regular_pose(rng, margin=0.02) for _ in range(10)])
    found = map_of(arm, starts[0], at_poses(arm, starts), 180)
    for k in range(len(starts)):
        for branch, j in enumerate(rng.integers(180, size=8)):
            q = found.q_rad[k, branch, j]
            state = arm.state(q)
            np.testing.assert_allclose(state.tip, found.targets.tip[k], atol=1e-12)
            np.testing.assert_allclose(state.wrist, found.targets.wrist[k], atol=1e-12)
            assert state.mu == pytest.approx(found.mu[k, branch, j], abs=1e-12)
            room = np.minimum(q - arm.q_min, arm.q_max - q)[:6].min()
            assert room == pytest.approx(found.room_rad[k, branch, j], abs=1e-12)


def test_every_pose_of_the_arm_is_in_the_map_in_one_of_eight_branches(arm: RobotModel) -> None:
    rng, branches = np.random.default_rng(1), set()
    for _ in range(60):
        q = arm.random_regular_pose(rng, margin=0.01)
        found = map_of(arm, q, at_poses(arm, np.array([q, q])), 8)  # its swivel is one of the map's
        gaps = np.abs(found.q_rad[0] - q)[..., :6].max(axis=-1)
        branch, j = (int(i) for i in np.unravel_index(int(gaps.argmin()), gaps.shape))
        assert gaps[branch, j] < 1e-9
        elbow = Elbow(arm, found.targets.wrist)
        assert found.closed is not None
        assert np.cos(found.closed.swivel_rad[j] - elbow.swivel(q[None])[0]) == pytest.approx(1.0)
        branches.add(branch)
    assert len(branches) == 8


def test_no_random_start_beats_the_largest_mu_of_the_map(arm: RobotModel) -> None:
    """Inverse kinematics from random starts, each then climbed along its own self-motion by continuation."""
    rng, tried = np.random.default_rng(2), 0
    starts = np.array([arm.random_regular_pose(rng) for _ in range(3)])
    found = map_of(arm, starts[0], at_poses(arm, starts), 360)
    best = found.highest()
    for k, q in enumerate(starts):
        reached = []
        for _ in range(60):
            placed = solve_pose(arm, rng.uniform(arm.q_min, arm.q_max), found.targets.tip[k], found.targets.wrist[k])
            if placed.found:
                try:
                    reached.append(self_motion(arm, placed.q, 0.05).mu_best)
                except RobotError:
                    continue  # a singular pose
        tried += len(reached)
        assert max(reached) <= best[k] + 1e-6
        assert max(reached) >= best[k] - 1e-4, "the map promises what no search finds"
        assert arm.state(q).mu <= best[k]
    assert tried > 60


def test_out_of_reach_is_no_pose(robot: RobotModel) -> None:
    q = robot.data.q_home
    targets = at_poses(robot, np.array([q, q]))
    away = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    found = map_of(robot, q, Targets(targets.t_s, targets.tip + away, targets.wrist + away, np.zeros(2)), 90)
    assert np.isfinite(found.mu[0]).all()
    assert np.isnan(found.mu[1]).all()
    assert not found.feasible()[1].any()
    assert np.isnan(found.q_rad[1]).all()
    assert np.isnan(found.highest()[1])


@pytest.mark.parametrize("swivels", [4, 10**12, 9.5])
@pytest.mark.parametrize("name", ["lwr4", "panda"])
def test_too_few_and_too_many_swivels_are_refused(name: str, swivels: int) -> None:
    robot = load_robot(name)
    with pytest.raises(RobotError, match="swivels"):
        map_of(robot, robot.data.q_home, line_from(robot, robot.data.q_home), swivels)


# --- the normal form ---


@pytest.mark.parametrize(
    ("name", "shoulder", "lengths"), [("lwr4", 0.3105, [0.40, 0.39, 0.378]), ("iiwa14", 0.360, [0.42, 0.40, 0.426])]
)
def test_shipped_arms_have_their_published_lengths(name: str, shoulder: float, lengths: list[float]) -> None:
    arm = closed_form(load_robot(name))
    assert arm is not None
    np.testing.assert_allclose(arm.shoulder, [0.0, 0.0, shoulder], atol=1e-12)
    np.testing.assert_allclose([abs(arm.upper), abs(arm.fore), abs(arm.tool)], lengths, atol=1e-12)


@pytest.mark.parametrize(
    "changes",
    [
        {"mount": (0.0, 0.0, -0.081), "rpy": (0.3, 0.0, 0.0)},  # a tool at an angle to axis 7
        {"wrist": (0.01, 0.0, -0.081), "mount": (0.01, 0.0, 0.045)},  # beside it
        {"wrist": (0.0, 0.0, -0.07)},  # not where axes 5 to 7 meet
        {"q_max": np.radians([170, 120, 170, 120, 200, 120, 175])},  # one angle, two positions
        {"joints": [*IIWA14["joints"][:3], ((0.02, 0.0, 0.2155), (H, 0, 0)), *IIWA14["joints"][4:]]},  # elbow offset
        {"joints": [*IIWA14["joints"][:5], ((0.0, 0.0, 0.2155), (H - 0.1, 0, 0)), IIWA14["joints"][6]]},  # oblique
    ],
)
def test_an_arm_without_normal_form_is_told(tmp_path: Path, changes: dict[str, object]) -> None:
    assert closed_form(build(tmp_path, IIWA14)) is not None, "the name of an arm does not count"
    assert closed_form(build(tmp_path, IIWA14, **changes)) is None
    assert closed_form(build(tmp_path, PANDA)) is None


# --- traced ---


def test_tracing_agrees_with_the_closed_form(robot: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    targets = line_from(robot, robot.data.q_home)
    closed = map_of(robot, robot.data.q_home, targets)
    followed = traced(robot, targets, monkeypatch)
    np.testing.assert_allclose(followed.highest(), closed.highest(), atol=2e-4)
    assert (followed.highest() <= closed.highest() + 1e-6).all()
    assert followed.feasible().sum() > 200
    np.testing.assert_array_equal(followed.q_rad, traced(robot, targets, monkeypatch).q_rad)


def test_each_joint_keeps_its_own_margin(tmp_path: Path) -> None:
    panda = build(tmp_path, PANDA)
    found = map_of(panda, panda.data.q_home, line_from(panda, panda.data.q_home))
    margin = np.array([0.4, 0.1, 0.8, 0.3, 0.05, 0.2, 9.0])  # the last joint is idle
    may = found.feasible(margin)
    kept = np.array([
        [(pose >= panda.q_min + margin)[:6].all() and (pose <= panda.q_max - margin)[:6].all() for pose in poses]
        for poses in found.q_rad[:, 0]
    ])  # fmt: skip
    np.testing.assert_array_equal(may[:, 0], kept)
    assert found.feasible(0.8).sum() < may.sum() < found.feasible(0.05).sum()
    np.testing.assert_array_equal(found.feasible(np.full(7, 0.3)), found.feasible(0.3))


def test_a_panda_has_every_pose_that_random_starts_find(tmp_path: Path) -> None:
    panda = build(tmp_path, PANDA)
    targets = line_from(panda, panda.data.q_home)
    found = map_of(panda, panda.data.q_home, targets)
    poses = found.q_rad[2, 0][np.isfinite(found.mu[2, 0])]
    tips, wrists = panda.tool_along(poses)
    np.testing.assert_allclose(tips, np.tile(targets.tip[2], (len(poses), 1)), atol=1e-8)
    np.testing.assert_allclose(wrists, np.tile(targets.wrist[2], (len(poses), 1)), atol=1e-8)
    rng, seen = np.random.default_rng(5), 0
    for _ in range(60):
        placed = solve_pose(panda, rng.uniform(panda.q_min, panda.q_max), targets.tip[2], targets.wrist[2])
        if placed.found:
            seen += 1
            assert apart(poses, placed.q).min() < 0.1, "a pose that the map does not have"
    assert seen > 5


def test_more_swivels_than_the_default_are_denser_samples(tmp_path: Path) -> None:
    panda = build(tmp_path, PANDA)
    targets = line_from(panda, panda.data.q_home, 2)
    fewer, usual, twice = (map_of(panda, panda.data.q_home, targets, swivels) for swivels in (90, 720, 1440))
    one, two, four = (np.isfinite(found.mu[0]).sum() for found in (fewer, usual, twice))
    assert one == two
    assert four == pytest.approx(2 * two, rel=0.05)
    assert twice.highest()[0] == pytest.approx(usual.highest()[0], rel=1e-3)
