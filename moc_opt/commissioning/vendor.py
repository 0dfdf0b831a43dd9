"""A URDF as vendors write it, made into one serial arm: everything that had to be assumed is noted."""

from __future__ import annotations

import copy
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin

from moc_opt.commissioning import bodies
from moc_opt.commissioning.tree import LinkTree, last_link
from moc_opt.errors import RobotError, UnknownNameError
from moc_opt.inputs.files import read_text
from moc_opt.robots import urdf
from moc_opt.robots.numbers import as_text, is_decimal, triple
from moc_opt.robots.rebuild import MOVING, SMALLEST_MASS, rebuild
from moc_opt.robots.urdf import end

_RESERVED = {"tool", "tip", "wrist", "tool_mount", "tip_frame", "wrist_frame", "world"}
_KEPT = {"link": ("inertial",), "joint": ("parent", "child", "origin", "axis", "limit")}
_PREFIX = re.compile(r"(?:</?|\s)([A-Za-z_][\w.-]*):[A-Za-z_]")
_QUOTED = re.compile(r'"[^"]*"|\'[^\']*\'')
TURN = 2.0 * math.pi
_ENDLESS = re.compile(r"\s*[+-]?inf(inity)?\s*", re.IGNORECASE)
_LARGEST = 1e5
"""rad, rad/s, Nm, m, m/s and N."""


@dataclass
class VendorArm:
    """One serial arm: links and joints alone, side joints fixed."""

    root: ET.Element
    last_link: str
    chain: list[str] = field(default_factory=list)
    """The moving joints from base to last link."""
    notes: list[str] = field(default_factory=list)
    """What was assumed or changed, one sentence each."""


def read_vendor(path: Path, *, tip: str | None = None, lock: Mapping[str, float] | None = None) -> VendorArm:
    """Read a URDF and make it a serial arm.

    Side joints (fingers, a second arm, a head) and those named in ``lock`` are fixed; masses that no body has are
    replaced; meshes are not looked at. Limits are left to `moc_opt.commissioning.limits`.

    Args:
        tip: the link that carries the tool; None: the end of the one chain there is, before the fingers.
        lock: joint -> the position [rad, m] at which it is fixed.

    Raises:
        RobotError: no URDF, xacro that is not expanded, no single chain, a mimic joint in the chain.
        UnknownNameError: ``tip`` or a joint of ``lock`` is not in the file.
    """
    text, undeclared = _declared(read_text(path, "urdf", RobotError))
    given = urdf.parse(text)
    if any("xacro" in str(element.tag) for element in given) or _in_braces(given):
        raise RobotError(f"urdf {str(path)!r} is a xacro file: expand it first (xacro {path.name} > arm.urdf)")
    mimics = {joint.get("name", ""): joint.find("mimic") for joint in given.findall("joint")}
    arm = VendorArm(_bare(given), "")
    if undeclared:
        arm.notes.append(f"names with {', '.join(undeclared)} are not read: the file does not say what they are")
    _rename(arm)
    _drop_endless_limits(arm)
    positions = _known(arm.root, dict(lock or {}))
    tree = LinkTree(arm.root)
    if tip is not None and tip not in tree.links:
        raise UnknownNameError("link (--tip)", tip, tree.links)
    arm.last_link = tip or last_link(tree, positions, arm.notes)
    path_to_tip = tree.path(arm.last_link)
    for joint in path_to_tip:
        name = joint.get("name", "")
        if joint.get("type") in MOVING and mimics.get(name) is not None and name not in positions:
            raise RobotError(
                f"urdf joint {name!r} lies between base and last link and mimics another: it cannot be driven by "
                "itself; fix it with --lock, or choose another --tip"
            )
    chain = [j for j in path_to_tip if j.get("type") in MOVING and j.get("name") not in positions]
    if not chain:
        raise RobotError(f"urdf: no moving joint lies between the base and {arm.last_link!r}: choose another --tip")
    for joint in path_to_tip[path_to_tip.index(chain[0]) :]:
        if joint.get("type") not in MOVING | {"fixed"}:
            raise RobotError(
                f"urdf joint {joint.get('name')!r} lies between two joints of the arm and is {joint.get('type')}: no "
                "drive moves it so; make it revolute, prismatic or fixed, or choose another --tip"
            )
    arm.chain = [joint.get("name", "") for joint in chain]
    _note_massless(arm, tree)
    _prune(arm, tree, chain[0])
    bodies.mend(arm.root, arm.notes)
    _fix_others(arm, positions)
    arm.root = rebuild(arm.root, arm.root.get("name") or "arm")
    return arm


def _declared(text: str) -> tuple[str, list[str]]:
    """Return the text with every prefix of its names declared on <robot>, and those that were not."""
    used = {name for tag in re.findall(r"<[^!?][^>]*>", text) for name in _PREFIX.findall(_QUOTED.sub("", tag))}
    missing = sorted(name for name in used - {"xml", "xmlns"} if f"xmlns:{name}=" not in text.replace(" ", ""))
    told = "".join(f' xmlns:{name}="{name}"' for name in missing)
    return re.sub(r"<robot\b", f"<robot{told}", text, count=1), [f"{name}:" for name in missing]


def _in_braces(given: ET.Element) -> bool:
    """Return whether a link or joint still has expressions of xacro in the place of numbers or names."""
    parts = (part for kind in _KEPT for element in given.findall(kind) for part in element.iter())
    return any("${" in value for part in parts for value in part.attrib.values())


def _bare(given: ET.Element) -> ET.Element:
    """Return a copy of links and joints without shapes, transmissions and simulators' elements."""
    made = ET.Element("robot", name=given.get("name", ""))
    for element in given:
        if element.tag in _KEPT:
            kept = ET.SubElement(made, str(element.tag), element.attrib)
            kept.extend(copy.deepcopy(child) for child in element if child.tag in _KEPT[str(element.tag)])
    return made


def _rename(arm: VendorArm) -> None:
    """Give names that the tool needs, or that MuJoCo takes for the world, a suffix."""
    for kind in ("link", "joint"):
        for element in arm.root.findall(kind):
            old = element.get("name", "")
            if old in _RESERVED:
                element.set("name", f"{old}_{kind}")
                arm.notes.append(f"{kind} {old!r} is called {old + '_' + kind!r} here: the name is taken")
                if kind == "link":
                    for end in arm.root.iterfind("joint/*[@link]"):
                        if end.get("link") == old:
                            end.set("link", f"{old}_{kind}")


def _drop_endless_limits(arm: VendorArm) -> None:
    """Leave out limits that are infinite, or larger than any number of an arm: as vendors write that there is none."""
    for joint in arm.root.findall("joint"):
        for limit in joint.findall("limit"):
            endless = [key for key, text in limit.attrib.items() if _ENDLESS.fullmatch(text) or _size(text) > _LARGEST]
            if not endless:
                continue
            told = ", ".join(f"{key} = {limit.get(key)}" for key in endless)
            arm.notes.append(f"{joint.get('name')}: {told} is no limit, and is taken for none")
            for key in {"lower", "upper", *endless} if {"lower", "upper"} & set(endless) else endless:
                limit.attrib.pop(key, None)


def _size(text: str) -> float:
    """The size of a decimal number; 0 where it is none, which is refused later by name."""
    return abs(float(text)) if is_decimal(text) else 0.0


def _note_massless(arm: VendorArm, tree: LinkTree) -> None:
    """Say where the last joint carries frames alone: the tool is then the only mass that it moves."""
    last = next(joint for joint in reversed(tree.path(arm.last_link)) if joint.get("name") == arm.chain[-1])
    links = [end(last, "child")]
    for link in links:  # grows while it is walked
        links += [end(joint, "child") for joint in tree.carried[link]]
    masses = {link.get("name"): link.find("inertial/mass") for link in arm.root.findall("link")}
    if all(masses[link] is None or _size(masses[link].get("value", "")) < SMALLEST_MASS for link in links):  # type: ignore[union-attr]
        arm.notes.append(
            f"{', '.join(links)}: what {arm.chain[-1]} carries has no mass, and the tool is all that it moves; see the "
            "data sheet for the mass of the flange"
        )


def _known(root: ET.Element, lock: dict[str, float]) -> dict[str, float]:
    moving = [joint.get("name", "") for joint in root.findall("joint") if joint.get("type") in MOVING]
    for name in lock:
        if name not in moving:
            raise UnknownNameError("joint (--lock)", name, moving)
    return lock


def _prune(arm: VendorArm, tree: LinkTree, first: ET.Element) -> None:
    """Leave out what hangs on links that never move: other arms, heads, tables."""
    still = end(first, "parent")
    keep = {first, *tree.path(still)}
    links = [end(first, "child")]
    for link in links:
        links += [end(joint, "child") for joint in tree.carried[link]]
        keep.update(tree.carried[link])
    links += [tree.base, *(end(joint, "child") for joint in tree.path(still))]
    dropped = [
        e for e in arm.root if (e.tag == "joint" and e not in keep) or (e.tag == "link" and e.get("name") not in links)
    ]
    for element in dropped:
        arm.root.remove(element)
    count = sum(element.tag == "link" for element in dropped)
    if count:
        arm.notes.append(f"{count} links that hang on the base beside the arm are left out")


def _fix_others(arm: VendorArm, positions: Mapping[str, float]) -> None:
    """Fix every joint that is not of the chain: at its given position, else at 0 or the end of its range next to it."""
    fixed = []
    for joint in arm.root.findall("joint"):
        name, kind = joint.get("name", ""), joint.get("type")
        if name in arm.chain or kind == "fixed":
            continue
        if kind in MOVING:
            found = urdf.limits(joint) if kind != "continuous" else {}
            default = min(max(0.0, found.get("lower", -TURN)), found.get("upper", TURN))
            value = positions.get(name, default)
            _shift(joint, value)
            fixed.append(f"{name} at {value:.3g} {'m' if kind == 'prismatic' else 'rad'}")
        else:
            fixed.append(f"{name} ({kind})")
        joint.set("type", "fixed")
    if fixed:
        arm.notes.append(f"fixed, for they are not of the chain: {', '.join(fixed)}")


def _shift(joint: ET.Element, value: float) -> None:
    """Move the joint's origin by its own motion of ``value`` [rad, m]."""
    if value == 0.0:
        return
    where = f"joint {joint.get('name')!r}"
    origin, given = joint.find("origin"), joint.find("axis")
    R = pin.rpy.rpyToMatrix(*triple(origin, "rpy", where, "rad"))
    axis = np.array(triple(given, "xyz", where, "1") if given is not None else (1.0, 0.0, 0.0))
    axis /= np.linalg.norm(axis)
    place = np.array(triple(origin, "xyz", where, "m"))
    if joint.get("type") == "prismatic":
        place = place + R @ (value * axis)
    else:
        R = R @ pin.exp3(value * axis)
    if origin is None:
        origin = ET.SubElement(joint, "origin")
    origin.set("xyz", as_text(*place))
    origin.set("rpy", as_text(*rpy_of(R)))


def rpy_of(R: np.ndarray) -> tuple[float, float, float]:
    """Return roll, pitch and yaw [rad] of a rotation (3,3), in URDF's order."""
    roll, pitch, yaw = pin.rpy.matrixToRpy(R).tolist()
    return roll, pitch, yaw


def chain_joints(arm: VendorArm) -> list[ET.Element]:
    """Return the chain's joints of the clean tree, base first."""
    by_name = {joint.get("name", ""): joint for joint in arm.root.findall("joint")}
    return [by_name[name] for name in arm.chain]
