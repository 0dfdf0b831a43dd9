"""A robot as plain values that a trace can carry, so that a run of an arm of one's own replays anywhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from moc_opt.errors import RobotError
from moc_opt.model.robot_model import RobotModel
from moc_opt.robots import RobotData, urdf
from moc_opt.robots.rebuild import rebuild

MOST_JOINTS = 100
_ARRAYS = (
    "q_min", "q_max", "v_max", "tau_max", "rotor_inertia", "viscous_friction", "coulomb_friction", "q_home",
)  # fmt: skip


def carried(robot: RobotModel) -> dict[str, Any]:
    """Return the fields of its `RobotData`, as numbers, texts, lists and tables of them (JSON can hold them)."""
    values: dict[str, Any] = {}
    for field in fields(robot.data):
        value = getattr(robot.data, field.name)
        values[field.name] = value.tolist() if isinstance(value, np.ndarray) else value
    tables = {name: dict(table) for name, table in robot.data.gains.items()}
    return {**values, "joint_names": list(robot.data.joint_names), "gains": tables}


def restored(values: Mapping[str, Any]) -> RobotModel:
    """Make the robot of what `carried` gave; its URDF is read as strictly as one from a file.

    Raises:
        RobotError: a field is missing, unknown or of another kind, or the URDF is no such arm.
    """
    expected = {field.name for field in fields(RobotData)}
    if not isinstance(values, Mapping) or set(values) != expected:
        off = sorted(set(values) ^ expected) if isinstance(values, Mapping) else [type(values).__name__]
        raise RobotError(f"the robot in the trace has other fields than it should: {off[:8]}; save the trace anew")
    names = values["joint_names"]
    if not isinstance(names, list) or not 0 < len(names) <= MOST_JOINTS:
        raise RobotError(f"the robot in the trace has {names!r:.80} for joint_names: give 1 to {MOST_JOINTS} names")
    try:
        arrays = {key: np.array(values[key], dtype=np.float64) for key in _ARRAYS}
        numbers = {key: float(values[key]) for key in ("tool_length", "tool_mass")}
        gains = {name: dict(table) for name, table in dict(values["gains"]).items()}
    except (TypeError, ValueError) as error:
        raise RobotError(f"the robot in the trace: {error}; save the trace anew") from error
    for key, array in arrays.items():
        if array.shape != (len(names),) or not np.isfinite(array).all():
            raise RobotError(f"the robot in the trace: {key} has shape {array.shape}, or is not finite")
    text = urdf.to_text(rebuild(urdf.parse(str(values["urdf"])), str(values["name"])))
    fixed = {key: str(values[key]) for key in ("name", "wrist_frame", "tip_frame")}
    found: dict[str, Any] = {**fixed, **arrays, **numbers, "gains": gains, "urdf": text}
    return RobotModel(RobotData(**found, joint_names=tuple(map(str, names))))
