"""From a vendor's URDF to a robot of ours: a commented TOML and a small URDF beside it."""

from __future__ import annotations

import re
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from moc_opt.commissioning.home import Home, search_home
from moc_opt.commissioning.limits import choose_efforts, choose_limits
from moc_opt.commissioning.shaft import Shaft, find_shaft
from moc_opt.commissioning.toml import robot_toml
from moc_opt.commissioning.vendor import VendorArm, chain_joints, read_vendor
from moc_opt.errors import RobotError
from moc_opt.model.gains import derived_gains
from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.numerics.arrays import Array
from moc_opt.redundancy.freedoms import require_freedom
from moc_opt.robots import urdf
from moc_opt.robots.numbers import as_text

_ROTOR, _SHARE, _MOST_FRICTION = 0.2, 0.008, 1.0


@dataclass(frozen=True, eq=False)
class NewRobot:
    """The files that were written."""

    toml: Path
    urdf: Path
    robot: RobotModel
    home: Home
    notes: tuple[str, ...]
    """Assumptions and changes, one sentence each."""


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
    _check_options(tool_m, wrist_m, lock or {}, base_rpy, seed)
    beside = out.with_suffix(".urdf")
    for file in (out, beside):
        if file.exists():
            raise RobotError(f"{str(file)!r} exists: choose another --out, or move it away")
    arm = read_vendor(source, tip=tip, lock=lock)
    name = out.stem
    arm.root.set("name", name)
    _stand(arm, base_rpy)
    weak = choose_limits(arm)
    shaft = find_shaft(urdf.to_text(arm.root), arm.last_link, wrist_m=wrist_m)
    arm.notes.append(shaft.note)
    with tempfile.TemporaryDirectory(prefix="moc-opt-") as folder:
        draft = _Draft(Path(folder), name, arm, shaft, tool_m)
        robot = draft.load(np.zeros(len(arm.chain)))
        require_freedom(robot)
        if weak:
            robot = draft.load(np.zeros(robot.n), efforts=choose_efforts(robot, weak))
            arm.notes.append(
                f"{', '.join(weak)}: no usable torque limit; three times what gravity asks for is taken; see the data "
                "sheet"
            )
        home = search_home(robot, seed=seed)
        robot = draft.load(home.q)
        toml, text = draft.toml(home, robot), urdf.to_text(arm.root)
    if home.task:
        arm.notes.append(f"home pose: the default task cannot be done from it: {home.task}")
    out.parent.mkdir(parents=True, exist_ok=True)
    note = "".join(f"\n  - {line}" for line in arm.notes).replace("--", "- -")
    beside.write_text(
        text.replace(">\n", f">\n  <!-- Made from {_plain(source.name)}. What was assumed:{note}\n  -->\n", 1),
        encoding="utf-8",
    )
    out.write_text(toml, encoding="utf-8")
    return NewRobot(out, beside, load_robot(out), home, tuple(arm.notes))


def _check_options(
    tool_m: float, wrist_m: float | None, lock: Mapping[str, float], base_rpy: tuple[float, float, float], seed: int
) -> None:
    """Raise RobotError, with the option's name, where a number is none or of no arm's size."""
    if not 1e-3 <= tool_m <= 10.0:
        raise RobotError(f"--tool {tool_m}: give the tool's length, 0.001 to 10 m")
    if wrist_m is not None and not abs(wrist_m) <= 10.0:
        raise RobotError(f"--wrist {wrist_m}: give a distance of at most 10 m")
    if not all(abs(angle) <= 10.0 for angle in base_rpy):
        raise RobotError(f"--base-rpy {base_rpy}: give three angles of at most 10 rad")
    for joint, value in lock.items():
        if not abs(value) <= 1e3:
            raise RobotError(f"--lock {joint}={value}: give a position of at most 1000 rad or m")
    if seed < 0:
        raise RobotError(f"--seed {seed}: give 0 or more")


def _plain(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_. ]+", "-", text)


class _Draft:
    """The two files while their numbers are still being found."""

    def __init__(self, folder: Path, name: str, arm: VendorArm, shaft: Shaft, tool_m: float) -> None:
        self._folder, self._name, self._arm, self._shaft, self._tool_m = folder, name, arm, shaft, tool_m
        self._drives = _drives(arm)

    def load(self, q: Array, efforts: Mapping[str, float] | None = None) -> RobotModel:
        """Return the arm so far, at home at q clipped into its limits."""
        for joint in chain_joints(self._arm):
            if efforts and joint.get("name") in efforts:
                found = urdf.limits(joint)
                urdf.write_limits(
                    joint, found["lower"], found["upper"], found["velocity"], efforts[joint.get("name", "")]
                )
        limits = [urdf.limits(joint) for joint in chain_joints(self._arm)]
        inside = np.clip(q, [k["lower"] for k in limits], [k["upper"] for k in limits])
        self._drives = _drives(self._arm)
        path = self._folder / f"{self._name}.toml"
        path.with_suffix(".urdf").write_text(urdf.to_text(self._arm.root), encoding="utf-8")
        path.write_text(
            robot_toml(self._name, self._arm, self._shaft, self._tool_m, self._drives, inside), encoding="utf-8"
        )
        return load_robot(path)

    def toml(self, home: Home, robot: RobotModel) -> str:
        """Return the finished text, with gains."""
        return robot_toml(
            self._name, self._arm, self._shaft, self._tool_m, self._drives, home.q, home=home,
            gains=derived_gains(robot),
        )  # fmt: skip


def _drives(arm: VendorArm) -> dict[str, list[float]]:
    """Return rotor inertia and friction by the torque limit: ours, as nobody publishes them.

    A turning joint of 10 Nm and more gets the LWR4+'s 0.2 kg m^2, a weaker one less in proportion; friction is 0.8 %
    of the torque limit, at most 1 Nm. A sliding joint's drive is as heavy as 4 % of its force limit says.
    """
    rotors, friction = [], []
    for joint in chain_joints(arm):
        effort = urdf.limits(joint)["effort"]
        sliding = joint.get("type") == "prismatic"
        rotors.append(0.04 * effort if sliding else _ROTOR * min(1.0, effort / 10.0))
        friction.append(_SHARE * effort if sliding else min(_MOST_FRICTION, _SHARE * effort))
    return {
        "rotor_inertia_kg_m2": [float(f"{value:.2g}") for value in rotors],
        "viscous_friction_Nm_s_per_rad": [float(f"{value:.2g}") for value in friction],
        "coulomb_friction_Nm": [float(f"{value:.2g}") for value in friction],
    }


def _stand(arm: VendorArm, rpy: tuple[float, float, float]) -> None:
    """Put the base on a fixed joint that turns it."""
    if not any(rpy):
        return
    carried = {joint.find("child").get("link") for joint in arm.root.findall("joint")}  # type: ignore[union-attr]
    base = next(link.get("name", "") for link in arm.root.findall("link") if link.get("name") not in carried)
    arm.root.insert(0, ET.Element("link", name="stand"))
    joint = ET.SubElement(arm.root, "joint", name="stand_joint", type="fixed")
    ET.SubElement(joint, "parent", link="stand")
    ET.SubElement(joint, "child", link=base)
    ET.SubElement(joint, "origin", xyz="0 0 0", rpy=as_text(*rpy))
    arm.notes.append(f"the base stands turned by {', '.join(f'{a:g}' for a in rpy)} rad about x, y, z")
