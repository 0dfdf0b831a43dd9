"""Which link of a URDF carries which, and which of them carries the tool."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Mapping

from moc_opt.errors import RobotError
from moc_opt.robots.rebuild import MOVING
from moc_opt.robots.urdf import end

FINGERS = 2
"""Moving joints in a row that a branch may have to count as a finger."""
ARM = 5
"""Moving joints in a row that a chain must have to be an arm."""
_JAW = re.compile("grip|finger|jaw", re.IGNORECASE)


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


def moves(joint: ET.Element, locked: Mapping[str, float]) -> bool:
    """Say whether it is a moving joint that nobody locks."""
    return joint.get("type") in MOVING and joint.get("name") not in locked


def last_link(tree: LinkTree, locked: Mapping[str, float], notes: list[str]) -> str:
    """Follow the one long chain from the base to where fingers branch off, or to its end.

    Raises:
        RobotError: two chains of more than `FINGERS` joints leave one link.
    """
    link, joints = tree.base, 0
    while True:
        branches = [j for j in tree.carried[link] if moves(j, locked) or tree.depth(end(j, "child"), locked)]
        depths = [moves(j, locked) + tree.depth(end(j, "child"), locked) for j in branches]
        if not branches:
            break
        if len(branches) > 1:
            long = [j for j, depth in zip(branches, depths, strict=True) if depth > FINGERS]
            if not long and joints >= FINGERS:
                notes.append(f"the chain ends at {link!r}, where {len(branches)} fingers branch off")
                return link
            if len(long) != 1:
                ends = [end(j, "child") for j in (long or branches)]
                arms = tree.arms(locked)[:8]
                raise RobotError(
                    f"urdf: {len(ends)} chains leave link {link!r}, towards {ends[:6]}: say with --tip which link "
                    f"carries the tool{f', such as {arms}' if arms else ''}"
                )
            branches = long
        joints += moves(branches[0], locked)
        link = end(branches[0], "child")
    last = next((j for j in reversed(tree.path(link)) if moves(j, locked)), None)
    if last is not None and joints > 1 and _JAW.search(f"{last.get('name')} {end(last, 'child')}"):
        link = end(last, "parent")
        notes.append(f"{last.get('name')!r} is taken for the jaw of a gripper: the chain ends before it, at {link!r}")
        return link
    # Behind the last moving joint only frames are left: the flange is the one that is named so, else the link itself.
    reached = [link]
    for found in reached:
        reached += [end(joint, "child") for joint in tree.carried[found]]
    for word in ("tool0", "flange", "link8", "end_effector", "link_ee", "ee_link", "eef"):
        for found in reached:
            if found.endswith(word):
                notes.append(f"last link: {found!r}, the flange by its name")
                return found
    notes.append(f"last link: {link!r}, carried by the last moving joint")
    return link
