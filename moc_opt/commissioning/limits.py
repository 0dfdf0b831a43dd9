"""Joint limits as vendors write them: missing, endless or absurd ones are replaced, and noted."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from moc_opt.commissioning.vendor import VendorArm, chain_joints
from moc_opt.errors import RobotError
from moc_opt.model.robot_model import RobotModel
from moc_opt.robots import urdf

FASTEST = {"turning": 2.0 * math.pi, "sliding": 2.0}
"""Joint speeds above it are no arm's [rad/s, m/s]: a public file of the iiwa says 10 rad/s, its maker 1.5 to 2.4."""
CHOSEN = {"turning": 2.0, "sliding": 0.5}
"""The speed that is taken in place of a missing or absurd one."""
STRONGEST = {"turning": 2000.0, "sliding": 20000.0}
"""Nm, N."""
TRAVEL_M = 0.5
"""Range of a sliding joint without limits, to both sides [m]."""
_DEGREES = 40.0
"""A range [rad] beyond it is one of degrees: six turns are the most that an arm's joint has."""
_PLACEHOLDER = 1e3
_POSES = 200


class Unit(NamedTuple):
    """How a joint's numbers are written."""

    kind: str
    position: str
    speed: str
    effort: str


TURNING, SLIDING = Unit("turning", "rad", "rad/s", "Nm"), Unit("sliding", "m", "m/s", "N")


def choose_limits(arm: VendorArm) -> list[str]:
    """Give every joint of the chain a finite range, a speed and an effort, in place; changes are noted.

    Raises:
        RobotError: a joint's lower limit lies above its upper one; which range is meant is not for us to choose.

    Returns:
        Joints without a usable effort: `choose_efforts` finds theirs when the arm's weight is known.
    """
    weak = []
    for joint in chain_joints(arm):
        name, unit = joint.get("name", ""), SLIDING if joint.get("type") == "prismatic" else TURNING
        given = urdf.limits(joint)
        lower, upper = _range(name, joint.get("type") == "continuous", unit, given, arm.notes)
        speed = given.get("velocity", 0.0)
        if not 0.0 < speed <= FASTEST[unit.kind]:
            arm.notes.append(
                f"{name}: {f'{speed:g} {unit.speed} is no speed of an arm' if speed else 'no speed limit'}: "
                f"{CHOSEN[unit.kind]:g} {unit.speed} is taken; see the data sheet"
            )
            speed = CHOSEN[unit.kind]
        effort = given.get("effort", 0.0)
        if not 0.0 < effort <= STRONGEST[unit.kind]:
            weak.append(name)
            effort = _PLACEHOLDER
        urdf.write_limits(joint, lower, upper, speed, effort)
    return weak


def _range(name: str, endless: bool, unit: Unit, given: dict[str, float], notes: list[str]) -> tuple[float, float]:
    lower, upper = given.get("lower", 0.0), given.get("upper", 0.0)
    if lower > upper and not endless:
        raise RobotError(
            f"urdf joint {name!r}: lower = {lower:g} lies above upper = {upper:g}: are they exchanged? Give the range "
            f"of the data sheet in {unit.position}, the smaller number as lower"
        )
    if unit is SLIDING:
        if lower < upper <= 100.0:
            return lower, upper
        notes.append(f"{name}: no range: +-{TRAVEL_M} m is taken")
        return -TRAVEL_M, TRAVEL_M
    if endless or not lower < upper:
        notes.append(f"{name} {'turns without end' if endless else 'has no range'}: +-180 deg is taken")
        return -math.pi, math.pi
    if upper - lower > _DEGREES:
        notes.append(
            f"{name}: {lower:g} to {upper:g} {unit.position} is no range of a joint (are they degrees?): +-180 deg is "
            "taken; see the data sheet"
        )
        return -math.pi, math.pi
    if upper - lower > 2.0 * math.pi + 1e-6:
        middle = 0.0 if lower <= -math.pi and upper >= math.pi else 0.5 * (lower + upper)
        notes.append(f"{name}: {math.degrees(upper - lower):.0f} deg of range are cut to one turn")
        return middle - math.pi, middle + math.pi
    return lower, upper


def choose_efforts(robot: RobotModel, weak: list[str]) -> dict[str, float]:
    """Choose efforts [Nm, N] for joints whose file names none: three times the most that gravity asks for.

    Args:
        robot: the arm, with its tool.

    Returns:
        Joint -> effort, two digits, at least 5.
    """
    rng = np.random.default_rng(0)
    poses = rng.uniform(robot.q_min, robot.q_max, (_POSES, robot.n))
    most = np.max([np.abs(robot.gravity(q)) for q in poses], axis=0)
    inertia = np.diag(robot.state(robot.data.q_home).M)
    needed = dict(zip(robot.data.joint_names, 3.0 * np.maximum(most, inertia), strict=True))
    return {name: max(5.0, float(f"{needed[name]:.2g}")) for name in weak}
