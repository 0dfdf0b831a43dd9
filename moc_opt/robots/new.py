"""From a vendor's URDF to a robot of ours: a commented TOML and a small URDF beside it."""

from __future__ import annotations

import re
import tempfile
import textwrap
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from moc_opt.arrays import Array
from moc_opt.errors import RobotError
from moc_opt.inputs.files import check_replaceable, write_whole
from moc_opt.planning.self_motion import require_freedom
from moc_opt.robots import urdf
from moc_opt.robots.gains import derived_gains
from moc_opt.robots.home import Home, find_shaft, search_home
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.robots.urdf import as_text
from moc_opt.robots.vendor import VendorArm, chain_joints, choose_efforts, choose_limits, read_vendor


@dataclass(frozen=True, eq=False)
class NewRobot:
    """The files that were written, and their robot."""

    toml: Path
    urdf: Path
    robot: RobotModel
    home: Home
    notes: tuple[str, ...]  #: Assumptions and changes, one sentence each.


def new_robot(
    source: Path, out: Path, *, tip: str | None = None, tool_m: float = 0.30, wrist_m: float | None = None,
    lock: Mapping[str, float] | None = None, base_rpy: tuple[float, float, float] = (0.0, 0.0, 0.0), seed: int = 0,
) -> NewRobot:  # fmt: skip
    """Write ``out`` (a TOML) and a URDF of the same name beside it.

    Args:
        source: the vendor's URDF; it is only read.
        out: where the TOML goes; both files must not exist yet.
        tip: the link that carries the tool; None: found.
        tool_m: mount to tip [m].
        wrist_m: wrist point to mount along the shaft [m]; None: found.
        lock: joint -> position [rad, m] at which it is fixed.
        base_rpy: how the base stands: (pi, 0, 0) hangs from the ceiling [rad].

    Raises:
        RobotError: a file that cannot be such an arm; no freedom is left; or a file is there already.
    """
    if out.suffix.lower() != ".toml":
        raise RobotError(f"--out {str(out)!r}: give a name that ends in .toml")
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,99}", out.stem):
        raise RobotError(f"--out {out.name!r}: the robot is called like it: give letters, digits, _ and -, then .toml")
    for option, value, least, most in (
        ("tool", tool_m, 1e-3, 10.0), ("wrist", wrist_m or 0.0, 0.0, 10.0), ("seed", seed, 0, 2**63),
        *(("base-rpy", angle, -10.0, 10.0) for angle in base_rpy),
        *((f"lock {joint}", value, -1e3, 1e3) for joint, value in (lock or {}).items()),
    ):  # fmt: skip
        if not least <= value <= most:
            raise RobotError(f"--{option} {value:g}: give a number from {least:g} to {most:g}")
    beside = out.with_suffix(".urdf")
    for file in (out, beside):
        if file.exists():
            raise RobotError(f"{str(file)!r} exists: choose another --out, or move it away")
        check_replaceable(file, "robot file", RobotError)
    arm = read_vendor(source, tip=tip, lock=lock)
    name = out.stem
    arm.root.set("name", name)
    _stand(arm, base_rpy)
    weak = choose_limits(chain_joints(arm), arm.notes)
    shaft = find_shaft(urdf.to_text(arm.root), arm.last_link, wrist_m=wrist_m)
    arm.notes.append(shaft.note)

    def write(path: Path, q: Array, note: str = "", **more: Any) -> RobotModel:
        text = urdf.to_text(arm.root).replace(">\n", f">\n{note}", 1)
        write_whole(path.with_suffix(".urdf"), text, "robot file", RobotError)
        toml = _FORM.get_template("new.toml.jinja").render(
            {"home": None, "gains": None, **more}, name=name, notes=arm.notes, last_link=arm.last_link, shaft=shaft,
            tool_m=tool_m, q=q, drives=_drives(arm), slides="prismatic" in {j.get("type") for j in chain_joints(arm)},
        )  # fmt: skip
        write_whole(path, toml, "robot file", RobotError)
        return load_robot(path)

    limits = [urdf.limits(joint) for joint in chain_joints(arm)]
    middle = np.clip(0.0, [each["lower"] for each in limits], [each["upper"] for each in limits])
    with tempfile.TemporaryDirectory(prefix="moc-opt-") as folder:
        draft = Path(folder, out.name)
        robot = write(draft, middle)
        require_freedom(robot)
        if weak:
            efforts = choose_efforts(robot, weak)
            for joint in chain_joints(arm):
                found = urdf.limits(joint)
                urdf.write_limits(joint, **{**found, "effort": efforts.get(joint.get("name", ""), found["effort"])})
            arm.notes.append(
                f"{', '.join(weak)}: no usable torque limit; three times what gravity asks for is taken; see the data "
                "sheet"
            )
            robot = write(draft, middle)
        home = search_home(robot, seed=seed)
        gains = derived_gains(write(draft, home.q))
    if home.task:
        arm.notes.append(f"home pose: the default task cannot be done from it: {home.task}")
    source_name = re.sub(r"[^A-Za-z0-9_. ]+", "-", source.name)
    told = "".join(f"\n  - {line}" for line in arm.notes).replace("--", "- -")
    note = f"  <!-- Made from {source_name}. What was assumed:{told}\n  -->\n"
    robot = write(out, home.q, note, home=home, gains=gains)
    return NewRobot(out, beside, robot, home, tuple(arm.notes))


def _drives(arm: VendorArm) -> dict[str, list[float]]:
    # Nobody publishes them. A turning joint of 10 Nm and more gets the LWR4+'s rotor of 0.2 kg m^2, a weaker one less
    # in proportion, and friction of 0.8 % of its torque limit, at most 1 Nm; a sliding one 4 % and 0.8 % of its force.
    rotors, friction = [], []
    for joint in chain_joints(arm):
        effort, sliding = urdf.limits(joint)["effort"], joint.get("type") == "prismatic"
        rotors.append(float(f"{0.04 * effort if sliding else 0.2 * min(1.0, effort / 10.0):.2g}"))
        friction.append(float(f"{0.008 * effort if sliding else min(1.0, 0.008 * effort):.2g}"))
    return {
        "rotor_inertia_kg_m2": rotors, "viscous_friction_Nm_s_per_rad": friction, "coulomb_friction_Nm": friction,
    }  # fmt: skip


def _stand(arm: VendorArm, rpy: tuple[float, float, float]) -> None:
    if not any(rpy):
        return
    base = urdf.Tree(arm.root).base
    arm.root.insert(0, ET.Element("link", name="stand"))
    joint = ET.SubElement(arm.root, "joint", name="stand_joint", type="fixed")
    ET.SubElement(joint, "parent", link="stand")
    ET.SubElement(joint, "child", link=base)
    ET.SubElement(joint, "origin", xyz="0 0 0", rpy=as_text(*rpy))
    arm.notes.append(f"the base stands turned by {', '.join(f'{a:g}' for a in rpy)} rad about x, y, z")


def _numbers(values: float | Iterable[float]) -> str:
    if isinstance(values, float):
        return repr(values)
    # Twelve decimals: smaller parts are rounding, and a number below 1e-30 is refused when the file is read.
    return f"[{', '.join(repr(round(float(value), 12) + 0.0) for value in values)}]"


def _comment(note: str) -> str:
    # Control characters of a vendor's names stay out.
    clean = "".join(c if c.isprintable() else " " for c in note)
    return textwrap.fill(clean, 112, initial_indent="# - ", subsequent_indent="#   ")


_FORM = Environment(
    loader=PackageLoader("moc_opt", "robots"), trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    undefined=StrictUndefined,
)  # fmt: skip
_FORM.filters.update(numbers=_numbers, comment=_comment)
