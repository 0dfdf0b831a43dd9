"""URDF text: reading the serial chain, checking it, and bolting tool, tip and wrist onto it."""

from __future__ import annotations

import difflib
import math
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterable

from moc_opt.errors import RobotError
from moc_opt.robots.description import Frames, Point, Tool
from moc_opt.robots.numbers import as_text, number
from moc_opt.robots.rebuild import MOVING, SMALLEST_MASS, inertia_fault

TOOL_LINK, TIP_LINK, WRIST_LINK = "tool", "tip", "wrist"
_OUR_LINKS = {TOOL_LINK, TIP_LINK, WRIST_LINK}
_OUR_JOINTS = {"tool_mount", "tip_frame", "wrist_frame"}
_DEEPEST, _MOST_ELEMENTS = 32, 20_000


class _Bounded(ET.TreeBuilder):
    """Builds the tree, and refuses one that later readers, which recurse, could not walk through."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = self._elements = 0

    def start(self, tag: str, attrs: dict[str, str]) -> ET.Element:
        self._depth += 1
        self._elements += 1
        if self._depth > _DEEPEST or self._elements > _MOST_ELEMENTS:
            raise RobotError(
                f"urdf: element <{tag:.80}> is number {self._elements}, at depth {self._depth}: {_MOST_ELEMENTS} "
                f"elements and a depth of {_DEEPEST} are the most"
            )
        return super().start(tag, attrs)

    def end(self, tag: str) -> ET.Element:
        self._depth -= 1
        return super().end(tag)


def parse(text: str) -> ET.Element:
    """Parse URDF text.

    Raises:
        RobotError: not XML, not a <robot>, or a document type or entity is declared (a few lines of entities
            can expand to gigabytes or read other files, and no URDF needs one).
    """
    if any(mark in text.upper() for mark in ("<!DOCTYPE", "<!ENTITY")):
        raise RobotError("urdf declares a document type or entities: remove <!DOCTYPE ...> and <!ENTITY ...>")
    try:
        root = ET.fromstring(text, parser=ET.XMLParser(target=_Bounded()))
    except ET.ParseError as error:
        raise RobotError(f"urdf is not well-formed XML ({error}): expand xacro files and check the line") from error
    if root.tag != "robot":
        raise RobotError(f"urdf root is <{root.tag}>: a URDF begins with <robot>")
    return root


def end(joint: ET.Element, which: str) -> str:
    """Return the link at the joint's "parent" or "child" end."""
    found = joint.find(which)
    if found is None or not found.get("link"):
        raise RobotError(f"urdf joint {joint.get('name')!r} has no <{which} link=...>: add it")
    return str(found.get("link"))


def moving_joints(root: ET.Element, last_link: str) -> list[ET.Element]:
    """Return the movable joints of a rebuilt tree from base to `last_link`, in that order; no other joint may move."""
    links = [link.get("name", "") for link in root.findall("link")]
    if last_link not in links:
        near = difflib.get_close_matches(last_link, links, n=3, cutoff=0.3)
        raise RobotError(
            f"frames.last_link = {last_link!r} is no link of the urdf: did you mean one of {near or links[:20]}?"
        )
    by_child = {end(joint, "child"): joint for joint in root.findall("joint")}
    path: list[ET.Element] = []
    link = last_link
    while link in by_child:
        path.append(by_child[link])
        link = end(path[-1], "parent")
    chain = [joint for joint in reversed(path) if joint.get("type") in MOVING]
    if not chain:
        raise RobotError(f"frames.last_link = {last_link!r}: no movable joint lies between the base and it")
    moving = {joint.get("name") for joint in chain}
    for joint in root.findall("joint"):
        if joint.get("type") in MOVING and joint.get("name") not in moving:
            raise RobotError(
                f"urdf joint {joint.get('name')!r} moves but is not between base and last link: make it fixed"
            )
    return chain


def check_masses(root: ET.Element, chain: Iterable[ET.Element]) -> None:
    """Check that every movable joint moves some mass."""
    heavy = {link.get("name", "") for link in root.findall("link") if link.find("inertial") is not None}
    fixed: dict[str, list[str]] = defaultdict(list)
    for joint in root.findall("joint"):
        if joint.get("type") == "fixed":
            fixed[end(joint, "parent")].append(end(joint, "child"))
    for joint in chain:
        body, new = set(), [end(joint, "child")]
        while new:
            link = new.pop()
            if link not in body:
                body.add(link)
                new += fixed[link]
        if not body & heavy:
            raise RobotError(
                f"urdf joint {joint.get('name')!r} moves no mass: give link {end(joint, 'child')!r} an <inertial>"
            )


def check_names_free(root: ET.Element) -> None:
    """Check that no link or joint has a name of those that `append_tool` adds."""
    for tag, ours in (("link", _OUR_LINKS), ("joint", _OUR_JOINTS)):
        taken = sorted({element.get("name", "") for element in root.findall(tag)} & ours)
        if taken:
            raise RobotError(f"urdf already has {tag}s named {taken}: rename them, the tool needs these names")


def limits(joint: ET.Element) -> dict[str, float]:
    """Read the numbers of a joint's <limit> element that are there: lower, upper, velocity, effort."""
    element = joint.find("limit")
    if element is None:
        return {}
    keys = ("lower", "upper", "velocity", "effort")
    where = f"<limit> of joint {joint.get('name')!r}"
    return {key: number(element.get(key, ""), f"{where}, {key}", "a limit") for key in keys if key in element.attrib}


def write_limits(joint: ET.Element, lower: float, upper: float, velocity: float, effort: float) -> None:
    """Put these limits into the text, so that every later reader of the URDF sees the same ones."""
    if joint.get("type") == "continuous":
        joint.set("type", "revolute")
    for old in joint.findall("limit"):
        joint.remove(old)
    values = {"lower": lower, "upper": upper, "velocity": velocity, "effort": effort}
    ET.SubElement(joint, "limit", {key: as_text(value) for key, value in values.items()})


def append_tool(root: ET.Element, frames: Frames, tool: Tool) -> None:
    """Add link "tool" on fixed joint "tool_mount", and the massless links "tip" and "wrist".

    The tool is a uniform round rod along z of the mount. The wrist must lie on its axis, behind the tip: the
    control laws take the line from wrist to tip for the shaft.
    """
    axis = _mount_axis(frames.tool_mount_rpy_rad)
    mount = frames.tool_mount_xyz_m
    back = [m - w for m, w in zip(mount, frames.wrist_xyz_m, strict=True)]
    along = sum(a * b for a, b in zip(axis, back, strict=True))
    off = math.dist(back, [along * a for a in axis])
    if off > 1e-6 or along + tool.length_m <= 0:
        raise RobotError(
            f"frames.wrist_xyz_m = {frames.wrist_xyz_m} is {off:.3g} m off the tool's axis or past the tip: "
            "put it on the line of the shaft, behind the tip (the tool mount itself will do)"
        )
    tip = tuple(m + tool.length_m * a for m, a in zip(mount, axis, strict=True))
    root.append(_rod(tool))
    _fix(root, "tool_mount", frames.last_link, TOOL_LINK, mount, frames.tool_mount_rpy_rad)
    for name, point in ((TIP_LINK, tip), (WRIST_LINK, frames.wrist_xyz_m)):
        ET.SubElement(root, "link", name=name)
        _fix(root, f"{name}_frame", frames.last_link, name, (point[0], point[1], point[2]), frames.tool_mount_rpy_rad)


def to_text(root: ET.Element) -> str:
    """Write the URDF as text, indented."""
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _rod(tool: Tool) -> ET.Element:
    m, length, r = tool.mass_kg, tool.length_m, tool.radius_m
    across, about = m * (3 * r * r + length * length) / 12, m * r * r / 2
    fault = inertia_fault((across, across, about, 0.0, 0.0, 0.0))
    if m < SMALLEST_MASS or fault is not None:
        raise RobotError(
            f"tool of {m:g} kg, {length:g} m, radius {r:g} m: {fault or f'{SMALLEST_MASS:g} kg is the least'}; raise "
            "tool.mass_kg (tool_mass) or tool.radius_m"
        )
    link = ET.Element("link", name=TOOL_LINK)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=as_text(0.0, 0.0, length / 2), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=as_text(m))
    moments = {"ixx": across, "ixy": 0.0, "ixz": 0.0, "iyy": across, "iyz": 0.0, "izz": about}
    ET.SubElement(inertial, "inertia", {key: as_text(value) for key, value in moments.items()})
    return link


def _fix(root: ET.Element, name: str, parent: str, child: str, xyz: Point, rpy: Point) -> None:
    joint = ET.SubElement(root, "joint", name=name, type="fixed")
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=as_text(*xyz), rpy=as_text(*rpy))


def _mount_axis(rpy: Point) -> Point:
    """Return third column of Rz(yaw) Ry(pitch) Rx(roll)."""
    (sr, sp, sy), (cr, cp, cy) = map(math.sin, rpy), map(math.cos, rpy)
    return (cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr)
