"""Continuation finds what the closed form knows, and serves arms that have none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from moc_opt.errors import RobotError
from moc_opt.model.inverse_kinematics import solve_pose
from moc_opt.model.robot_model import RobotModel
from moc_opt.planning.plan import map_of
from moc_opt.planning.pose_map import spherical_map
from moc_opt.planning.spherical import spherical
from moc_opt.planning.targets import Targets, lay_targets
from moc_opt.planning.traced import traced_map
from moc_opt.redundancy.self_motion import self_motion
from moc_opt.tasks import Reference, Trocar, make_path
from tests.conftest import Array
from tests.planning.arms import PANDA, build


def line_from(robot: RobotModel, q: Array, count: int = 4) -> Targets:
    state = robot.state(q)
    path = make_path("line", state.tip, normal=(0.0, 0.0, 1.0), heading=(1.0, 0.0, 0.0), length=0.02)
    trocar = Trocar(state.tip - 0.15 * state.tool_direction)
    return lay_targets(Reference(path, 0.05, 0.2), trocar, state.tool_span, 0.8, count)


def test_continuation_agrees_with_the_closed_form(robot: RobotModel) -> None:
    q = robot.data.q_home
    targets, arm = line_from(robot, q), spherical(robot)
    assert arm is not None
    traced = traced_map(robot, targets, q, seeds=32)
    closed = spherical_map(robot, arm, targets)
    np.testing.assert_allclose(traced.highest(), closed.highest(), atol=2e-4)
    assert (traced.highest() <= closed.highest() + 1e-6).all()
    # as many poses: one elbow circle and its branches, but for samples
    assert traced.feasible().sum() > 200


def test_each_joint_keeps_its_own_margin(tmp_path: Path) -> None:
    panda = build(tmp_path, PANDA)
    found = traced_map(panda, line_from(panda, panda.data.q_home), panda.data.q_home)
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
    q = panda.data.q_home
    targets = line_from(panda, q)
    found = traced_map(panda, targets, q)
    poses = found.poses(2)[0]
    known = np.isfinite(poses[:, 0])
    for pose in poses[known][::20]:
        state = panda.state(pose)
        np.testing.assert_allclose(state.tip, targets.tip[2], atol=1e-8)
        np.testing.assert_allclose(state.wrist, targets.wrist[2], atol=1e-8)
    rng, seen = np.random.default_rng(5), 0
    for _ in range(60):
        placed = solve_pose(panda, rng.uniform(panda.q_min, panda.q_max), targets.tip[2], targets.wrist[2])
        if not placed.found:
            continue
        seen += 1
        gap = np.abs(np.mod(poses[known][:, :6] - placed.q[:6] + np.pi, 2 * np.pi) - np.pi).max(axis=1).min()
        assert gap < 0.1, "a pose that the map does not have"
        try:
            assert self_motion(panda, placed.q, 0.05).mu_best <= found.highest()[2] + 2e-4
        except RobotError:
            continue  # singular
    assert seen > 5
    rooms = np.minimum(poses[known] - panda.q_min, panda.q_max - poses[known])[:, :6].min(axis=1)
    np.testing.assert_allclose(found.room_rad[2, 0, known], rooms, atol=1e-12)


def test_more_swivels_than_the_default_are_denser_samples(tmp_path: Path) -> None:
    panda = build(tmp_path, PANDA)
    targets = line_from(panda, panda.data.q_home, 2)
    fewer, usual, twice = (map_of(panda, panda.data.q_home, targets, swivels) for swivels in (90, 720, 1440))
    one, two, four = (np.isfinite(found.mu[0]).sum() for found in (fewer, usual, twice))
    assert one == two
    assert four == pytest.approx(2 * two, rel=0.05)
    assert twice.highest()[0] == pytest.approx(usual.highest()[0], rel=1e-3)
    with pytest.raises(RobotError, match="swivels = 4"):
        map_of(panda, panda.data.q_home, targets, 4)


def test_the_same_seed_finds_the_same_map(robot: RobotModel) -> None:
    targets = line_from(robot, robot.data.q_home, 2)
    one, two = (traced_map(robot, targets, robot.data.q_home, seeds=4) for _ in range(2))
    np.testing.assert_array_equal(one.q_rad, two.q_rad)


def test_useless_settings_are_refused(robot: RobotModel) -> None:
    targets = line_from(robot, robot.data.q_home, 2)
    with pytest.raises(RobotError, match="seeds = 0"):
        traced_map(robot, targets, robot.data.q_home, seeds=0)
