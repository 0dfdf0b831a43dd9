"""From a robot's name or files to RobotData: checked numbers and one complete URDF text."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import partial
from numbers import Real
from pathlib import Path
from types import MappingProxyType
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from moc_opt.errors import RobotError, UnknownNameError
from moc_opt.inputs import names
from moc_opt.inputs.files import as_path, read_text
from moc_opt.numerics.arrays import Array
from moc_opt.robots import urdf
from moc_opt.robots.description import RobotDescription, Tool, read_description
from moc_opt.robots.rebuild import rebuild

Gains = Mapping[str, float | tuple[float, ...]]
_FOLDER = Path(__file__).parent


@dataclass(frozen=True, eq=False)
class RobotData:
    """A robot with its tool, as plain data; every array is (n,) and read-only.

    Joint quantities are in rad, rad/s and Nm (m, m/s and N for a prismatic joint).
    """

    name: str
    urdf: str
    """The complete URDF text, links "tool", "tip" and "wrist" included."""
    joint_names: tuple[str, ...]
    q_min: Array
    q_max: Array
    v_max: Array
    tau_max: Array
    rotor_inertia: Array
    """Reflected rotor inertia, added to the diagonal of M [kg m^2]; not in the URDF text."""
    viscous_friction: Array
    """[Nm s/rad]"""
    coulomb_friction: Array
    """[Nm]"""
    q_home: Array
    wrist_frame: str
    tip_frame: str
    tool_length: float
    """Mount to tip [m]."""
    tool_mass: float
    """[kg]"""
    gains: Mapping[str, Gains]
    """The raw [gains.*] tables, one for each controller."""

    def __post_init__(self) -> None:
        for name in (self.name, *self.joint_names, self.wrist_frame, self.tip_frame):
            if not names.is_name(name):  # they go into generated sources and pages
                raise RobotError(f"robot {self.name!r:.80}: {name!r:.80} is no name: {names.RULE}")
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value = np.array(value, dtype=np.float64)
                value.flags.writeable = False
                object.__setattr__(self, field.name, value)
        frozen = {key: MappingProxyType(dict(table)) for key, table in self.gains.items()}
        object.__setattr__(self, "gains", MappingProxyType(frozen))

    def __reduce__(self) -> tuple[Any, ...]:
        # Mapping proxies cannot be pickled, and unpickled arrays would be writable: build it anew.
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        values["gains"] = {key: dict(table) for key, table in self.gains.items()}
        return partial(RobotData, **values), ()

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)


def available_robots() -> list[str]:
    """List the names that `load_data` knows without a path."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def about(name_or_path: str | os.PathLike[str]) -> str:
    """Return the robot's description in its TOML; empty if there is none. Errors as of `load_data`."""
    return read_description(_find(name_or_path)).about


def load_data(
    name_or_path: str | os.PathLike[str] = "lwr4", *, tool_length: float | None = None, tool_mass: float | None = None
) -> RobotData:
    """Load a robot by name, from a TOML file (which names its URDF), or from a URDF with a TOML beside it.

    Args:
        name_or_path: one of `available_robots()`, or a path ending in .toml or .urdf.
        tool_length: mount to tip [m]; overrides the TOML.
        tool_mass: [kg]; overrides the TOML.

    Raises:
        UnknownNameError: no robot of that name.
        RobotError: a file is missing, or an entry is missing, unknown or inconsistent.
    """
    description_path = _find(name_or_path)
    description = read_description(description_path)
    tool = _tool(description.tool, tool_length, tool_mass)
    urdf_path = description_path.parent / description.urdf
    given = urdf.parse(read_text(urdf_path, "urdf", RobotError))
    urdf.check_names_free(given)
    root = rebuild(given, description.name)
    chain = urdf.moving_joints(root, description.frames.last_link)
    bounds = _limits(description, chain)
    for joint, *values in zip(chain, *bounds.values(), strict=True):
        urdf.write_limits(joint, *values)
    urdf.append_tool(root, description.frames, tool)
    urdf.check_masses(root, chain)
    n, drives = len(chain), description.joints
    q_home = _vector("home.q_rad", description.home.q_rad, n)
    outside = np.flatnonzero((q_home < bounds["q_min"]) | (q_home > bounds["q_max"]))
    if outside.size:
        raise RobotError(
            f"home.q_rad = {q_home.tolist()}: joints {(outside + 1).tolist()} are outside their limits, "
            "move them inside"
        )
    return RobotData(
        name=description.name,
        urdf=urdf.to_text(root),
        joint_names=tuple(joint.get("name", "") for joint in chain),
        **bounds,
        rotor_inertia=_drive("rotor_inertia_kg_m2", drives.rotor_inertia_kg_m2, n),
        viscous_friction=_drive("viscous_friction_Nm_s_per_rad", drives.viscous_friction_Nm_s_per_rad, n),
        coulomb_friction=_drive("coulomb_friction_Nm", drives.coulomb_friction_Nm, n),
        q_home=q_home,
        wrist_frame=urdf.WRIST_LINK,
        tip_frame=urdf.TIP_LINK,
        tool_length=tool.length_m,
        tool_mass=tool.mass_kg,
        gains=description.gains,
    )


def _find(name_or_path: str | os.PathLike[str]) -> Path:
    """Return the TOML file meant."""
    known = available_robots()
    if isinstance(name_or_path, str) and name_or_path in known:
        return _FOLDER / f"{name_or_path}.toml"
    path = as_path(name_or_path, "robot", RobotError)
    if path.suffix.lower() == ".urdf":
        beside = path.with_suffix(".toml")
        if not beside.is_file():
            raise RobotError(
                f"robot file {str(beside)!r} does not exist: a URDF needs a TOML of the same name beside it"
            )
        return beside
    if path.suffix.lower() == ".toml":
        return path
    if isinstance(name_or_path, str) and os.sep not in name_or_path:
        error = UnknownNameError("robot", name_or_path, known)
        error.args = (f"{error}; or give the path of a robot's TOML or URDF file",)
        raise error
    raise RobotError(
        f"robot file {str(path)!r} is neither .toml nor .urdf: give such a path, or one of {', '.join(known)}"
    )


def _tool(default: Tool, length: float | None, mass: float | None) -> Tool:
    changes: dict[str, float] = {}
    for field, name, value, most in (("length_m", "tool_length", length, 10.0), ("mass_kg", "tool_mass", mass, 1e3)):
        if value is None:
            continue
        if not (isinstance(value, Real) and 0 < value <= most):  # as in the file
            raise RobotError(f"{name} = {value!r}: give a positive, finite number of at most {most:g}")
        changes[field] = float(value)
    return default.model_copy(update=changes)


def _limits(description: RobotDescription, chain: list[Element]) -> dict[str, Array]:
    """Return limits of the TOML where given, else of the URDF; complete, finite and in order."""
    n, given = len(chain), description.limits
    sources = {
        "q_min": ("lower", "q_min_deg", given.q_min_deg),
        "q_max": ("upper", "q_max_deg", given.q_max_deg),
        "v_max": ("velocity", "v_max_deg_per_s", given.v_max_deg_per_s),
        "tau_max": ("effort", "tau_max_Nm", given.tau_max_Nm),
    }
    out: dict[str, Array] = {}
    for field, (key, entry, values) in sources.items():
        if values is not None:
            if entry.startswith(("q_", "v_")) and any(joint.get("type") == "prismatic" for joint in chain):
                raise RobotError(
                    f"limits.{entry} is in degrees, but a joint is prismatic: put its limits into the URDF"
                )
            vector = _vector(f"limits.{entry}", values, n)
            out[field] = vector if entry.endswith("Nm") else np.radians(vector)
            continue
        found = [urdf.limits(joint).get(key) for joint in chain]
        lost = [joint.get("name") for joint, value in zip(chain, found, strict=True) if value is None]
        if lost:
            raise RobotError(f"{field}: joints {lost} have no {key!r} in their <limit>: add it, or limits.{entry}")
        out[field] = np.array(found, dtype=np.float64)
    if np.any(out["q_min"] >= out["q_max"]):
        i = int(np.argmax(out["q_min"] >= out["q_max"]))
        raise RobotError(
            f"limits of joint {chain[i].get('name')!r}: q_min = {out['q_min'][i]:.6g} is not below "
            f"q_max = {out['q_max'][i]:.6g} rad: exchange or widen them"
        )
    for field in ("v_max", "tau_max"):
        if np.any(out[field] <= 0):
            i = int(np.argmax(out[field] <= 0))
            raise RobotError(
                f"{field} of joint {chain[i].get('name')!r} = {out[field][i]:.6g}: give a positive number, "
                f"in the URDF's <limit> or as limits.{sources[field][1]}"
            )
    return out


def _vector(name: str, values: tuple[float, ...], n: int) -> Array:
    if len(values) != n:
        raise RobotError(f"{name} has {len(values)} entries: the arm has {n} movable joints, give {n}")
    return np.array(values, dtype=np.float64)


def _drive(name: str, values: float | tuple[float, ...], n: int) -> Array:
    vector = _vector(f"joints.{name}", values if isinstance(values, tuple) else (values,) * n, n)
    if np.any(vector < 0):
        raise RobotError(f"joints.{name} = {vector.tolist()}: give zero or more")
    return vector
