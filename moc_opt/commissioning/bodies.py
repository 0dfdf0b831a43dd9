"""Mass properties as vendors write them: frames without mass, and bodies that cannot be."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import numpy as np

from moc_opt.robots.numbers import as_text, number
from moc_opt.robots.rebuild import SMALLEST_MASS, SMALLEST_MOMENT, inertia_fault

_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
WATER_KG_M3 = 1000.0


def mend(root: ET.Element, notes: list[str]) -> None:
    """Make every <inertial> one that a body can have, in place.

    - Without mass: it is a frame, and merged into the link it is fixed to.
    - Without inertia: that of a solid sphere of its mass, as dense as water.
    - An inertia that no body has: the smallest sphere's inertia that makes it possible is added.

    Args:
        notes: each change is appended.
    """
    frames = []
    for link in root.findall("link"):
        inertial, name = link.find("inertial"), link.get("name", "")
        if inertial is None:
            continue
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        kilograms = 0.0 if mass is None else number(mass.get("value", ""), f"mass of link {name!r}", "kg")
        if 0.0 <= kilograms < SMALLEST_MASS:
            link.remove(inertial)
            frames.append(name)
            continue
        moments = [0.0] * 6
        if inertia is not None:
            moments = [number(inertia.get(key, "0"), f"inertia of link {name!r}", "kg m^2") for key in _MOMENTS]
        fault = inertia_fault(moments)
        if fault is None:
            continue
        if max(abs(moment) for moment in moments) < SMALLEST_MOMENT:
            radius = (3.0 * kilograms / (4.0 * math.pi * WATER_KG_M3)) ** (1.0 / 3.0)
            added = max(0.4 * kilograms * radius**2, 10.0 * SMALLEST_MOMENT)
            notes.append(f"link {name!r} ({kilograms:.3g} kg) has no inertia: that of a ball of water is taken")
        else:
            added = _lacking(moments)
            notes.append(f"link {name!r} has an inertia that no body has, {fault}: {added:.3g} kg m^2 is added")
        for old in inertial.findall("inertia"):
            inertial.remove(old)
        moments = [moment + added * (k < 3) for k, moment in enumerate(moments)]
        values = {key: as_text(value) for key, value in zip(_MOMENTS, moments, strict=True)}
        ET.SubElement(inertial, "inertia", values)
    if frames:
        notes.append(f"frames without mass, merged into what they are fixed to: {', '.join(frames)}")


def _lacking(moments: list[float]) -> float:
    """Return what must be added to the three moments so that a body can have them."""
    xx, yy, zz, xy, xz, yz = moments
    least, middle, most = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    needed = max(most - least - middle, 1e-3 * most - least, 10.0 * SMALLEST_MOMENT - least)
    return float(needed * (1.0 + 1e-6) + 1e-12)
