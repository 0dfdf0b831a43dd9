"""Arms of given joint frames and limits, with invented masses; and short tasks for any arm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from moc_opt.planning.course import Targets, lay_targets
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.tasks import Reference, Trocar, make_path
from tests.conftest import Array

H = np.pi / 2

IIWA14: dict[str, Any] = {
    "joints": [
        ((0, 0, 0.1575), (0, 0, 0)), ((0, 0, 0.2025), (H, 0, np.pi)), ((0, 0.2045, 0), (H, 0, np.pi)),
        ((0, 0, 0.2155), (H, 0, 0)), ((0, 0.1845, 0), (-H, np.pi, 0)), ((0, 0, 0.2155), (H, 0, 0)),
        ((0, 0.081, 0), (-H, np.pi, 0)),
    ],
    "q_max": np.radians([170, 120, 170, 120, 170, 120, 175]),
    "v_max": np.radians([85, 85, 100, 75, 130, 135, 135]),
    "wrist": (0, 0, -0.081), "mount": (0, 0, 0.045), "home": (0.4, 0.8, 0.5, -1.4, 0.6, 1.1, 0.0),
}  # fmt: skip

def _numbers(values: object) -> str:
    return " ".join(f"{value:.17g}" for value in np.asarray(values, dtype=float))


def build(folder: Path, numbers: dict[str, Any], **changes: Any) -> RobotModel:
    """The arm as the loader makes it from two files in the folder."""
    arm = {**numbers, **changes}
    q_max = np.asarray(arm["q_max"])
    q_min = np.asarray(arm.get("q_min", -q_max))
    body = '<inertial><origin xyz="0 0 0.05"/><mass value="2"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" '
    body += 'iyz="0" izz="0.02"/></inertial>'
    text = f'<robot name="arm"><link name="link_0">{body}</link>'
    for j, (xyz, rpy) in enumerate(arm["joints"]):
        text += (
            f'<joint name="joint_{j + 1}" type="revolute"><parent link="link_{j}"/><child link="link_{j + 1}"/>'
            f'<origin xyz="{_numbers(xyz)}" rpy="{_numbers(rpy)}"/><axis xyz="0 0 1"/><limit lower="{q_min[j]:.17g}" '
            f'upper="{q_max[j]:.17g}" velocity="{np.asarray(arm["v_max"])[j]:.17g}" effort="100"/></joint>'
            f'<link name="link_{j + 1}">{body}</link>'
        )
    (folder / "arm.urdf").write_text(text + "</robot>", encoding="utf-8")
    (folder / "arm.toml").write_text(
        f'name = "arm"\nurdf = "arm.urdf"\n[frames]\nlast_link = "link_{len(arm["joints"])}"\n'
        f"wrist_xyz_m = {list(map(float, arm['wrist']))}\n"
        f"tool_mount_xyz_m = {list(map(float, arm['mount']))}\n"
        f"tool_mount_rpy_rad = {list(map(float, arm.get('rpy', (0, 0, 0))))}\n"
        f"[home]\nq_rad = {list(map(float, arm['home']))}\n",
        encoding="utf-8",
    )
    return load_robot(folder / "arm.toml")


def sixteen_joints(folder: Path, home: Array) -> RobotModel:
    """An arm with ten real freedoms."""
    turns = [((0, 0, 0.1), (0, 0, 0)), *[((0, 0, 0.08), (sign * H, 0, 0)) for sign in 7 * (1, -1) + (1,)]]
    return build(folder, {
        "joints": turns, "q_max": np.full(16, 1.8), "v_max": np.full(16, 2.0), "wrist": (0, 0, 0),
        "mount": (0, 0, 0.05), "home": home,
    })  # fmt: skip


def laid(
    robot: RobotModel, q: Array, count: int, duration_s: float, start_s: float, shape: str, **size: float
) -> Targets:  # fmt: skip
    """A path of the tip from a pose on."""
    state = robot.state(q)
    path = make_path(shape, state.tip, normal=(0.0, 0.0, 1.0), heading=(1.0, 0.0, 0.0), **size)
    trocar = Trocar(state.tip - 0.15 * state.tool_direction)
    return lay_targets(Reference(path, 0.05, 0.2, t_start=start_s), trocar, state.tool_span, duration_s, count)


def task(robot: RobotModel, q: Array, count: int) -> Targets:
    """A circle of 5 s from a pose on."""
    return laid(robot, q, count, 5.0, 0.2, "circle", radius=0.03)


def line_from(robot: RobotModel, q: Array, count: int = 4) -> Targets:
    """A short line from a pose on."""
    return laid(robot, q, count, 0.8, 0.0, "line", length=0.02)


def at_poses(robot: RobotModel, poses: Array) -> Targets:
    """Each pose's own tip and wrist as one time."""
    tips, wrists = robot.tool_along(poses)
    return Targets(0.025 * np.arange(len(poses)), tips, wrists, np.zeros(len(poses)))
