"""Make one serial arm of a vendor's URDF; everything that had to be assumed or changed is noted."""

from __future__ import annotations

import copy
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin

from moc_opt.errors import RobotError, UnknownNameError
from moc_opt.inputs.files import read_text
from moc_opt.robots import urdf
from moc_opt.robots.model import RobotModel
from moc_opt.robots.urdf import MOVING, as_text, end, triple

FINGERS = 2  #: Moving joints in a row that a branch may have to count as a finger.
ARM = 5  #: Moving joints in a row that a chain must have to be an arm.
FASTEST = {"turning": 2.0 * math.pi, "sliding": 2.0}
"""Joint speeds above it are no arm's [rad/s, m/s]: a public file of the iiwa says 10 rad/s, its maker 1.5 to 2.4."""
CHOSEN = {"turning": 2.0, "sliding": 0.5}  #: The speed that is taken in place of a missing or absurd one.
TRAVEL_M = 0.5  #: Range of a sliding joint without limits, to both sides [m].
_STRONGEST = {"turning": 2000.0, "sliding": 20000.0}  # Nm, N
_UNITS = {"turning": ("rad", "rad/s"), "sliding": ("m", "m/s")}
_DEGREES = 40.0  # a range [rad] beyond it is one of degrees: six turns are the most that an arm's joint has
_LARGEST = 1e5  # rad, rad/s, Nm, m, m/s and N
_FLANGES = ("tool0", "flange", "link8", "end_effector", "link_ee", "ee_link", "eef")
_JAW = re.compile("grip|finger|jaw", re.IGNORECASE)
_RESERVED = {"tool", "tip", "wrist", "tool_mount", "tip_frame", "wrist_frame", "world"}
_KEPT = {"link": ("inertial",), "joint": ("parent", "child", "origin", "axis", "limit")}
_PREFIX = re.compile(r"(?:</?|\s)([A-Za-z_][\w.-]*):[A-Za-z_]")
_QUOTED = re.compile(r'"[^"]*"|\'[^\']*\'')


@dataclass
class VendorArm:
    """One serial arm: links and joints alone, side joints fixed."""

    root: ET.Element
    last_link: str
    chain: list[str] = field(default_factory=list)  #: The moving joints from base to last link.
    notes: list[str] = field(default_factory=list)  #: Assumptions and changes, one sentence each.


def read_vendor(path: Path, *, tip: str | None = None, lock: Mapping[str, float] | None = None) -> VendorArm:
    """Read a URDF and make it a serial arm; limits are left to `choose_limits`.

    Side joints (fingers, a second arm, a head) and those named in ``lock`` are fixed; masses that no body has are
    replaced; meshes are not looked at.

    Args:
        tip: the link that carries the tool; None: the end of the one chain there is, before the fingers.
        lock: joint -> the position [rad, m] at which it is fixed.

    Raises:
        RobotError: no URDF, xacro that is not expanded, no single chain, a mimic joint in the chain.
        UnknownNameError: ``tip`` or a joint of ``lock`` is not in the file.
    """
    text, undeclared = _declared(read_text(path, "urdf", RobotError))
    given = urdf.parse(text)
    parts = [part for kind in _KEPT for element in given.findall(kind) for part in element.iter()]
    if any("xacro" in str(e.tag) for e in given) or any("${" in v for part in parts for v in part.attrib.values()):
        raise RobotError(f"urdf {str(path)!r} is a xacro file: expand it first (xacro {path.name} > arm.urdf)")
    mimics = {joint.get("name", "") for joint in given.findall("joint[mimic]")}
    arm = VendorArm(_bare(given), "")
    if undeclared:
        arm.notes.append(f"names with {', '.join(undeclared)} are not read: the file does not say what they are")
    _rename(arm)
    _drop_endless_limits(arm)
    locked = dict(lock or {})
    moving = [joint.get("name", "") for joint in arm.root.findall("joint") if joint.get("type") in MOVING]
    for name in locked:
        if name not in moving:
            raise UnknownNameError("joint (--lock)", name, moving)
    tree = _Tree(arm.root, locked)
    if tip is not None and tip not in tree.links:
        raise UnknownNameError("link (--tip)", tip, tree.links)
    arm.last_link = tip or _last_link(tree, arm.notes)
    on_path = tree.path(arm.last_link)
    for joint in on_path:
        name = joint.get("name", "")
        if tree.moves(joint) and name in mimics:
            raise RobotError(
                f"urdf joint {name!r} lies between base and last link and mimics another: it cannot be driven by "
                "itself; fix it with --lock, or choose another --tip"
            )
    chain = [joint for joint in on_path if tree.moves(joint)]
    if not chain:
        raise RobotError(f"urdf: no moving joint lies between the base and {arm.last_link!r}: choose another --tip")
    for joint in on_path[on_path.index(chain[0]) :]:
        if joint.get("type") not in MOVING | {"fixed"}:
            raise RobotError(
                f"urdf joint {joint.get('name')!r} lies between two joints of the arm and is {joint.get('type')}: no "
                "drive moves it so; make it revolute, prismatic or fixed, or choose another --tip"
            )
    arm.chain = [joint.get("name", "") for joint in chain]
    carried = tree.reach(end(chain[-1], "child"))
    masses = {link.get("name"): _size(link.find("inertial/mass"), "value") for link in arm.root.findall("link")}
    if max(masses[link] for link in carried) < urdf.SMALLEST_MASS:
        arm.notes.append(
            f"{', '.join(carried)}: what {arm.chain[-1]} carries has no mass, so it moves the tool alone; see the data "
            "sheet for the mass of the flange"
        )
    _prune(arm, tree, chain[0])
    mend_bodies(arm.root, arm.notes)
    _fix_others(arm, locked)
    arm.root = urdf.rebuild(arm.root, arm.root.get("name") or "arm")
    return arm


def chain_joints(arm: VendorArm) -> list[ET.Element]:
    """Return the chain's joints of the clean tree, base first."""
    by_name = {joint.get("name", ""): joint for joint in arm.root.findall("joint")}
    return [by_name[name] for name in arm.chain]


def _declared(text: str) -> tuple[str, list[str]]:
    # Some vendors' files use prefixes that they never declare, which no XML reader takes.
    used = {name for tag in re.findall(r"<[^!?][^>]*>", text) for name in _PREFIX.findall(_QUOTED.sub("", tag))}
    missing = sorted(name for name in used - {"xml", "xmlns"} if f"xmlns:{name}=" not in text.replace(" ", ""))
    told = "".join(f' xmlns:{name}="{name}"' for name in missing)
    return re.sub(r"<robot\b", f"<robot{told}", text, count=1), [f"{name}:" for name in missing]


def _bare(given: ET.Element) -> ET.Element:
    made = ET.Element("robot", name=given.get("name", ""))
    for element in given:
        if element.tag in _KEPT:
            kept = ET.SubElement(made, str(element.tag), element.attrib)
            kept.extend(copy.deepcopy(child) for child in element if child.tag in _KEPT[str(element.tag)])
    return made


def _rename(arm: VendorArm) -> None:
    for element in arm.root:
        old, kind = element.get("name", ""), str(element.tag)
        if old in _RESERVED:
            element.set("name", f"{old}_{kind}")
            arm.notes.append(f"{kind} {old!r} is called {old + '_' + kind!r} here: the name is taken")
            for place in arm.root.iterfind(f"joint/*[@link='{old}']") if kind == "link" else ():
                place.set("link", f"{old}_{kind}")


def _drop_endless_limits(arm: VendorArm) -> None:
    for joint in arm.root.findall("joint"):
        for limit in joint.findall("limit"):
            endless = [key for key in limit.attrib if _size(limit, key) > _LARGEST]
            if endless:
                told = ", ".join(f"{key} = {limit.get(key)}" for key in endless)
                arm.notes.append(f"{joint.get('name')}: {told} is no limit, and is taken for none")
            for key in {"lower", "upper", *endless} if {"lower", "upper"} & set(endless) else endless:
                limit.attrib.pop(key, None)


def _size(element: ET.Element | None, key: str) -> float:
    try:
        return 0.0 if element is None else abs(float(element.get(key, "")))
    except ValueError:
        return 0.0  # refused later, by name


def _prune(arm: VendorArm, tree: _Tree, first: ET.Element) -> None:
    below = tree.path(end(first, "parent"))
    links = [tree.base, *(end(joint, "child") for joint in below), *tree.reach(end(first, "child"))]
    joints = {first, *below, *(joint for link in tree.reach(end(first, "child")) for joint in tree.carried[link])}
    dropped = [e for e in arm.root if (e not in joints if e.tag == "joint" else e.get("name") not in links)]
    for element in dropped:
        arm.root.remove(element)
    if count := sum(element.tag == "link" for element in dropped):
        arm.notes.append(f"{count} links that hang on the base beside the arm are left out")


def _fix_others(arm: VendorArm, locked: Mapping[str, float]) -> None:
    fixed = []
    for joint in arm.root.findall("joint"):
        name, kind = joint.get("name", ""), joint.get("type")
        if name in arm.chain or kind == "fixed":
            continue
        if kind in MOVING:
            found = urdf.limits(joint) if kind != "continuous" else {}
            nearest = min(max(0.0, found.get("lower", -_LARGEST)), found.get("upper", _LARGEST))
            value = locked.get(name, nearest)
            _shift(joint, value)
            fixed.append(f"{name} at {value:.3g} {'m' if kind == 'prismatic' else 'rad'}")
        else:
            fixed.append(f"{name} ({kind})")
        joint.set("type", "fixed")
    if fixed:
        arm.notes.append(f"fixed, for they are not of the chain: {', '.join(fixed)}")


def _shift(joint: ET.Element, value: float) -> None:
    if value == 0.0:
        return
    where, origin, given = f"joint {joint.get('name')!r}", joint.find("origin"), joint.find("axis")
    R, place = pin.rpy.rpyToMatrix(*triple(origin, "rpy", where, "rad")), np.array(triple(origin, "xyz", where, "m"))
    axis = np.array(triple(given, "xyz", where, "1") if given is not None else (1.0, 0.0, 0.0))
    motion = value * axis / np.linalg.norm(axis)
    if joint.get("type") == "prismatic":
        place = place + R @ motion
    else:
        R = R @ pin.exp3(motion)
    origin = ET.SubElement(joint, "origin") if origin is None else origin
    origin.set("xyz", as_text(*place))
    origin.set("rpy", as_text(*pin.rpy.matrixToRpy(R)))


class _Tree(urdf.Tree):
    """A tree of links in which some joints are locked."""

    def __init__(self, root: ET.Element, locked: Mapping[str, float]) -> None:
        super().__init__(root)
        self.locked = locked

    def moves(self, joint: ET.Element) -> bool:
        return joint.get("type") in MOVING and joint.get("name") not in self.locked

    def depth(self, link: str) -> int:
        """Count the most moving joints in a row that hang on this link."""
        return max((self.moves(j) + self.depth(end(j, "child")) for j in self.carried[link]), default=0)

    def arms(self) -> list[str]:
        """Links that end a chain of `ARM` moving joints, longest first; branches shorter than that are fingers."""
        found: list[tuple[int, str]] = []
        waiting = [(self.base, 0)]
        while waiting:
            link, count = waiting.pop()
            ways = [(end(j, "child"), count + self.moves(j)) for j in self.carried[link]]
            on = [way for way in ways if way[1] > count or self.depth(way[0])]
            longest = max((n - count + self.depth(child) for child, n in on), default=0)
            if on and (len(on) == 1 or longest >= ARM or count < ARM):
                waiting += on
            elif count >= ARM:
                found.append((count, link))
        return [link for _, link in sorted(found, key=lambda each: (-each[0], each[1]))]


def _last_link(tree: _Tree, notes: list[str]) -> str:
    link, joints = tree.base, 0
    while branches := [j for j in tree.carried[link] if tree.moves(j) or tree.depth(end(j, "child"))]:
        if len(branches) > 1:
            long = [j for j in branches if tree.moves(j) + tree.depth(end(j, "child")) > FINGERS]
            if not long and joints >= FINGERS:
                notes.append(f"the chain ends at {link!r}, where {len(branches)} fingers branch off")
                return link
            if len(long) != 1:
                ends, arms = [end(j, "child") for j in (long or branches)], tree.arms()[:8]
                raise RobotError(
                    f"urdf: {len(ends)} chains leave link {link!r}, towards {ends[:6]}: say with --tip which link "
                    f"carries the tool{f', such as {arms}' if arms else ''}"
                )
            branches = long
        joints += tree.moves(branches[0])
        link = end(branches[0], "child")
    last = next((j for j in reversed(tree.path(link)) if tree.moves(j)), None)
    if last is not None and joints > 1 and _JAW.search(f"{last.get('name')} {end(last, 'child')}"):
        link = end(last, "parent")
        notes.append(f"{last.get('name')!r} is taken for the jaw of a gripper: the chain ends before it, at {link!r}")
        return link
    # Behind the last moving joint only frames are left: the flange is the one that is named so, else the link itself.
    flange = next((found for word in _FLANGES for found in tree.reach(link) if found.endswith(word)), None)
    how = "the flange by its name" if flange else "carried by the last moving joint"
    notes.append(f"last link: {flange or link!r}, {how}")
    return flange or link


# --- numbers that no arm has ---


def mend_bodies(root: ET.Element, notes: list[str]) -> None:
    """Make every <inertial> one that a body can have, in place; each change is noted.

    A link without mass is a frame, and merged into the link it is fixed to. One without inertia gets that of a ball of
    its mass, as dense as water. To an inertia that no body has, the smallest ball's is added that makes it possible.
    """
    frames = []
    for link in root.findall("link[inertial]"):
        name, inertial = link.get("name", ""), link.find("inertial")
        assert inertial is not None
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        kilograms = 0.0 if mass is None else urdf.number(mass.get("value", ""), f"mass of link {name!r}", "kg")
        if 0.0 <= kilograms < urdf.SMALLEST_MASS:
            link.remove(inertial)
            frames.append(name)
            continue
        given = {} if inertia is None else inertia.attrib
        what = f"inertia of link {name!r}"
        moments = [urdf.number(given.get(key, "0"), what, "kg m^2") for key in urdf.MOMENTS]
        fault = urdf.inertia_fault(moments)
        if fault is None:
            continue
        if max(map(abs, moments)) < urdf.SMALLEST_MOMENT:
            radius = (3.0 * kilograms / (4.0 * math.pi * 1000.0)) ** (1.0 / 3.0)
            added = max(0.4 * kilograms * radius**2, 10.0 * urdf.SMALLEST_MOMENT)
            notes.append(f"link {name!r} ({kilograms:.3g} kg) has no inertia: that of a ball of water is taken")
        else:
            least, middle, most = urdf.principal(moments)
            lacking = max(most - least - middle, 1e-3 * most - least, 10.0 * urdf.SMALLEST_MOMENT - least)
            added = lacking * (1.0 + 1e-6) + 1e-12
            notes.append(f"link {name!r} has an inertia that no body has, {fault}: {added:.3g} kg m^2 is added")
        for old in inertial.findall("inertia"):
            inertial.remove(old)
        mended = [moment + added * (k < 3) for k, moment in enumerate(moments)]
        ET.SubElement(inertial, "inertia", dict(zip(urdf.MOMENTS, map(as_text, mended), strict=True)))
    if frames:
        notes.append(f"frames without mass, merged into what they are fixed to: {', '.join(frames)}")


def choose_limits(joints: Iterable[ET.Element], notes: list[str]) -> list[str]:
    """Give every one of these joints a finite range, a speed and an effort, in place; changes are noted.

    Returns the joints without a usable effort: `choose_efforts` finds theirs when the arm's weight is known. A
    RobotError where a joint's lower limit lies above its upper one.
    """
    weak = []
    for joint in joints:
        name, kind = joint.get("name", ""), "sliding" if joint.get("type") == "prismatic" else "turning"
        given, (_, per_second) = urdf.limits(joint), _UNITS[kind]
        lower, upper = _range(name, kind, joint.get("type") == "continuous", given, notes)
        speed, effort = given.get("velocity", 0.0), given.get("effort", 0.0)
        if not 0.0 < speed <= FASTEST[kind]:
            notes.append(
                f"{name}: {f'{speed:g} {per_second} is no speed of an arm' if speed else 'no speed limit'}: "
                f"{CHOSEN[kind]:g} {per_second} is taken; see the data sheet"
            )
            speed = CHOSEN[kind]
        if not 0.0 < effort <= _STRONGEST[kind]:
            weak.append(name)
            effort = 1e3  # until the arm's weight is known
        urdf.write_limits(joint, lower, upper, speed, effort)
    return weak


def _range(name: str, kind: str, endless: bool, given: dict[str, float], notes: list[str]) -> tuple[float, float]:
    lower, upper, unit = given.get("lower", 0.0), given.get("upper", 0.0), _UNITS[kind][0]
    if lower > upper and not endless:
        raise RobotError(
            f"urdf joint {name!r}: lower = {lower:g} lies above upper = {upper:g}: are they exchanged? Give the range "
            f"of the data sheet in {unit}, the smaller number as lower"
        )
    if kind == "sliding":
        if lower < upper <= 100.0:
            return lower, upper
        notes.append(f"{name}: no range: +-{TRAVEL_M} m is taken")
        return -TRAVEL_M, TRAVEL_M
    why = ""
    if endless or lower == upper:
        why = " turns without end" if endless else " has no range"
    elif upper - lower > _DEGREES:
        why = f": {lower:g} to {upper:g} {unit} is no range of a joint (are they degrees? see the data sheet)"
    if why:
        notes.append(f"{name}{why}: +-180 deg is taken")
        return -math.pi, math.pi
    if upper - lower > 2.0 * math.pi + 1e-6:
        middle = 0.0 if lower <= -math.pi and upper >= math.pi else 0.5 * (lower + upper)
        notes.append(f"{name}: {math.degrees(upper - lower):.0f} deg of range are cut to one turn")
        return middle - math.pi, middle + math.pi
    return lower, upper


def choose_efforts(robot: RobotModel, weak: list[str]) -> dict[str, float]:
    """Choose efforts [Nm, N] of at least 5 for these joints: three times the most that gravity asks for."""
    poses = np.random.default_rng(0).uniform(robot.q_min, robot.q_max, (200, robot.n))
    most = np.max([np.abs(robot.gravity(q)) for q in poses], axis=0)
    needed = 3.0 * np.maximum(most, np.diag(robot.state(robot.data.q_home).M))
    by_name = dict(zip(robot.data.joint_names, needed, strict=True))
    return {name: max(5.0, float(f"{by_name[name]:.2g}")) for name in weak}
