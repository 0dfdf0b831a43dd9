"""A URDF written again from the numbers that were read, so that both engines get the same numbers, and nothing else."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections import Counter, defaultdict
from collections.abc import Iterable

import numpy as np

from moc_opt.errors import RobotError
from moc_opt.inputs import names
from moc_opt.robots.numbers import as_text, number, triple

MOVING = frozenset({"revolute", "continuous", "prismatic"})
MOST_LINKS = 500
"""Engines walk a tree by recursion: MuJoCo stops at a depth of 1000, and some thousands end the process."""
SMALLEST_MASS, SMALLEST_MOMENT = 1e-6, 1e-12
_TRIANGLE, _FLAT, _THIN = 1e-6, 1e-9, 1e-12  # of the largest moment: files round their numbers
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_ATTRIBUTES = {
    "origin": {"xyz", "rpy"}, "mass": {"value"}, "inertia": set(_MOMENTS), "axis": {"xyz"}, "parent": {"link"},
    "child": {"link"},
}  # fmt: skip


def rebuild(root: ET.Element, name: str) -> ET.Element:
    """Copy links and joints, with every number read and written by us; shapes and all else stay behind.

    Args:
        root: a <robot>, as parsed.
        name: of the robot.

    Raises:
        RobotError: a name that is none or that is taken, a number that is none, an element that is missing or there
            twice, an inertia that no body has, or links and joints that are no tree.
    """
    count = max(len(root.findall(tag)) for tag in ("link", "joint"))
    if count > MOST_LINKS:
        raise RobotError(f"urdf has {count} links or joints: an arm has {MOST_LINKS} at most; leave others out")
    made = ET.Element("robot", name=name)
    for element in root:
        if element.tag == "link":
            made.append(_link(element))
        elif element.tag == "joint":
            made.append(_joint(element))
    _check_tree(made)
    return made


def inertia_fault(moments: Iterable[float]) -> str | None:
    """Say why no body has this inertia about its centre of mass; None if one may.

    It must be positive definite, and no principal moment may be larger than the other two together.

    Args:
        moments: ixx, iyy, izz, ixy, ixz, iyz [kg m^2].
    """
    least, middle, most = _principal(moments)
    shown = f"principal moments {least:.4g}, {middle:.4g}, {most:.4g} kg m^2"
    if least < max(SMALLEST_MOMENT, _THIN * most):
        return f"it is not positive definite ({shown}; {SMALLEST_MOMENT:g}, or {_THIN:g} of the largest, is the least)"
    if least + middle < most * (1.0 - _TRIANGLE):
        return f"the largest of its {shown} is more than the other two together (triangle inequality)"
    return None


def _principal(moments: Iterable[float]) -> tuple[float, float, float]:
    """Return the principal moments in rising order."""
    xx, yy, zz, xy, xz, yz = moments
    least, middle, most = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).tolist()
    return least, middle, most


def _off_the_edge(moments: dict[str, float]) -> dict[str, float]:
    """Give a flat body a thickness of 1e-9: as it is, rounding decides whether MuJoCo takes it."""
    least, middle, most = _principal(moments.values())
    lacking = _FLAT * most - (least + middle - most)
    if lacking <= 0.0:
        return moments
    return {key: value + lacking if key in ("ixx", "iyy", "izz") else value for key, value in moments.items()}


def _link(link: ET.Element) -> ET.Element:
    name = _checked(link, "link")
    made = ET.Element("link", name=name)
    inertial = _one(link, "inertial", f"link {name!r}")
    if inertial is None:
        return made
    where = f"<inertial> of link {name!r}"
    origin, mass, inertia = (_one(inertial, tag, where) for tag in ("origin", "mass", "inertia"))
    if mass is None or inertia is None:
        raise RobotError(f"urdf link {name!r} has an <inertial> without <mass> or <inertia>: add it or drop <inertial>")
    kilograms = number(mass.get("value", ""), f"mass of link {name!r}", "kg")
    moments = {key: number(inertia.get(key, "0"), f"inertia {key} of link {name!r}", "kg m^2") for key in _MOMENTS}
    if kilograms == 0.0 and not any(moments.values()):
        return made  # how many vendors write a frame
    if kilograms < SMALLEST_MASS:
        raise RobotError(
            f"urdf link {name!r} has mass {kilograms:g}: it must be positive, {SMALLEST_MASS:g} kg or more; drop "
            "<inertial> for a massless frame"
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
    name, kind = _checked(joint, "joint"), joint.get("type")
    where = f"joint {name!r}"
    if kind not in MOVING | {"fixed"}:
        raise RobotError(f"urdf joint {name!r} has type {kind!r}: use revolute, prismatic, continuous or fixed")
    if joint.find("mimic") is not None:
        raise RobotError(f"urdf joint {name!r} mimics another: make it fixed or free")
    made = ET.Element("joint", name=name, type=kind)
    for end in ("parent", "child"):
        element = _one(joint, end, where)
        if element is None or not element.get("link"):
            raise RobotError(f"urdf joint {name!r} has no <{end} link=...>: add it")
        ET.SubElement(made, end, link=str(element.get("link")))
    _place(made, _one(joint, "origin", where), where)
    axis, limit = _one(joint, "axis", where), _one(joint, "limit", where)
    if kind in MOVING:
        ET.SubElement(made, "axis", xyz=as_text(*_direction(axis, where)))
        if limit is not None:
            # `urdf.limits` reads these texts where they are needed, and `urdf.write_limits` replaces all of them.
            made.append(ET.Element("limit", limit.attrib))
    return made


def _direction(axis: ET.Element | None, where: str) -> tuple[float, ...]:
    """Return the axis at length one; a joint without one turns about x, as URDF has it."""
    if axis is None:
        return (1.0, 0.0, 0.0)
    vector = triple(axis, "xyz", f"<axis> of {where}, xyz", "1")
    length = math.hypot(*vector)
    if length < 1e-3:
        raise RobotError(f"urdf: <axis> of {where} is {axis.get('xyz')!r}: give a direction, such as '0 0 1'")
    return tuple(value / length for value in vector)


def _place(parent: ET.Element, origin: ET.Element | None, where: str) -> None:
    xyz = triple(origin, "xyz", f"<origin> of {where}, xyz", "m")
    rpy = triple(origin, "rpy", f"<origin> of {where}, rpy", "rad")
    ET.SubElement(parent, "origin", xyz=as_text(*xyz), rpy=as_text(*rpy))


def _one(parent: ET.Element, tag: str, where: str) -> ET.Element | None:
    """Return the element, with no attribute that would be left out unheard; None where it is not there."""
    found = [element for element in parent if str(element.tag).lower() == tag]
    if len(found) > 1:
        raise RobotError(f"urdf {where} has {len(found)} <{tag}>: leave one, readers differ in which they take")
    if not found:
        return None
    element, known = found[0], _ATTRIBUTES.get(tag)
    unknown = sorted(set(element.attrib) - known) if known is not None else []
    if element.tag != tag or unknown:
        raise RobotError(
            f"urdf {where} has <{' '.join([str(element.tag), *unknown])[:80]}>: write <{tag}> in small letters, with "
            f"{', '.join(sorted(known or ())) or 'its own attributes'} alone"
        )
    return found[0]


def _checked(element: ET.Element, what: str) -> str:
    try:
        return names.checked(element.get("name", ""))
    except ValueError as error:
        raise RobotError(f"urdf: the name of a {what}, {error}") from error


def _check_tree(root: ET.Element) -> None:
    """Check that there is one base, every other link on one joint, and every end of a joint a link."""
    if root.find("link") is None or root.find("joint") is None:
        raise RobotError("urdf has no <link> or no <joint>: a serial arm is needed")
    for tag in ("link", "joint"):
        name, times = Counter(element.get("name", "") for element in root.findall(tag)).most_common(1)[0]
        if times > 1:
            raise RobotError(f"urdf has {times} {tag}s named {name!r}: give each a name of its own")
    links = {link.get("name", "") for link in root.findall("link")}
    carried: dict[str, str] = {}
    carries: dict[str, list[str]] = defaultdict(list)
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        for end in ("parent", "child"):
            link = joint.find(end).get("link", "")  # type: ignore[union-attr]
            if link not in links:
                raise RobotError(f"urdf joint {name!r} has <{end} link={link!r:.80}>: there is no such link; add it")
        if link in carried:
            raise RobotError(f"urdf joints {carried[link]!r} and {name!r} both carry link {link!r}: leave one of them")
        carried[link] = name
        carries[joint.find("parent").get("link", "")].append(link)  # type: ignore[union-attr]
    if "world" in carried:
        raise RobotError(
            f"urdf joint {carried['world']!r} carries a link 'world', which MuJoCo takes for the base: rename it"
        )
    bases = sorted(links - set(carried))
    if len(bases) > 1:
        raise RobotError(f"urdf links {bases[:5]} hang on no joint: one base is needed, fix the others to it")
    reached = list(bases)
    for link in reached:  # grows while it is walked
        reached += carries[link]
    lost = sorted(links - set(reached))
    if lost:
        raise RobotError(f"urdf joints form a loop at links {lost[:5]}: they hang on each other and not on a base")
