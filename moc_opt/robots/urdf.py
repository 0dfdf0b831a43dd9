"""Read a URDF, check it, and write it anew, so that pinocchio and MuJoCo get the same numbers."""

from __future__ import annotations

import difflib
import math
import xml.etree.ElementTree as ET
from collections import Counter, defaultdict
from collections.abc import Iterable

import numpy as np

from moc_opt.errors import RobotError
from moc_opt.inputs import names
from moc_opt.inputs.files import decimal

MOVING = frozenset({"revolute", "continuous", "prismatic"})
TOOL_LINK, TIP_LINK, WRIST_LINK = "tool", "tip", "wrist"
TOOL_NAMES = {"link": {TOOL_LINK, TIP_LINK, WRIST_LINK}, "joint": {"tool_mount", "tip_frame", "wrist_frame"}}
"""Names that the tool brings, and that a URDF must not have."""
MOST_LINKS = 500
"""Engines walk a tree by recursion: MuJoCo stops at a depth of 1000, and some thousands end the process."""
MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
SMALLEST_MASS, SMALLEST_MOMENT = 1e-6, 1e-12
_TRIANGLE, _FLAT, _THIN = 1e-6, 1e-9, 1e-12  # of the largest moment: files round their numbers
SMALLEST = 1e-30  #: A smaller number is read as 0: some readers refuse those below 1e-308.
LARGEST = {"m": 100.0, "rad": 100.0, "kg": 1e5, "kg m^2": 1e6, "1": 1e3, "a limit": 1e6}
"""Unit -> the largest number of it that an arm can have."""


def parse(text: str) -> ET.Element:
    """Parse URDF text; a RobotError where it is no XML, or no <robot>."""
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise RobotError(f"urdf is not well-formed XML ({error}): expand xacro files and check the line") from error
    if root.tag != "robot":
        raise RobotError(f"urdf root is <{root.tag}>: a URDF begins with <robot>")
    return root


def number(text: str, what: str, unit: str) -> float:
    """Read one number in a unit of `LARGEST`; a RobotError that names ``what`` where it is none, or too large."""
    value = decimal(text.strip())
    if not abs(value) <= LARGEST[unit]:
        raise RobotError(
            f"urdf: {what} is {text!r:.80}: give a finite decimal number of at most {LARGEST[unit]:g} ({unit})"
        )
    return 0.0 if 0.0 < abs(value) < SMALLEST else value


def triple(element: ET.Element | None, key: str, what: str, unit: str) -> tuple[float, float, float]:
    """Read three numbers from an attribute; zeros where element or attribute is missing. Errors as of `number`."""
    if element is None or key not in element.attrib:
        return (0.0, 0.0, 0.0)
    parts = element.get(key, "").split()
    if len(parts) != 3:
        raise RobotError(f"urdf: {what} is {element.get(key)!r:.80}: write three numbers, such as '0 0 0.1'")
    x, y, z = (number(part, what, unit) for part in parts)
    return (x, y, z)


def as_text(*values: float) -> str:
    """Write numbers so that every reader gets them back to the bit."""
    return " ".join(repr(float(value)) for value in values)


def end(joint: ET.Element, which: str) -> str:
    """Return the link at the joint's "parent" or "child" end."""
    found = joint.find(which)
    if found is None or not found.get("link"):
        raise RobotError(f"urdf joint {joint.get('name')!r} has no <{which} link=...>: add it")
    return str(found.get("link"))


def limits(joint: ET.Element) -> dict[str, float]:
    """Read the numbers of a joint's <limit> element that are there: lower, upper, velocity, effort."""
    element = joint.find("limit")
    if element is None:
        return {}
    keys = ("lower", "upper", "velocity", "effort")
    where = f"<limit> of joint {joint.get('name')!r}"
    return {key: number(element.get(key, ""), f"{where}, {key}", "a limit") for key in keys if key in element.attrib}


def write_limits(joint: ET.Element, lower: float, upper: float, velocity: float, effort: float) -> None:
    """Replace the joint's <limit>, so that every later reader of the URDF sees the same one."""
    if joint.get("type") == "continuous":
        joint.set("type", "revolute")
    for old in joint.findall("limit"):
        joint.remove(old)
    values = {"lower": lower, "upper": upper, "velocity": velocity, "effort": effort}
    ET.SubElement(joint, "limit", {key: as_text(value) for key, value in values.items()})


def to_text(root: ET.Element) -> str:
    """Write the URDF as text, indented."""
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def rebuild(root: ET.Element, name: str) -> ET.Element:
    """Copy links and joints, every number read and written by us; shapes and all else are left out.

    Raises:
        RobotError: a wrong name or number, an element that is missing or there twice, an inertia that no body has, or
            links and joints that are no tree.
    """
    count = max(len(root.findall(tag)) for tag in ("link", "joint"))
    if count > MOST_LINKS:
        raise RobotError(f"urdf has {count} links or joints: an arm has {MOST_LINKS} at most; leave others out")
    made = ET.Element("robot", name=name)
    for element in root:
        if element.tag in ("link", "joint"):
            made.append(_link(element) if element.tag == "link" else _joint(element))
    Tree(made)
    return made


def inertia_fault(moments: Iterable[float]) -> str | None:
    """Say why no body has this inertia ixx, iyy, izz, ixy, ixz, iyz [kg m^2] about its centre of mass; None if one may.

    It must be positive definite, and no principal moment may be larger than the other two together.
    """
    least, middle, most = principal(moments)
    shown = f"principal moments {least:.4g}, {middle:.4g}, {most:.4g} kg m^2"
    if least < max(SMALLEST_MOMENT, _THIN * most):
        return f"it is not positive definite ({shown}; {SMALLEST_MOMENT:g}, or {_THIN:g} of the largest, is the least)"
    if least + middle < most * (1.0 - _TRIANGLE):
        return f"the largest of its {shown} is more than the other two together (triangle inequality)"
    return None


def principal(moments: Iterable[float]) -> list[float]:
    """Return the three principal moments of ixx, iyy, izz, ixy, ixz, iyz, in rising order."""
    xx, yy, zz, xy, xz, yz = moments
    found: list[float] = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).tolist()
    return found


def _off_the_edge(moments: dict[str, float]) -> dict[str, float]:
    # A flat body gets a thickness of 1e-9: as it is, rounding decides whether MuJoCo takes it.
    least, middle, most = principal(moments.values())
    lacking = max(_FLAT * most - (least + middle - most), 0.0)
    return {key: value + lacking if key in ("ixx", "iyy", "izz") else value for key, value in moments.items()}


def _link(link: ET.Element) -> ET.Element:
    name = _checked(link)
    made, inertial = ET.Element("link", name=name), _one(link, "inertial", f"link {name!r}")
    if inertial is None:
        return made
    where = f"<inertial> of link {name!r}"
    origin, mass, inertia = (_one(inertial, tag, where) for tag in ("origin", "mass", "inertia"))
    if mass is None or inertia is None:
        raise RobotError(f"urdf link {name!r} has an <inertial> without <mass> or <inertia>: add it or drop <inertial>")
    kilograms = number(mass.get("value", ""), f"mass of link {name!r}", "kg")
    moments = {key: number(inertia.get(key, "0"), f"inertia {key} of link {name!r}", "kg m^2") for key in MOMENTS}
    if kilograms == 0.0 and not any(moments.values()):
        return made  # how many vendors write a frame
    if kilograms < SMALLEST_MASS:
        raise RobotError(
            f"urdf link {name!r} has mass {kilograms:g}: give {SMALLEST_MASS:g} kg or more, or drop <inertial> for a "
            "massless frame"
        )
    fault = inertia_fault(moments.values())
    if fault is not None:
        raise RobotError(
            f"urdf link {name!r} has an inertia that no body has: {fault}; correct ixx ... izz, about the centre of "
            "mass and in kg m^2"
        )
    copy = ET.SubElement(made, "inertial")
    _place(copy, origin, where)
    ET.SubElement(copy, "mass", value=as_text(kilograms))
    ET.SubElement(copy, "inertia", {key: as_text(value) for key, value in _off_the_edge(moments).items()})
    return made


def _joint(joint: ET.Element) -> ET.Element:
    name, kind = _checked(joint), joint.get("type")
    where = f"joint {name!r}"
    if kind not in MOVING | {"fixed"}:
        raise RobotError(f"urdf {where} has type {kind!r}: use revolute, prismatic, continuous or fixed")
    if joint.find("mimic") is not None:
        raise RobotError(f"urdf {where} mimics another: make it fixed or free")
    made = ET.Element("joint", name=name, type=kind)
    for which in ("parent", "child"):
        ET.SubElement(made, which, link=end(joint, which))
    _place(made, _one(joint, "origin", where), where)
    axis, limit = _one(joint, "axis", where), _one(joint, "limit", where)
    if kind in MOVING:
        vector = (1.0, 0.0, 0.0) if axis is None else triple(axis, "xyz", f"<axis> of {where}, xyz", "1")
        length = math.hypot(*vector)
        if length < 1e-3:
            raise RobotError(f"urdf: <axis> of {where} has no length: give a direction, such as '0 0 1'")
        ET.SubElement(made, "axis", xyz=as_text(*(value / length for value in vector)))
        if limit is not None:
            made.append(ET.Element("limit", limit.attrib))  # `limits` reads it, `write_limits` replaces it
    return made


def _place(parent: ET.Element, origin: ET.Element | None, where: str) -> None:
    xyz = triple(origin, "xyz", f"<origin> of {where}, xyz", "m")
    rpy = triple(origin, "rpy", f"<origin> of {where}, rpy", "rad")
    ET.SubElement(parent, "origin", xyz=as_text(*xyz), rpy=as_text(*rpy))


def _one(parent: ET.Element, tag: str, where: str) -> ET.Element | None:
    found = parent.findall(tag)
    if len(found) > 1:
        raise RobotError(f"urdf {where} has {len(found)} <{tag}>: leave one, readers differ in which they take")
    return found[0] if found else None


def _checked(element: ET.Element) -> str:
    name = element.get("name", "")
    if not names.is_name(name):
        raise RobotError(f"urdf: the name of a {element.tag}, {name!r:.80} is no name: {names.RULE}")
    return name


class Tree:
    """The links of a URDF and the joints between them: one ``base``, every other link on one joint.

    ``carrier`` is the joint that a link hangs on, ``carried`` are the joints that hang on it. A RobotError names the
    links or joints that make no such tree.
    """

    def __init__(self, root: ET.Element) -> None:
        if root.find("link") is None or root.find("joint") is None:
            raise RobotError("urdf has no <link> or no <joint>: a serial arm is needed")
        for tag in ("link", "joint"):
            name, times = Counter(element.get("name", "") for element in root.findall(tag)).most_common(1)[0]
            if times > 1:
                raise RobotError(f"urdf has {times} {tag}s named {name!r}: give each a name of its own")
        self.links = [link.get("name", "") for link in root.findall("link")]
        self.carrier: dict[str, ET.Element] = {}
        self.carried: dict[str, list[ET.Element]] = defaultdict(list)
        for joint in root.findall("joint"):
            name, parent, child = joint.get("name", ""), end(joint, "parent"), end(joint, "child")
            for link in (parent, child):
                if link not in self.links:
                    raise RobotError(f"urdf joint {name!r} names link {link!r:.80}: there is no such link; add it")
            if child in self.carrier:
                other = self.carrier[child].get("name")
                raise RobotError(f"urdf joints {other!r} and {name!r} both carry link {child!r}: leave one")
            self.carrier[child] = joint
            self.carried[parent].append(joint)
        if "world" in self.carrier:
            name = self.carrier["world"].get("name", "")
            raise RobotError(f"urdf joint {name!r} carries a link 'world', which MuJoCo takes for the base: rename it")
        bases = [link for link in self.links if link not in self.carrier]
        if len(bases) > 1:
            raise RobotError(f"urdf links {bases[:5]} hang on no joint: one base is needed, fix the others to it")
        lost = sorted(set(self.links) - {link for base in bases for link in self.reach(base)})
        if lost:
            raise RobotError(f"urdf joints form a loop at links {lost[:5]}: they hang on each other and not on a base")
        self.base = bases[0]

    def path(self, link: str) -> list[ET.Element]:
        """Return the joints from base to link."""
        found: list[ET.Element] = []
        while link in self.carrier:
            found.append(self.carrier[link])
            link = end(found[-1], "parent")
        return found[::-1]

    def reach(self, link: str, *, fixed: bool = False) -> list[str]:
        """Return the link and all links that hang on it, or those that are ``fixed`` to it."""
        found = [link]
        for one in found:  # grows while it is walked
            found += [end(j, "child") for j in self.carried[one] if not fixed or j.get("type") == "fixed"]
        return found


def moving_joints(root: ET.Element, last_link: str) -> list[ET.Element]:
    """Return the movable joints from base to `last_link`; a RobotError where there are none, or another may move."""
    tree = Tree(root)
    if last_link not in tree.links:
        near = difflib.get_close_matches(last_link, tree.links, n=3, cutoff=0.3)
        raise RobotError(
            f"frames.last_link = {last_link!r} is no link of the urdf: did you mean one of {near or tree.links[:20]}?"
        )
    chain = [joint for joint in tree.path(last_link) if joint.get("type") in MOVING]
    if not chain:
        raise RobotError(f"frames.last_link = {last_link!r}: no movable joint lies between the base and it")
    for joint in root.findall("joint"):
        if joint.get("type") in MOVING and joint not in chain:
            raise RobotError(
                f"urdf joint {joint.get('name')!r} moves but is not between base and last link: make it fixed"
            )
    return chain


def check_masses(root: ET.Element, chain: Iterable[ET.Element]) -> None:
    """Raise a RobotError where a movable joint moves no mass."""
    tree, heavy = Tree(root), {link.get("name", "") for link in root.findall("link[inertial]")}
    for joint in chain:
        body = tree.reach(end(joint, "child"), fixed=True)
        if not heavy.intersection(body):
            raise RobotError(f"urdf joint {joint.get('name')!r} moves no mass: give link {body[0]!r} an <inertial>")
