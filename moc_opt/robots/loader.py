"""Load a robot's two files, TOML and URDF, as `RobotData`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from moc_opt.arrays import Array, read_only
from moc_opt.errors import MocOptError, RobotError, UnknownNameError
from moc_opt.inputs import names
from moc_opt.inputs.files import as_path, read_text, read_toml
from moc_opt.inputs.settings import Name, Settings
from moc_opt.robots import urdf

Number = Annotated[float, Field(ge=-1e9, le=1e9)]
Vector = tuple[Number, ...]
Coordinate = Annotated[float, Field(ge=-100.0, le=100.0)]
Point = tuple[Coordinate, Coordinate, Coordinate]
NotNegative = Annotated[float, Field(ge=0.0, le=1e9)]
PerJoint = NotNegative | tuple[NotNegative, ...]
Gains = Mapping[str, float | tuple[float, ...]]
_FOLDER = Path(__file__).parent


class _Table(Settings):
    ERROR: ClassVar[type[MocOptError]] = RobotError


class Frames(_Table):
    """Wrist and tool mount in the last link's frame; rpy as in a URDF."""

    KIND: ClassVar[str] = "[frames]"
    last_link: Name
    wrist_xyz_m: Point
    tool_mount_xyz_m: Point = (0.0, 0.0, 0.0)
    tool_mount_rpy_rad: Point = (0.0, 0.0, 0.0)


class Tool(_Table):
    """A round rod from the mount to the tip, along z of the mount."""

    KIND: ClassVar[str] = "[tool]"
    length_m: float = Field(0.30, ge=0.01, le=10)
    mass_kg: float = Field(0.3, ge=0.001, le=1000)
    radius_m: float = Field(0.004, ge=0.0005, le=1)


class Limits(_Table):
    """Limits that replace those of the URDF."""

    KIND: ClassVar[str] = "[limits]"
    q_min_deg: Vector | None = None
    q_max_deg: Vector | None = None
    v_max_deg_per_s: Vector | None = None
    tau_max_Nm: Vector | None = None


class Joints(_Table):
    """Drive properties: one number for all joints, or one per joint."""

    KIND: ClassVar[str] = "[joints]"
    rotor_inertia_kg_m2: PerJoint = 0.2
    viscous_friction_Nm_s_per_rad: PerJoint = 0.0
    coulomb_friction_Nm: PerJoint = 0.0


class Home(_Table):
    """The pose at or near which a run begins [rad, or m for a prismatic joint]."""

    KIND: ClassVar[str] = "[home]"
    q_rad: Vector


class RobotDescription(_Table):
    """The TOML file. The path `urdf` is relative to the folder of the TOML file."""

    KIND: ClassVar[str] = "robot"
    name: Name
    about: Annotated[str, Field(max_length=100, pattern=r"^[ -~]*$")] = ""
    urdf: Annotated[str, Field(min_length=1)]
    frames: Frames
    tool: Tool = Tool()
    limits: Limits = Limits()
    joints: Joints = Joints()
    home: Home
    gains: dict[Name, dict[Name, PerJoint]] = Field({})


@dataclass(frozen=True, eq=False)
class RobotData:
    """A robot with its tool, as plain data in rad, rad/s and Nm (prismatic joints: m, m/s, N).

    Every array is (n,) and read-only.
    """

    name: str
    urdf: str  #: URDF text, with links "tool", "tip" and "wrist".
    joint_names: tuple[str, ...]
    q_min: Array
    q_max: Array
    v_max: Array
    tau_max: Array
    rotor_inertia: Array  #: [kg m^2], added to the diagonal of the inertia matrix.
    viscous_friction: Array  #: [Nm s/rad]
    coulomb_friction: Array  #: [Nm]
    q_home: Array
    wrist_frame: str
    tip_frame: str
    tool_length: float  #: Distance from mount to tip [m].
    tool_mass: float  #: [kg]
    gains: Mapping[str, Gains]  #: The tables [gains.NAME] of the TOML.

    def __post_init__(self) -> None:
        for name in (self.name, *self.joint_names):  # names are written into source code and pages
            if not names.is_name(name):
                raise RobotError(f"robot {self.name!r:.80}: {name!r:.80} is no name: {names.RULE}")
        for name in _ARRAYS:
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.shape != (self.n,) or not np.isfinite(value).all():
                raise RobotError(f"robot {self.name!r}: {name} has shape {value.shape}: give finite (n,) numbers")
            object.__setattr__(self, name, read_only(value))
        object.__setattr__(self, "gains", {name: dict(table) for name, table in self.gains.items()})

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)


_ARRAYS = tuple(field.name for field in fields(RobotData) if field.type == "Array")


def available_robots() -> list[str]:
    """Return the names of the arms in this package."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def about(name_or_path: str | os.PathLike[str]) -> str:
    """Return the description in a robot's TOML. Raises what `load_data` raises."""
    return _described(_find(name_or_path)).about


def load_data(
    name_or_path: str | os.PathLike[str] = "lwr4", *, tool_length: float | None = None, tool_mass: float | None = None
) -> RobotData:
    """Load a robot's data; arguments and errors are those of `moc_opt.load_robot`."""
    path = _find(name_or_path)
    description = _described(path)
    changes = {"length_m": tool_length, "mass_kg": tool_mass}
    tool = description.tool.change(**{key: value for key, value in changes.items() if value is not None})
    arm = urdf.read(read_text(path.parent / description.urdf, "urdf", RobotError))
    for kind, parts in (("link", arm.links), ("joint", arm.joints)):
        if taken := sorted({part.name for part in parts} & urdf.TOOL_NAMES[kind]):
            raise RobotError(f"urdf already has {kind}s named {taken}: rename them, the tool needs these names")
    chain = _chain(arm, description.frames.last_link)
    bounds = _limits(description.limits, chain)
    _append_tool(arm, description.frames, tool)
    n, drives = len(chain), description.joints
    q_home = _vector("home.q_rad", description.home.q_rad, n)
    outside = np.flatnonzero((q_home < bounds["q_min"]) | (q_home > bounds["q_max"]))
    if outside.size:
        joints = (outside + 1).tolist()
        raise RobotError(f"home.q_rad = {q_home.tolist()}: joints {joints} are outside their limits, move them inside")
    return RobotData(
        name=description.name, urdf=arm.to_text(description.name), joint_names=tuple(joint.name for joint in chain),
        **bounds,
        rotor_inertia=_vector("joints.rotor_inertia_kg_m2", drives.rotor_inertia_kg_m2, n),
        viscous_friction=_vector("joints.viscous_friction_Nm_s_per_rad", drives.viscous_friction_Nm_s_per_rad, n),
        coulomb_friction=_vector("joints.coulomb_friction_Nm", drives.coulomb_friction_Nm, n),
        q_home=q_home, wrist_frame=urdf.WRIST_LINK, tip_frame=urdf.TIP_LINK, tool_length=tool.length_m,
        tool_mass=tool.mass_kg, gains=description.gains,
    )  # fmt: skip


def _described(path: Path) -> RobotDescription:
    raw = read_toml(path, "robot file", RobotError)
    try:
        return RobotDescription(**raw)
    except MocOptError as error:
        raise RobotError(f"robot file {str(path)!r}: {error}") from error


def _find(name_or_path: str | os.PathLike[str]) -> Path:
    known = available_robots()
    if isinstance(name_or_path, str) and name_or_path in known:
        return _FOLDER / f"{name_or_path}.toml"
    path = as_path(name_or_path, "robot", RobotError)
    kind = path.suffix.lower()
    if kind == ".toml":
        return path
    if kind != ".urdf":
        raise UnknownNameError("robot (or TOML or URDF file)", str(path), known)
    beside = path.with_suffix(".toml")
    if not beside.is_file():
        raise RobotError(
            f"robot file {str(beside)!r} does not exist: a URDF needs a TOML of the same name in its folder; "
            f"`moc-opt robot new {path.name} --out my.toml` writes my.toml and my.urdf from a vendor's URDF"
        )
    return beside


def _chain(arm: urdf.Urdf, last_link: str) -> list[urdf.Joint]:
    tree = urdf.normalize(arm)
    chain = tree.chain(last_link, "frames.last_link")
    heavy = {last_link, *(link.name for link in arm.links if not link.is_frame)}  # the last link carries the tool
    for joint in filter(lambda joint: joint.moves, arm.joints):
        if joint not in chain:
            raise RobotError(f"urdf joint {joint.name!r} moves but is not between base and last link: make it fixed")
        if not heavy.intersection(tree.reach(joint.child, fixed=True)):
            raise RobotError(f"urdf joint {joint.name!r} moves no mass: give link {joint.child!r} an <inertial>")
    return chain


def _limits(given: Limits, chain: list[urdf.Joint]) -> dict[str, Array]:
    found: dict[str, Array] = {}
    for field, key, entry in (
        ("q_min", "lower", "q_min_deg"), ("q_max", "upper", "q_max_deg"), ("v_max", "velocity", "v_max_deg_per_s"),
        ("tau_max", "effort", "tau_max_Nm"),
    ):  # fmt: skip
        values, degrees = getattr(given, entry), field != "tau_max"
        if values is not None:
            if degrees and any(joint.kind == "prismatic" for joint in chain):
                raise RobotError(f"limits.{entry} is in degrees, but a joint slides: put these limits into the URDF")
            vector = _vector(f"limits.{entry}", values, len(chain))
            found[field] = np.radians(vector) if degrees else vector
            continue
        if lost := [joint.name for joint in chain if key not in joint.limits]:
            raise RobotError(f"{field}: joints {lost} have no {key!r} in their <limit>: add it, or give limits.{entry}")
        found[field] = np.array([joint.limits[key] for joint in chain])
    for joint, low, high, speed, torque in zip(chain, *found.values(), strict=True):
        where = f"of joint {joint.name!r}"
        if low >= high:
            raise RobotError(f"limits {where}: q_min = {low:.6g} is not below q_max = {high:.6g}: give q_min < q_max")
        for field, value in (("v_max", speed), ("tau_max", torque)):
            if value <= 0.0:
                raise RobotError(f"{field} {where} = {value:.6g}: give a positive number, in [limits] or the <limit>")
        joint.limit(low, high, speed, torque)
    return found


def _vector(name: str, values: float | tuple[float, ...], n: int) -> Array:
    if not isinstance(values, tuple):
        values = (values,) * n
    if len(values) != n:
        raise RobotError(f"{name} has {len(values)} entries: the arm has {n} movable joints, give {n}")
    return np.array(values, dtype=np.float64)


def _append_tool(arm: urdf.Urdf, frames: Frames, tool: Tool) -> None:
    mount, wrist, rpy = np.array(frames.tool_mount_xyz_m), np.array(frames.wrist_xyz_m), frames.tool_mount_rpy_rad
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    axis = np.array([cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr])  # z of Rz(yaw) Ry(pitch) Rx(roll)
    along = float(axis @ (mount - wrist))
    off = float(np.linalg.norm(mount - wrist - along * axis))
    m, length, r = tool.mass_kg, tool.length_m, tool.radius_m
    if off > 1e-6 or along + length <= 0:
        raise RobotError(
            f"frames.wrist_xyz_m = {frames.wrist_xyz_m} is {off:.3g} m off the tool's axis or past the tip: "
            "put the wrist on the tool's axis, behind the tip (for example at tool_mount_xyz_m)"
        )
    across, about = m * (3 * r * r + length * length) / 12, m * r * r / 2
    moments = (across, across, about, 0.0, 0.0, 0.0)
    rod = urdf.Link(urdf.TOOL_LINK, m, moments, (0.0, 0.0, length / 2))
    for link, kind, point in (
        (rod, "mount", mount), (urdf.Link(urdf.TIP_LINK), "frame", mount + length * axis),
        (urdf.Link(urdf.WRIST_LINK), "frame", wrist),
    ):  # fmt: skip
        arm.links.append(link)
        name, xyz = f"{link.name}_{kind}", tuple(point.tolist())
        arm.joints.append(urdf.Joint(name, "fixed", frames.last_link, link.name, xyz, rpy))
