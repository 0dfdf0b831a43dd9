"""The closed form is the arm's own kinematics, misses no pose, and no random search beats its largest mu."""

from __future__ import annotations

import numpy as np
import pytest

from moc_opt.errors import RobotError
from moc_opt.model.inverse_kinematics import solve_pose
from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.planning.pose_map import SphericalMap, spherical_map
from moc_opt.planning.spherical import branch_of, spherical
from moc_opt.planning.targets import Targets
from moc_opt.redundancy.arm_angle import Elbow
from moc_opt.redundancy.self_motion import self_motion
from tests.conftest import Array


def map_of(robot: RobotModel, poses: list[Array], swivels: int = 180) -> SphericalMap:
    """Each pose's own tip and wrist as one time of a map."""
    states = [robot.state(q) for q in poses]
    tip, wrist = np.array([s.tip for s in states]), np.array([s.wrist for s in states])
    arm = spherical(robot)
    assert arm is not None
    targets = Targets(0.02 * np.arange(len(poses)), tip, wrist, np.zeros(len(poses)))
    return spherical_map(robot, arm, targets, swivels=swivels)


@pytest.fixture(scope="module", params=["lwr4", "iiwa14"])
def arm(request: pytest.FixtureRequest) -> RobotModel:
    return load_robot(request.param)


def test_every_pose_of_the_map_has_tip_wrist_mu_and_room_of_the_model(arm: RobotModel) -> None:
    rng = np.random.default_rng(0)
    starts = [arm.random_regular_pose(rng, margin=0.02) for _ in range(10)]
    found = map_of(arm, starts)
    for k in range(len(starts)):
        poses = found.poses(k)
        for branch in range(8):
            q = poses[branch, int(rng.integers(180))]
            j = int(np.flatnonzero((poses[branch] == q).all(axis=1))[0])
            state = arm.state(q)
            np.testing.assert_allclose(state.tip, found.targets.tip[k], atol=1e-12)
            np.testing.assert_allclose(state.wrist, found.targets.wrist[k], atol=1e-12)
            assert state.mu == pytest.approx(found.mu[k, branch, j], abs=1e-12)
            room = np.minimum(q - arm.q_min, arm.q_max - q)[:6].min()
            assert room == pytest.approx(found.room_rad[k, branch, j], abs=1e-12)


def test_every_pose_of_the_arm_is_in_the_map_at_its_swivel_and_branch(arm: RobotModel) -> None:
    rng = np.random.default_rng(1)
    starts = [arm.random_regular_pose(rng, margin=0.01) for _ in range(60)]
    found = map_of(arm, starts)
    elbow, branches = Elbow(arm, found.targets.wrist), set()
    for k, q in enumerate(starts):
        branch = branch_of(spherical(arm), q)  # type: ignore[arg-type]
        branches.add(branch)
        np.testing.assert_allclose(found.at(k, float(elbow.swivel(q[None])[0]), branch)[:6], q[:6], atol=1e-9)
    assert len(branches) == 8


def test_no_random_start_beats_the_largest_mu_of_the_map(arm: RobotModel) -> None:
    """Inverse kinematics from random starts, each then climbed along its own self-motion by continuation."""
    rng = np.random.default_rng(2)
    starts = [arm.random_regular_pose(rng) for _ in range(3)]
    found = map_of(arm, starts, swivels=360)
    best, tried = found.highest(), 0
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


def test_the_best_pose_is_feasible_and_keeps_the_margin(robot: RobotModel) -> None:
    rng = np.random.default_rng(3)
    found = map_of(robot, [robot.random_regular_pose(rng) for _ in range(20)])
    for margin in (0.0, 0.3):
        mu, swivel = found.peaks(margin)
        grid = np.where(found.feasible(margin), found.mu, -np.inf).max(axis=(1, 2))
        for k in np.flatnonzero(np.isfinite(grid)):
            rooms = []
            for branch in range(8):
                q = found.at(int(k), float(swivel[k]), branch)
                rooms.append(np.minimum(q - robot.q_min, robot.q_max - q)[:6].min())
            assert max(rooms) >= margin - 1e-6
            assert robot.state(q).mu == pytest.approx(mu[k], abs=1e-9)
            assert mu[k] >= grid[k]


def test_out_of_reach_is_no_pose(robot: RobotModel) -> None:
    state = robot.state(robot.data.q_home)
    away = np.array([2.0, 0.0, 0.0])
    arm = spherical(robot)
    assert arm is not None
    tips, wrists = np.array([state.tip, state.tip + away]), np.array([state.wrist, state.wrist + away])
    found = spherical_map(robot, arm, Targets(np.array([0.0, 0.1]), tips, wrists, np.zeros(2)), swivels=90)
    assert np.isfinite(found.mu[0]).all()
    assert np.isnan(found.mu[1]).all()
    assert not found.feasible()[1].any()
    assert np.isnan(found.poses(1)).all()
    assert np.isnan(found.highest()[1])


@pytest.mark.parametrize("swivels", [4, 10**12])
def test_too_few_and_too_many_swivels_are_refused(robot: RobotModel, swivels: int) -> None:
    with pytest.raises(RobotError, match=f"swivels = {swivels}: give a whole number from 8 to 2880"):
        map_of(robot, [robot.data.q_home], swivels=swivels)
