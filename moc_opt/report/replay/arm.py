"""An arm drawn from its joint frames alone: every part is a body of revolution on one link.

No mesh file is needed, so that any robot that can be loaded can be shown. What is drawn has the arm's lengths
and axes; its thickness is made up, in proportion to its reach.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array

Profile = list[tuple[float, float]]
"""(radius, height) [m], from below to above"""

BASE = -1
SHORTEST_M = 1e-3
ACROSS = 0.7
"""Cosine between a joint's axis and its link, below which the joint looks like an elbow, above like a ring."""


@dataclass(frozen=True)
class Part:
    """A profile turned about an axis; `radii` and `heights` are its points, from below to above."""

    link: int
    """Joint whose frame it rides on, from 0; `BASE` stands still."""
    origin: tuple[float, ...]
    """(3,) where height 0 is, in that frame [m]"""
    axis: tuple[float, ...]
    """(3,) unit vector"""
    radii: tuple[float, ...]
    """[m]"""
    heights: tuple[float, ...]
    """[m]"""
    role: str
    """"shell", "joint" or "tool", which gives its colour."""

    def plain(self) -> dict[str, Any]:
        """Return it as JSON, in micrometres' resolution."""
        numbers = {"origin": self.origin, "axis": self.axis, "radii": self.radii, "heights": self.heights}
        rounded = {key: [round(float(x), 6) for x in values] for key, values in numbers.items()}
        return {"link": self.link, "role": self.role, **rounded}


def arm_parts(robot: RobotModel) -> list[Part]:
    """Build the parts of an arm and its tool."""
    chain, n = robot.chain, robot.n
    tip, wrist = chain.offsets
    along = (tip - wrist) / np.linalg.norm(tip - wrist)
    mount = tip - robot.data.tool_length * along
    ends = [*chain.origins, mount]  # of the piece that begins at the frame before
    reach = float(sum(np.linalg.norm(end) for end in chain.origins))
    radius = np.linspace(0.058, 0.038, n + 1) * reach
    parts = [_turned(BASE, np.zeros(3), np.array([0.0, 0.0, 1.0]), [
        (0.0, 0.0), (1.9 * radius[0], 0.0), (1.9 * radius[0], 0.012 * reach), (1.25 * radius[0], 0.03 * reach),
        (0.0, 0.03 * reach),
    ], "shell")]  # fmt: skip
    lengths = [float(np.linalg.norm(end)) for end in ends]
    last = max(k for k, length in enumerate(lengths) if length > SHORTEST_M)
    for link, end in enumerate(ends, start=BASE):
        length = lengths[link + 1]
        if length > SHORTEST_M:
            shape = _capsule(radius[max(link, 0)], radius[min(link + 1, n - 1)], length, link + 1 < last)
            if link == BASE:
                shape = [(shape[7][0], 0.0), *shape[8:]]  # it stands on the ground
            parts.append(_turned(link, np.zeros(3), end / length, shape, "shell"))
    for j in range(n):
        axis = chain.axes[j]
        # The longer neighbour tells the joint's kind: wrists have links of no length.
        beside = max(ends[j + 1], chain.rotations[j].T @ ends[j], key=lambda end: float(np.linalg.norm(end)))
        length = float(np.linalg.norm(beside))
        across = length > SHORTEST_M and abs(float(axis @ beside)) / length < ACROSS
        r = radius[j]
        if across:
            width = 1.12 * r
            parts.append(_turned(j, np.zeros(3), axis, _drum(1.06 * r, width), "shell"))
            for side in (-1.0, 1.0):
                parts.append(_turned(j, side * width * axis, side * axis, _cap(0.78 * r, 0.10 * r), "joint"))
        else:
            parts.append(_turned(j, np.zeros(3), axis, _drum(1.04 * r, 0.10 * r), "joint"))
    thin = 0.004
    tool = [(0.0, 0.0), (5 * thin, 0.0), (5 * thin, 0.012), (2 * thin, 0.03), (thin, 0.032)]
    length = robot.data.tool_length
    tool = [(r, min(h, 0.5 * length)) for r, h in tool]
    tool += [(thin, length - 0.008), (0.75 * thin, length - 0.003), (0.0, length)]
    parts.append(_turned(n - 1, mount, along, tool, "tool"))
    return parts


def _turned(link: int, origin: Array, axis: Array, profile: Profile, role: str) -> Part:
    radii, heights = zip(*profile, strict=True)
    return Part(link, tuple(origin), tuple(axis), radii, heights, role)


def _capsule(below: float, above: float, length: float, closed: bool) -> Profile:
    """Return a cone from one ball to the next; flat at the flange, where the tool begins."""
    bend = np.linspace(-0.5 * np.pi, 0.0, 8)
    start = [(below * np.cos(a), below * np.sin(a)) for a in bend]
    if closed:
        return start + [(above * np.cos(a), length + above * np.sin(a)) for a in -bend[::-1]]
    return [*start, (above, length), (0.0, length)]


def _drum(radius: float, half: float) -> Profile:
    """Return a cylinder about its middle, its edges broken."""
    edge = 0.15 * min(radius, half)
    side = [(radius - edge, half), (radius, half - edge)]
    return [(0.0, -half), *((r, -h) for r, h in side), *reversed(side), (0.0, half)]


def _cap(radius: float, height: float) -> Profile:
    """Return a lid."""
    return [(radius, 0.0), (radius, 0.6 * height), (0.85 * radius, height), (0.0, height)]
