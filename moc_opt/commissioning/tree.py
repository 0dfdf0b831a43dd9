"""Which link of a URDF carries which."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Mapping

from moc_opt.errors import RobotError
from moc_opt.robots.rebuild import MOVING

ARM = 5
"""Moving joints in a row that a chain must have to be an arm."""


class LinkTree:
    """The joint that carries each link, and the joints that each link carries.

    Raises:
        RobotError: no single base, or links that hang on one another in a loop.
    """

    def __init__(self, root: ET.Element) -> None:
        self.links = [link.get("name", "") for link in root.findall("link")]
        self.carrier: dict[str, ET.Element] = {}
        self.carried: dict[str, list[ET.Element]] = defaultdict(list)
        for joint in root.findall("joint"):
            self.carrier[end(joint, "child")] = joint
            self.carried[end(joint, "parent")].append(joint)
        bases = [link for link in self.links if link not in self.carrier]
        if len(bases) != 1:
            raise RobotError(f"urdf has {len(bases)} links that hang on no joint {bases[:5]}: one base is needed")
        self.base = bases[0]
        self._check_reached()

    def _check_reached(self) -> None:
        """Raise where links hang on one another in a loop: no way leads to them from the base."""
        waiting, reached = [self.base], {self.base}
        while waiting:
            new = {end(joint, "child") for joint in self.carried[waiting.pop()]} - reached
            waiting += sorted(new)
            reached |= new
        lost = [link for link in self.links if link not in reached]
        if lost:
            raise RobotError(
                f"urdf links {lost[:5]} hang on one another in a loop, not on the base {self.base!r}: mend the "
                "parent of one of their joints"
            )

    def path(self, link: str) -> list[ET.Element]:
        """Return the joints from base to link."""
        found: list[ET.Element] = []
        while link in self.carrier and len(found) <= len(self.links):
            found.append(self.carrier[link])
            link = end(found[-1], "parent")
        return found[::-1]

    def depth(self, link: str, locked: Mapping[str, float]) -> int:
        """Count the most moving joints in a row that hang on this link."""
        return max((moves(j, locked) + self.depth(end(j, "child"), locked) for j in self.carried[link]), default=0)

    def arms(self, locked: Mapping[str, float]) -> list[str]:
        """Return the links at which chains of `ARM` moving joints and more end, the longest chains first.

        A link that only branches of less than `ARM` joints leave is such an end: what they carry are fingers.
        """
        found: list[tuple[int, str]] = []
        waiting = [(self.base, 0)]
        while waiting:
            link, count = waiting.pop()
            ways = [(end(j, "child"), count + moves(j, locked)) for j in self.carried[link]]
            on = [way for way in ways if way[1] > count or self.depth(way[0], locked)]
            longest = max((n - count + self.depth(child, locked) for child, n in on), default=0)
            if on and (len(on) == 1 or longest >= ARM or count < ARM):
                waiting += on
            elif count >= ARM:
                found.append((count, link))
        return [link for _, link in sorted(found, key=lambda each: (-each[0], each[1]))]


def end(joint: ET.Element, which: str) -> str:
    """Return the link at the joint's "parent" or "child" end."""
    found = joint.find(which)
    if found is None or not found.get("link"):
        raise RobotError(f"urdf joint {joint.get('name')!r} has no <{which} link=...>: add it")
    return str(found.get("link"))


def moves(joint: ET.Element, locked: Mapping[str, float]) -> bool:
    """Say whether it is a moving joint that nobody locks."""
    return joint.get("type") in MOVING and joint.get("name") not in locked
