"""Counting what tip and shaft leave an arm: against the arms whose count is known, and against finite motion."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from moc_opt.errors import RobotError
from moc_opt.planning.self_motion import best_freedoms, freedoms, limit_shares, require_freedom
from moc_opt.robots import loader
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.scenario import Scenario, run

FOLDER = Path(loader.__file__).parent


def tilted(name: str, folder: Path) -> RobotModel:
    """The arm with its tool off the last axis: no joint is idle."""
    text = (FOLDER / f"{name}.toml").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith(("wrist_xyz_m", "tool_mount_"))]
    at = lines.index("[frames]") + 1
    lines[at:at] = ["wrist_xyz_m = [0.05, 0.0, 0.0]", "tool_mount_xyz_m = [0.05, 0.0, 0.0]"]
    (folder / f"{name}.toml").write_text("\n".join(lines), encoding="utf-8")
    (folder / f"{name}.urdf").write_bytes((FOLDER / f"{name}.urdf").read_bytes())
    return load_robot(folder / f"{name}.toml")


def six_joints(folder: Path) -> Path:
    """The LWR4+ without its third joint: an arm as most arms are."""
    urdf = (FOLDER / "lwr4.urdf").read_text(encoding="utf-8")
    urdf = urdf.replace('name="joint_3" type="revolute"', 'name="joint_3" type="fixed"')
    toml = (FOLDER / "lwr4.toml").read_text(encoding="utf-8")
    head = [line for line in toml[: toml.index("[gains.")].splitlines() if not line.startswith(("q_", "v_", "tau_"))]
    lines = [line for line in head if "friction" not in line.split("=")[0]]
    (folder / "six.urdf").write_text(urdf, encoding="utf-8")
    path = folder / "six.toml"
    home = "q_rad = [0.595, -0.89, 1.45, 0.77, -1.22, 0.0]"
    path.write_text("\n".join(lines).replace('"lwr4.urdf"', '"six.urdf"') + f"\n{home}\n", encoding="utf-8")
    return path


def test_counts_of_known_arms(robot: RobotModel, odd_robot: RobotModel, tmp_path: Path) -> None:
    assert best_freedoms(robot)[:3] == (5, 1, (6,))
    assert best_freedoms(load_robot("lwr4_rail"))[:3] == (5, 2, (7,))
    assert best_freedoms(tilted("lwr4", tmp_path))[:3] == (5, 2, ())
    assert best_freedoms(odd_robot).rank == 5


def test_a_straight_arm_loses_rank(robot: RobotModel) -> None:
    at = freedoms(robot, np.zeros(7))
    assert at.rank < 5
    assert at.both == pytest.approx(0.0, abs=1e-9)
    assert best_freedoms(robot).rank == 5


def test_an_arm_without_freedom_is_refused_where_the_third_level_is_asked_for(tmp_path: Path) -> None:
    path = six_joints(tmp_path)
    told = r"of 6 joints the tool's tip and shaft take 5, 1 turn nothing but the tool \(joint_7\)"
    with pytest.raises(RobotError, match=told):
        require_freedom(load_robot(path))
    asked = Scenario(robot={"name": str(path)}, duration_s=0.1, bound_samples=0)
    with pytest.raises(RobotError, match=told):
        run(asked)
    assert run(asked.change(control={"law": "dcac"})).meta["ended"] == "completed"


def test_limit_shares_are_one_in_the_middle_and_zero_at_a_limit(robot: RobotModel) -> None:
    np.testing.assert_allclose(limit_shares(robot, 0.5 * (robot.q_min + robot.q_max)), 1.0)
    np.testing.assert_allclose(limit_shares(robot, robot.q_max), 0.0, atol=1e-12)
    narrow = RobotModel(dataclasses.replace(robot.data, q_min=0.5 * robot.data.q_min, q_home=np.zeros(7)))
    assert limit_shares(narrow, narrow.q_min)[0] == pytest.approx(0.0)
