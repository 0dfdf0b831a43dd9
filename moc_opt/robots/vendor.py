"""Make one serial arm of a vendor's URDF; everything that had to be assumed or changed is noted."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin

from moc_opt.errors import RobotError, UnknownNameError
from moc_opt.inputs.files import read_text
from moc_opt.robots import urdf
from moc_opt.robots.model import RobotModel
from moc_opt.robots.urdf import Joint, Link, Urdf

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
_RESERVED = {"world"}.union(*urdf.TOOL_NAMES.values())
_PREFIX = re.compile(r"(?:</?|\s)([A-Za-z_][\w.-]*):[A-Za-z_]")
_QUOTED = re.compile(r'"[^"]*"|\'[^\']*\'')


@dataclass
class VendorArm:
    """One serial arm, its side joints fixed."""

    urdf: Urdf
    last_link: str = ""
    chain: list[Joint] = field(default_factory=list)  #: The moving joints from base to last link.
    notes: list[str] = field(default_factory=list)  #: Assumptions and changes, one sentence each.


def read_vendor(path: Path, *, tip: str | None = None, lock: Mapping[str, float] | None = None) -> VendorArm:
    """Read a URDF and make it a serial arm; limits are left to `choose_limits`.

    Side joints (fingers, a second arm, a head) and those named in ``lock`` are fixed; masses that no body has are
    replaced; meshes are not looked at.

    Args:
        path: the vendor's file.
        tip: the link that carries the tool; None: the end of the one chain there is, before the fingers.
        lock: joint -> the position [rad, m] at which it is fixed.

    Raises:
        RobotError: no URDF, xacro that is not expanded, no single chain, a mimic joint in the chain.
        UnknownNameError: ``tip`` or a joint of ``lock`` is not in the file.
    """
    text, undeclared = _declared(read_text(path, "urdf", RobotError))
    root = urdf.parse(text)
    values = [value for kind in ("link", "joint") for each in root.findall(kind) for part in each.iter()
              for value in part.attrib.values()]  # fmt: skip
    if any("xacro" in each.tag for each in root) or any("${" in value for value in values):
        raise RobotError(f"urdf {str(path)!r} is a xacro file: expand it first (xacro {path.name} > arm.urdf)")
    arm, locked = VendorArm(urdf.read(root)), dict(lock or {})
    if undeclared:
        arm.notes.append(f"names with {', '.join(undeclared)} are not read: the file does not say what they are")
    _rename(arm)
    _drop_endless_limits(arm)
    moving = [joint.name for joint in arm.urdf.joints if joint.moves]
    for name in locked:
        if name not in moving:
            raise UnknownNameError("joint (--lock)", name, moving)
    tree = _Tree(arm.urdf, locked)
    if tip is not None and tip not in tree.links:
        raise UnknownNameError("link (--tip)", tip, tree.links)
    arm.last_link = tip or _last_link(tree, arm.notes)
    arm.chain = _chain(tree, arm.last_link)
    carried = tree.reach(arm.chain[-1].child)
    if max(link.mass or 0.0 for link in arm.urdf.links if link.name in carried) < urdf.SMALLEST_MASS:
        arm.notes.append(
            f"{', '.join(carried)}: what {arm.chain[-1].name} carries has no mass, so it moves the tool alone; see the "
            "data sheet for the mass of the flange"
        )
    _prune(arm, tree)
    mend_bodies(arm.urdf.links, arm.notes)
    _fix_others(arm, locked)
    urdf.normalize(arm.urdf)
    return arm


def _declared(text: str) -> tuple[str, list[str]]:
    # Some vendors' files use prefixes that they never declare, which no XML reader takes.
    used = {name for tag in re.findall(r"<[^!?][^>]*>", text) for name in _PREFIX.findall(_QUOTED.sub("", tag))}
    missing = sorted(name for name in used - {"xml", "xmlns"} if f"xmlns:{name}=" not in text.replace(" ", ""))
    told = "".join(f' xmlns:{name}="{name}"' for name in missing)
    return re.sub(r"<robot\b", f"<robot{told}", text, count=1), [f"{name}:" for name in missing]


def _rename(arm: VendorArm) -> None:
    for kind, parts in (("link", arm.urdf.links), ("joint", arm.urdf.joints)):
        for part in parts:
            if part.name in _RESERVED:
                old, part.name = part.name, f"{part.name}_{kind}"
                arm.notes.append(f"{kind} {old!r} is called {part.name!r} here: the name is taken")
                for joint in arm.urdf.joints if kind == "link" else ():
                    joint.parent = part.name if joint.parent == old else joint.parent
                    joint.child = part.name if joint.child == old else joint.child


def _drop_endless_limits(arm: VendorArm) -> None:
    for joint in arm.urdf.joints:
        endless = [key for key, value in joint.limits.items() if abs(value) > _LARGEST]
        if endless:
            told = ", ".join(f"{key} = {joint.limits[key]:g}" for key in endless)
            arm.notes.append(f"{joint.name}: {told} is no limit, and is taken for none")
        for key in {"lower", "upper", *endless} if {"lower", "upper"} & set(endless) else endless:
            joint.limits.pop(key, None)


def _chain(tree: _Tree, last_link: str) -> list[Joint]:
    on_path = tree.path(last_link)
    chain = [joint for joint in on_path if tree.moves(joint)]
    if not chain:
        raise RobotError(f"urdf: no moving joint lies between the base and {last_link!r}: choose another --tip")
    for joint in on_path:
        if tree.moves(joint) and joint.mimics:
            raise RobotError(
                f"urdf joint {joint.name!r} lies between base and last link and mimics another: it cannot be driven by "
                "itself; fix it with --lock, or choose another --tip"
            )
    for joint in on_path[on_path.index(chain[0]) :]:
        if not joint.moves and joint.kind != "fixed":
            raise RobotError(
                f"urdf joint {joint.name!r} lies between two joints of the arm and is {joint.kind}: no drive moves it "
                "so; make it revolute, prismatic or fixed, or choose another --tip"
            )
    return chain


def _prune(arm: VendorArm, tree: _Tree) -> None:
    below, first = tree.path(arm.chain[0].parent), arm.chain[0]
    kept = {tree.base, *(joint.child for joint in below), *tree.reach(first.child)}
    left_out = len(arm.urdf.links) - len(kept)
    arm.urdf.links = [link for link in arm.urdf.links if link.name in kept]
    arm.urdf.joints = [joint for joint in arm.urdf.joints if joint.child in kept]
    if left_out:
        arm.notes.append(f"{left_out} links that hang on the base beside the arm are left out")


def _fix_others(arm: VendorArm, locked: Mapping[str, float]) -> None:
    fixed = []
    for joint in arm.urdf.joints:
        joint.mimics = False
        if joint in arm.chain or joint.kind == "fixed":
            continue
        if joint.moves:
            reach = joint.limits if joint.kind != "continuous" else {}
            nearest = min(max(0.0, reach.get("lower", -_LARGEST)), reach.get("upper", _LARGEST))
            value = locked.get(joint.name, nearest)
            _shift(joint, value)
            fixed.append(f"{joint.name} at {value:.3g} {'m' if joint.kind == 'prismatic' else 'rad'}")
        else:
            fixed.append(f"{joint.name} ({joint.kind})")
        joint.kind = "fixed"
    if fixed:
        arm.notes.append(f"fixed, for they are not of the chain: {', '.join(fixed)}")


def _shift(joint: Joint, value: float) -> None:
    if value == 0.0:
        return
    R, motion = pin.rpy.rpyToMatrix(*joint.rpy), value * np.array(joint.axis) / np.linalg.norm(joint.axis)
    if joint.kind == "prismatic":
        joint.xyz = tuple((np.array(joint.xyz) + R @ motion).tolist())
    else:
        joint.rpy = tuple(pin.rpy.matrixToRpy(R @ pin.exp3(motion)).tolist())


class _Tree(urdf.Tree):
    """A tree of links in which some joints are locked."""

    def __init__(self, arm: Urdf, locked: Mapping[str, float]) -> None:
        super().__init__(arm)
        self.locked = locked

    def moves(self, joint: Joint) -> bool:
        return joint.moves and joint.name not in self.locked

    def depth(self, link: str) -> int:
        """Count the most moving joints in a row that hang on this link."""
        return max((self.moves(joint) + self.depth(joint.child) for joint in self.carried[link]), default=0)

    def arms(self) -> list[str]:
        """Links that end a chain of `ARM` moving joints, longest first; branches shorter than that are fingers."""
        found: list[tuple[int, str]] = []
        waiting = [(self.base, 0)]
        while waiting:
            link, count = waiting.pop()
            ways = [(joint.child, count + self.moves(joint)) for joint in self.carried[link]]
            on = [way for way in ways if way[1] > count or self.depth(way[0])]
            longest = max((n - count + self.depth(child) for child, n in on), default=0)
            if on and (len(on) == 1 or longest >= ARM or count < ARM):
                waiting += on
            elif count >= ARM:
                found.append((count, link))
        return [link for _, link in sorted(found, key=lambda each: (-each[0], each[1]))]


def _last_link(tree: _Tree, notes: list[str]) -> str:
    link, joints = tree.base, 0
    while branches := [j for j in tree.carried[link] if tree.moves(j) or tree.depth(j.child)]:
        if len(branches) > 1:
            long = [j for j in branches if tree.moves(j) + tree.depth(j.child) > FINGERS]
            if not long and joints >= FINGERS:
                notes.append(f"the chain ends at {link!r}, where {len(branches)} fingers branch off")
                return link
            if len(long) != 1:
                ends, arms = [j.child for j in (long or branches)], tree.arms()[:8]
                raise RobotError(
                    f"urdf: {len(ends)} chains leave link {link!r}, towards {ends[:6]}: say with --tip which link "
                    f"carries the tool{f', such as {arms}' if arms else ''}"
                )
            branches = long
        joints += tree.moves(branches[0])
        link = branches[0].child
    last = next((j for j in reversed(tree.path(link)) if tree.moves(j)), None)
    if last is not None and joints > 1 and _JAW.search(f"{last.name} {last.child}"):
        notes.append(f"{last.name!r} is taken for the jaw of a gripper: the chain ends before it, at {last.parent!r}")
        return last.parent
    # Behind the last moving joint only frames are left: the flange is the one that is named so, else the link itself.
    flange = next((found for word in _FLANGES for found in tree.reach(link) if found.endswith(word)), None)
    how = "the flange by its name" if flange else "carried by the last moving joint"
    notes.append(f"last link: {flange or link!r}, {how}")
    return flange or link


# --- numbers that no arm has ---


def mend_bodies(links: Iterable[Link], notes: list[str]) -> None:
    """Make every body one that can be, in place; each change is noted.

    A link without mass is a frame, and merged into the link it is fixed to. One without inertia gets that of a ball of
    its mass, as dense as water. To an inertia that no body has, the smallest ball's is added that makes it possible.
    """
    frames = []
    for link in links:
        if link.is_frame:
            continue
        kilograms, moments = link.mass or 0.0, link.moments or (0.0,) * 6
        if 0.0 <= kilograms < urdf.SMALLEST_MASS:
            link.mass = link.moments = None
            frames.append(link.name)
            continue
        fault = urdf.inertia_fault(moments)
        if fault is None:
            continue
        if max(map(abs, moments)) < urdf.SMALLEST_MOMENT:
            radius = (3.0 * kilograms / (4.0 * math.pi * 1000.0)) ** (1.0 / 3.0)
            added = max(0.4 * kilograms * radius**2, 10.0 * urdf.SMALLEST_MOMENT)
            notes.append(f"link {link.name!r} ({kilograms:.3g} kg) has no inertia: that of a ball of water is taken")
        else:
            least, middle, most = urdf.principal(moments)
            lacking = max(most - least - middle, 1e-3 * most - least, 10.0 * urdf.SMALLEST_MOMENT - least)
            added = lacking * (1.0 + 1e-6) + 1e-12
            notes.append(f"link {link.name!r} has an inertia that no body has, {fault}: {added:.3g} kg m^2 is added")
        link.moments = (*(moment + added for moment in moments[:3]), *moments[3:])
    if frames:
        notes.append(f"frames without mass, merged into what they are fixed to: {', '.join(frames)}")


def choose_limits(joints: Iterable[Joint], notes: list[str]) -> list[str]:
    """Give every one of these joints a finite range, a speed and an effort, in place; changes are noted.

    Returns the joints without a usable effort: `choose_efforts` finds theirs when the arm's weight is known. A
    RobotError where a joint's lower limit lies above its upper one.
    """
    weak = []
    for joint in joints:
        kind = "sliding" if joint.kind == "prismatic" else "turning"
        lower, upper = _range(joint, kind, notes)
        speed, effort, per_second = joint.limits.get("velocity", 0.0), joint.limits.get("effort", 0.0), _UNITS[kind][1]
        if not 0.0 < speed <= FASTEST[kind]:
            notes.append(
                f"{joint.name}: {f'{speed:g} {per_second} is no speed of an arm' if speed else 'no speed limit'}: "
                f"{CHOSEN[kind]:g} {per_second} is taken; see the data sheet"
            )
            speed = CHOSEN[kind]
        if not 0.0 < effort <= _STRONGEST[kind]:
            weak.append(joint.name)
            effort = 1e3  # until the arm's weight is known
        joint.limit(lower, upper, speed, effort)
    return weak


def _range(joint: Joint, kind: str, notes: list[str]) -> tuple[float, float]:
    lower, upper = joint.limits.get("lower", 0.0), joint.limits.get("upper", 0.0)
    unit, endless = _UNITS[kind][0], joint.kind == "continuous"
    if lower > upper and not endless:
        raise RobotError(
            f"urdf joint {joint.name!r}: lower = {lower:g} lies above upper = {upper:g}: are they exchanged? Give the "
            f"range of the data sheet in {unit}, the smaller number as lower"
        )
    if kind == "sliding":
        if lower < upper <= 100.0:
            return lower, upper
        notes.append(f"{joint.name}: no range: +-{TRAVEL_M} m is taken")
        return -TRAVEL_M, TRAVEL_M
    why = ""
    if endless or lower == upper:
        why = " turns without end" if endless else " has no range"
    elif upper - lower > _DEGREES:
        why = f": {lower:g} to {upper:g} rad is no range of a joint (are they degrees? see the data sheet)"
    if why:
        notes.append(f"{joint.name}{why}: +-180 deg is taken")
        return -math.pi, math.pi
    if upper - lower > 2.0 * math.pi + 1e-6:
        middle = 0.0 if lower <= -math.pi and upper >= math.pi else 0.5 * (lower + upper)
        notes.append(f"{joint.name}: {math.degrees(upper - lower):.0f} deg of range are cut to one turn")
        return middle - math.pi, middle + math.pi
    return lower, upper


def choose_efforts(robot: RobotModel, weak: list[str]) -> dict[str, float]:
    """Choose efforts [Nm, N] of at least 5 for these joints: three times the most that gravity asks for."""
    poses = np.random.default_rng(0).uniform(robot.q_min, robot.q_max, (200, robot.n))
    most = np.max([np.abs(robot.gravity(q)) for q in poses], axis=0)
    needed = 3.0 * np.maximum(most, np.diag(robot.state(robot.data.q_home).M))
    by_name = dict(zip(robot.data.joint_names, needed, strict=True))
    return {name: max(5.0, float(f"{by_name[name]:.2g}")) for name in weak}
