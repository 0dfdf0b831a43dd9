"""Arms and short paths for tests."""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from moc_opt.inputs.files import to_toml
from moc_opt.planning.course import Targets, lay_targets
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.robots.urdf import Joint, Link, Urdf, read
from moc_opt.tasks import Reference, Trocar, make_path
from tests.conftest import Array
from tests.robots.arms import FOLDER

H = np.pi / 2

_JOINTS = [joint for joint in read((FOLDER / "iiwa14.urdf").read_text("utf-8")).joints if joint.moves]
IIWA14: dict[str, Any] = {
    "joints": [(joint.xyz, joint.rpy) for joint in _JOINTS],
    "q_max": np.radians([170, 120, 170, 120, 170, 120, 175]), "v_max": np.radians([85, 85, 100, 75, 130, 135, 135]),
    "wrist": (0, 0, -0.081), "mount": (0, 0, 0.045), "home": (0.4, 0.8, 0.5, -1.4, 0.6, 1.1, 0.0),
}  # fmt: skip


def build(folder: Path, numbers: dict[str, Any], **changes: Any) -> RobotModel:
    arm = {"rpy": (0.0, 0.0, 0.0), "q_min": -np.asarray(numbers["q_max"]), **numbers, **changes}
    count = len(arm["joints"])
    links = [Link(f"link_{j}", 2.0, (0.02, 0.02, 0.02, 0.0, 0.0, 0.0), (0.0, 0.0, 0.05)) for j in range(count + 1)]
    joints = []
    for j, (xyz, rpy) in enumerate(arm["joints"]):
        limits = {"lower": arm["q_min"][j], "upper": arm["q_max"][j], "velocity": arm["v_max"][j], "effort": 100.0}
        ends = f"link_{j}", f"link_{j + 1}"
        kind = "prismatic" if j in arm.get("slides", ()) else "revolute"
        joints.append(Joint(f"joint_{j + 1}", kind, *ends, xyz, rpy, (0.0, 0.0, 1.0), limits))
    (folder / "arm.urdf").write_text(Urdf(links, joints).to_text("arm"), encoding="utf-8")
    frames = {"wrist_xyz_m": arm["wrist"], "tool_mount_xyz_m": arm["mount"], "tool_mount_rpy_rad": arm["rpy"]}
    (folder / "arm.toml").write_text(to_toml({
        "name": "arm", "urdf": "arm.urdf", "frames": {"last_link": f"link_{count}", **frames},
        "home": {"q_rad": np.asarray(arm["home"], dtype=float)},
    }), encoding="utf-8")  # fmt: skip
    return load_robot(folder / "arm.toml")


def turned(folder: Path) -> RobotModel:
    """The iiwa14 on a low, tilted base, with other joint zeros, limits and axis directions."""
    back, joints = pin.exp3(np.array([0.2, -0.1, 0.3])), []
    for j, (xyz, rpy) in enumerate(IIWA14["joints"]):
        turn = pin.exp3(np.array([np.pi, 0.0, 0.0]) if j in (2, 4, 6) else np.array([0.0, 0.0, 0.2 * j - 0.5]))
        rotation = back @ pin.rpy.rpyToMatrix(*rpy) @ turn
        joints.append((tuple(back @ xyz if j else (0.5, 0.2, -2.0)), tuple(pin.rpy.matrixToRpy(rotation))))
        back = turn.T if j in (2, 4) else np.eye(3)
    return build(folder, IIWA14, joints=joints, q_min=0.2 - IIWA14["q_max"], wrist=(0.0, 0.0, 0.081),
                 mount=(0.0, 0.0, -0.045), rpy=(np.pi, 0.0, 0.0))  # fmt: skip


def sixteen_joints(folder: Path, home: Array) -> RobotModel:
    """An arm with ten freedoms of self-motion, not counting joint 16, which only turns the tool about its own axis."""
    turns = [((0, 0, 0.1), (0, 0, 0)), *[((0, 0, 0.08), (sign * H, 0, 0)) for sign in 7 * (1, -1) + (1,)]]
    frames = {"wrist": (0, 0, 0), "mount": (0, 0, 0.05), "home": home}
    return build(folder, {"joints": turns, "q_max": np.full(16, 1.8), "v_max": np.full(16, 2.0), **frames})


def laid(robot: RobotModel, q: Array, count: int, end_s: float, start_s: float, shape: str, **size: float) -> Targets:
    state = robot.state(q)
    path = make_path(shape, state.tip, normal=(0.0, 0.0, 1.0), heading=(1.0, 0.0, 0.0), **size)
    trocar = Trocar(state.tip - 0.15 * state.tool_direction)
    return lay_targets(Reference(path, 0.05, 0.2, t_start=start_s), trocar, state.tool_span, end_s, count)


def task(robot: RobotModel, q: Array, count: int) -> Targets:
    return laid(robot, q, count, 5.0, 0.2, "circle", radius=0.03)


def line_from(robot: RobotModel, q: Array, count: int = 4) -> Targets:
    return laid(robot, q, count, 0.8, 0.0, "line", length=0.02)


def at_poses(robot: RobotModel, poses: Array) -> Targets:
    tips, wrists = robot.tool_along(poses)
    return Targets(0.025 * np.arange(len(poses)), tips, wrists, np.zeros(len(poses)))
