"""The schema of a robot's TOML file, and its errors with cures."""

from __future__ import annotations

import difflib
import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from moc_opt.errors import RobotError, shown
from moc_opt.inputs.files import read_toml, wrong_size
from moc_opt.inputs.settings import Name, field_name

# Strict: a number of TOML, no text or flag that could be read as one.
Number = Annotated[float, Field(strict=True, ge=-1e9, le=1e9)]
Vector = tuple[Number, ...]
Coordinate = Annotated[float, Field(strict=True, ge=-100.0, le=100.0)]
Point = tuple[Coordinate, Coordinate, Coordinate]
PerJoint = Number | Vector
_QUOTED = re.compile(r"\s*[+-]?[\d.]+(e[+-]?\d+)?\s*", re.IGNORECASE)


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=False)

    @field_validator("*", mode="after")
    @classmethod
    def _of_a_usable_size(cls, value: Any) -> Any:
        if wrong := wrong_size(value):
            raise ValueError(wrong)
        return value


class Frames(_Table):
    """Where wrist and tool sit on the last link; xyz in m, rpy in rad (URDF's fixed-axis order)."""

    last_link: Name
    wrist_xyz_m: Point
    tool_mount_xyz_m: Point = (0.0, 0.0, 0.0)
    tool_mount_rpy_rad: Point = (0.0, 0.0, 0.0)


class Tool(_Table):
    """A straight round rod from the mount to the tip, along z of the mount."""

    length_m: Annotated[float, Field(strict=True, gt=0, le=10)] = 0.30
    mass_kg: Annotated[float, Field(strict=True, gt=0, le=1000)] = 0.3
    radius_m: Annotated[float, Field(strict=True, gt=0, le=1)] = 0.004


class Limits(_Table):
    """Joint limits that replace those of the URDF; degrees, so for revolute joints only."""

    q_min_deg: Vector | None = None
    q_max_deg: Vector | None = None
    v_max_deg_per_s: Vector | None = None
    tau_max_Nm: Vector | None = None


class Joints(_Table):
    """Drive properties a URDF has no place for: one number for all joints, or one per joint."""

    rotor_inertia_kg_m2: PerJoint = 0.2
    viscous_friction_Nm_s_per_rad: PerJoint = 0.0
    coulomb_friction_Nm: PerJoint = 0.0


class Home(_Table):
    """The pose a run begins near; rad (m for a prismatic joint)."""

    q_rad: Vector


class RobotDescription(_Table):
    """The whole TOML file; `urdf` is relative to the file itself, and `about` says what the arm is."""

    name: Name
    about: Annotated[str, Field(max_length=100, pattern=r"^[ -~]*$")] = ""
    urdf: Annotated[str, Field(min_length=1)]
    frames: Frames
    tool: Tool = Tool()
    limits: Limits = Limits()
    joints: Joints = Joints()
    home: Home
    gains: dict[Name, dict[Name, Number | Vector]] = {}


def read_description(path: Path) -> RobotDescription:
    """Read and validate a robot's TOML file.

    Raises:
        RobotError: unreadable file, bad TOML, a missing, unknown or wrong entry (all of them are named).
    """
    raw = read_toml(path, "robot file", RobotError)
    try:
        return RobotDescription.model_validate(raw)
    except ValidationError as error:
        lines = "; ".join(_explain(dict(item)) for item in error.errors())
        raise RobotError(f"robot file {str(path)!r}: {lines}") from error


def _explain(item: dict[str, Any]) -> str:
    loc: tuple[Any, ...] = item["loc"]
    field = field_name(loc)
    if item["type"] == "extra_forbidden":
        valid = _keys_of_table(loc[:-1])
        near = difflib.get_close_matches(str(loc[-1])[:100], valid, n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(map(repr, near))}? " if near else ""
        return f"unknown key {field!r}: {hint}valid keys: {', '.join(valid)}"
    if item["type"] == "missing":
        return f"{field} is missing: add it"
    quoted = item["type"] == "float_type" and isinstance(item["input"], str) and _QUOTED.fullmatch(item["input"])
    return f"{field} = {shown(item['input'])}: {'a number has no quotes: drop them' if quoted else item['msg']}"


def _keys_of_table(loc: tuple[Any, ...]) -> list[str]:
    """Return the valid keys of the table at this place in the schema."""
    table: type[BaseModel] = RobotDescription
    for key in loc:
        annotation = table.model_fields[str(key)].annotation
        if not (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
            break
        table = annotation
    return sorted(table.model_fields)
