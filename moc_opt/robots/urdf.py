"""A URDF's links and joints as plain data: read, check and write them."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from moc_opt.errors import RobotError, UnknownNameError
from moc_opt.inputs import names
from moc_opt.inputs.files import decimal

MOVING = frozenset({"revolute", "continuous", "prismatic"})
TOOL_LINK, TIP_LINK, WRIST_LINK = "tool", "tip", "wrist"
TOOL_NAMES = {"link": {TOOL_LINK, TIP_LINK, WRIST_LINK}, "joint": {"tool_mount", "tip_frame", "wrist_frame"}}
"""Names of the tool's links and joints. A URDF must not contain them."""
MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
SMALLEST_MASS, SMALLEST_MOMENT = 1e-6, 1e-12
MOST_LINKS = 250  #: Physics engines crash on chains of some thousands of links.
# Let L be the largest principal moment, and S the sum of the other two. L - S may be at most _TRIANGLE * L. `normalize`
# makes S - L at least _FLAT * L. The smallest moment must be at least _THIN * L.
_TRIANGLE, _FLAT, _THIN = 1e-6, 1e-9, 1e-12
SMALLEST = 1e-30  #: Numbers nearer to 0 are read as 0, because some programs refuse them.
LARGEST, LARGEST_MASS, FARTHEST = 1e6, 1e5, 100.0
"""Upper bounds on any number in a file, on a mass [kg], and on an origin's numbers [m, rad]."""

Numbers = tuple[float, ...]
_ZEROS: Numbers = (0.0, 0.0, 0.0)


@dataclass
class Link:
    """A link and its body."""

    name: str
    mass: float = 0.0  #: [kg]
    moments: Numbers = 2 * _ZEROS  #: about the centre of mass, in the order of `MOMENTS` [kg m^2]
    xyz: Numbers = _ZEROS  #: centre of mass [m]
    rpy: Numbers = _ZEROS  #: orientation of the moments' axes [rad]

    @property
    def is_frame(self) -> bool:
        """Whether the link has no mass and no moments."""
        return self.mass == 0.0 and not any(self.moments)

    def thicken(self, added: float) -> None:
        """Add ``added`` to the moments about all three axes [kg m^2]."""
        self.moments = (*(moment + added for moment in self.moments[:3]), *self.moments[3:])


@dataclass
class Joint:
    """A joint between two links."""

    name: str
    kind: str
    parent: str
    child: str
    xyz: Numbers = _ZEROS  #: origin in the parent's frame [m]
    rpy: Numbers = _ZEROS  #: orientation in the parent's frame [rad]
    axis: Numbers = (1.0, 0.0, 0.0)  #: in the joint's own frame
    limits: dict[str, float] = field(default_factory=dict)
    """The URDF's "lower" and "upper" [rad or m], "velocity" [rad/s or m/s] and "effort" [Nm or N]."""
    mimics: bool = False

    @property
    def moves(self) -> bool:
        """Whether the joint turns or slides."""
        return self.kind in MOVING

    def limit(self, lower: float, upper: float, velocity: float, effort: float) -> None:
        """Set all four limits; a continuous joint becomes revolute."""
        self.kind = "revolute" if self.kind == "continuous" else self.kind
        self.limits = {"lower": lower, "upper": upper, "velocity": velocity, "effort": effort}


@dataclass
class Urdf:
    """Links and joints in the file's order."""

    links: list[Link]
    joints: list[Joint]

    def to_text(self, name: str) -> str:
        """Write the URDF as text; numbers keep every bit."""

        def as_text(*values: float) -> str:
            return " ".join(repr(float(value)) for value in values)

        root = ET.Element("robot", name=name)
        for link in self.links:
            made = ET.SubElement(root, "link", name=link.name)
            if not link.is_frame:
                inertial = ET.SubElement(made, "inertial")
                ET.SubElement(inertial, "origin", xyz=as_text(*link.xyz), rpy=as_text(*link.rpy))
                ET.SubElement(inertial, "mass", value=as_text(link.mass))
                ET.SubElement(inertial, "inertia", dict(zip(MOMENTS, map(as_text, link.moments), strict=True)))
        for joint in self.joints:
            made = ET.SubElement(root, "joint", name=joint.name, type=joint.kind)
            ET.SubElement(made, "parent", link=joint.parent)
            ET.SubElement(made, "child", link=joint.child)
            ET.SubElement(made, "origin", xyz=as_text(*joint.xyz), rpy=as_text(*joint.rpy))
            if joint.moves:
                ET.SubElement(made, "axis", xyz=as_text(*joint.axis))
                ET.SubElement(made, "limit", {key: as_text(value) for key, value in joint.limits.items()})
        ET.indent(root)
        return ET.tostring(root, encoding="unicode") + "\n"


def read(text: str) -> Urdf:
    """Read links and joints. Raise a RobotError if the text is no URDF or a number is wrong."""
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise RobotError(f"urdf is not well-formed XML ({error}): expand xacro files and check the line") from error
    if root.tag != "robot":
        raise RobotError(f"urdf root is <{root.tag}>: a URDF begins with <robot>")
    if any("xacro" in element.tag for element in root):
        raise RobotError("urdf is a xacro file: expand it first (xacro FILE > arm.urdf)")
    if (count := len(root.findall("link"))) > MOST_LINKS:
        raise RobotError(f"urdf has {count} links: an arm has {MOST_LINKS} at most")
    return Urdf([_link(each) for each in root.findall("link")], [_joint(each) for each in root.findall("joint")])


def _link(element: ET.Element) -> Link:
    link = Link(element.get("name", ""))
    where = f"link {link.name!r:.80}"
    body = _one(element, "inertial", where)
    if body is not None:
        link.xyz, link.rpy = _place(body, f"<inertial> of {where}")
        (link.mass,) = _numbers(_one(body, "mass", where), "value", f"mass of {where}", 1, LARGEST_MASS)
        inertia = _one(body, "inertia", where)
        link.moments = sum((_numbers(inertia, key, f"{key} of {where}", 1) for key in MOMENTS), ())
    return link


def _joint(element: ET.Element) -> Joint:
    parent, child = (getattr(element.find(which), "attrib", {}).get("link", "") for which in ("parent", "child"))
    joint = Joint(element.get("name", ""), element.get("type", ""), parent, child)
    joint.mimics = element.find("mimic") is not None
    where = f"joint {joint.name!r:.80}"
    axis, limit = (_one(element, tag, where) for tag in ("axis", "limit"))
    joint.xyz, joint.rpy = _place(element, where)
    if axis is not None:
        joint.axis = _numbers(axis, "xyz", f"<axis> of {where}")
    for key in ("lower", "upper", "velocity", "effort"):
        if limit is not None and key in limit.attrib:
            (joint.limits[key],) = _numbers(limit, key, f"<limit> of {where}, {key}", 1, most=math.inf)
    return joint


def _place(element: ET.Element, where: str) -> tuple[Numbers, Numbers]:
    origin, what = _one(element, "origin", where), f"<origin> of {where}"
    xyz, rpy = (_numbers(origin, key, f"{what}, {key}", most=FARTHEST) for key in ("xyz", "rpy"))
    return xyz, rpy


def _one(parent: ET.Element, tag: str, where: str) -> ET.Element | None:
    found = parent.findall(tag)
    if len(found) > 1:
        raise RobotError(f"urdf: {where} has {len(found)} <{tag}>: keep one, since not all programs read the same one")
    return found[0] if found else None


def _numbers(element: ET.Element | None, key: str, what: str, count: int = 3, most: float = LARGEST) -> Numbers:
    text = None if element is None else element.get(key)
    if text is None:
        return (0.0,) * count
    endless = ("inf", "infinity")
    found = tuple(float(part) if part.lower().lstrip("+-") in endless else decimal(part) for part in text.split())
    if len(found) != count or not all(abs(value) <= most for value in found):
        wanted = "three decimal numbers, such as '0 0 0.1'" if count == 3 else "a decimal number"
        raise RobotError(f"urdf: {what} is {text!r:.80}: give {wanted}, of at most {min(most, LARGEST):g}")
    return tuple(0.0 if abs(value) < SMALLEST else value for value in found)


# --- checking ---


def normalize(arm: Urdf) -> Tree:
    """Check a URDF, and return its tree. Raise a RobotError if something is wrong.

    In place, axes are scaled to length 1, and flat bodies become slightly thick.
    """
    for name in [link.name for link in arm.links] + [joint.name for joint in arm.joints]:
        if not names.is_name(name):
            raise RobotError(f"urdf: {name!r:.80} is no name for a link or joint: {names.RULE}")
    for link in arm.links:
        _check_body(link)
    for joint in arm.joints:
        _check_joint(joint)
    return Tree(arm)


def _check_body(link: Link) -> None:
    if link.is_frame:
        return
    fault = inertia_fault(link.moments)
    if link.mass < SMALLEST_MASS:
        fault = f"its mass is {link.mass:g} kg and must be {SMALLEST_MASS:g} or more"
    if fault:
        cure = "correct it (about the centre of mass, in kg and kg m^2), or remove it to make the link a frame"
        raise RobotError(f"urdf link {link.name!r} has an <inertial> that no body can have: {fault}; {cure}")
    # Without this, rounding would decide whether MuJoCo accepts a flat body (largest moment = sum of the other two).
    least, middle, most = principal(link.moments)
    link.thicken(max(_FLAT * most - (least + middle - most), 0.0))


def _check_joint(joint: Joint) -> None:
    where = f"joint {joint.name!r}"
    if joint.kind not in MOVING | {"fixed"}:
        raise RobotError(f"urdf {where} has type {joint.kind!r}: use revolute, prismatic, continuous or fixed")
    if joint.mimics:
        raise RobotError(f"urdf {where} mimics another joint: fix it (`robot new --lock`), or remove its <mimic>")
    if joint.moves:
        length = math.hypot(*joint.axis)
        if length < 1e-3:
            raise RobotError(f"urdf: <axis> of {where} has no length: give a direction, such as '0 0 1'")
        joint.axis = tuple(value / length for value in joint.axis)
    for key, value in joint.limits.items():
        if abs(value) > LARGEST:
            raise RobotError(f"urdf: <limit> of {where}, {key} is {value:g}: give a number up to {LARGEST:g}")


def inertia_fault(moments: Iterable[float]) -> str | None:
    """Say why these `MOMENTS` [kg m^2] are impossible; None if they are possible."""
    least, middle, most = principal(moments)
    if least >= max(SMALLEST_MOMENT, _THIN * most) and least + middle >= most * (1.0 - _TRIANGLE):
        return None
    return (
        f"its principal moments are {least:.4g}, {middle:.4g}, {most:.4g} kg m^2, but each must be at least "
        f"{SMALLEST_MOMENT:g} kg m^2 and {_THIN:g} of the largest, and none may exceed the sum of the other two"
    )


def principal(moments: Iterable[float]) -> list[float]:
    """Return the three principal moments in rising order."""
    xx, yy, zz, xy, xz, yz = moments
    found: list[float] = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).tolist()
    return found


class Tree:
    """The tree of links. Raise a RobotError if the links form no tree.

    ``carrier`` maps a link to the joint whose child it is. ``carried`` maps a link to the joints whose parent it is.
    """

    def __init__(self, arm: Urdf) -> None:
        if not arm.links or not arm.joints:
            raise RobotError("urdf has no <link> or no <joint>: a serial arm is needed")
        for kind, parts in (("link", arm.links), ("joint", arm.joints)):
            name, times = Counter(part.name for part in parts).most_common(1)[0]
            if times > 1:
                raise RobotError(f"urdf has {times} {kind}s named {name!r}: give them different names")
        self.links = [link.name for link in arm.links]
        self.carrier: dict[str, Joint] = {}
        self.carried: dict[str, list[Joint]] = defaultdict(list)
        for joint in arm.joints:
            for link in (joint.parent, joint.child):
                if link not in self.links:
                    raise RobotError(f"urdf joint {joint.name!r} names link {link!r:.80}, which is missing: add it")
            if joint.child in self.carrier:
                other = self.carrier[joint.child].name
                raise RobotError(f"urdf joints {other!r} and {joint.name!r} both carry link {joint.child!r}: keep one")
            if joint.child == "world":
                raise RobotError(f"urdf joint {joint.name!r} carries a link 'world', MuJoCo's base: rename the link")
            self.carrier[joint.child] = joint
            self.carried[joint.parent].append(joint)
        bases = [link for link in self.links if link not in self.carrier]
        if len(bases) > 1:
            raise RobotError(f"urdf links {bases[:5]} hang on no joint: only one may be the base, fix the others to it")
        if lost := sorted(set(self.links).difference(*map(self.reach, bases))):
            raise RobotError(f"urdf joints form a loop: links {lost[:5]} hang on each other and not on a base")
        self.base = bases[0]

    def chain(self, last_link: str, named: str) -> list[Joint]:
        """Return the moving joints from base to link. ``named``: the option or key that gives the link, for errors."""
        if last_link not in self.links:
            raise UnknownNameError(f"link ({named})", last_link, self.links)
        chain = [joint for joint in self.path(last_link) if joint.moves]
        if not chain:
            raise RobotError(f"{named} = {last_link!r}: no joint that moves lies between the base and this link")
        return chain

    def path(self, link: str) -> list[Joint]:
        """Return the joints from base to link."""
        found: list[Joint] = []
        while link in self.carrier:
            found.append(self.carrier[link])
            link = found[-1].parent
        return found[::-1]

    def reach(self, link: str, *, fixed: bool = False) -> list[str]:
        """Return a link and all links that it carries; with ``fixed``, only those reached through fixed joints."""
        found = [link]
        for one in found:  # grows during the iteration
            found += [joint.child for joint in self.carried[one] if not fixed or joint.kind == "fixed"]
        return found
