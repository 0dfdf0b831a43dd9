"""From a vendor's URDF to a robot of ours: a commented TOML and a small URDF beside it."""

from __future__ import annotations

import re
import tempfile
import textwrap
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
from moc_opt.robots.gains import derived_gains
from moc_opt.robots.home import Home, find_shaft, search_home
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.robots.vendor import VendorArm, enough_efforts, read_vendor


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
    arm, name = read_vendor(source, tip=tip, lock=lock, base_rpy=base_rpy), out.stem
    shaft = find_shaft(arm.urdf.to_text(name), arm.last_link, wrist_m=wrist_m)
    arm.notes.append(shaft.note)

    def write(path: Path, q: Array, note: str = "", **more: Any) -> RobotModel:
        text = arm.urdf.to_text(name).replace(">\n", f">\n{note}", 1)
        write_whole(path.with_suffix(".urdf"), text, "robot file", RobotError)
        toml = _FORM.get_template("new.toml.jinja").render(
            {"home": None, "gains": None, **more}, name=name, notes=arm.notes, last_link=arm.last_link, shaft=shaft,
            tool_m=tool_m, q=q, drives=_drives(arm), slides="prismatic" in {joint.kind for joint in arm.chain},
        )  # fmt: skip
        write_whole(path, toml, "robot file", RobotError)
        return load_robot(path)

    middle = np.array([min(max(0.0, joint.limits["lower"]), joint.limits["upper"]) for joint in arm.chain])
    with tempfile.TemporaryDirectory(prefix="moc-opt-") as folder:
        draft = Path(folder, out.name)
        robot = write(draft, middle)
        require_freedom(robot)
        if arm.weak:
            for joint, effort in zip(arm.chain, enough_efforts(robot), strict=True):
                joint.limits["effort"] = effort if joint.name in arm.weak else joint.limits["effort"]
            weak = ", ".join(arm.weak)
            arm.notes.append(f"{weak}: no usable torque limit: three times what gravity asks for is taken")
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
    for joint in arm.chain:
        effort, sliding = joint.limits["effort"], joint.kind == "prismatic"
        rotors.append(float(f"{0.04 * effort if sliding else 0.2 * min(1.0, effort / 10.0):.2g}"))
        friction.append(float(f"{0.008 * effort if sliding else min(1.0, 0.008 * effort):.2g}"))
    return {
        "rotor_inertia_kg_m2": rotors, "viscous_friction_Nm_s_per_rad": friction, "coulomb_friction_Nm": friction,
    }  # fmt: skip


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
