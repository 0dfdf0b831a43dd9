"""Turn a vendor's URDF into one serial arm, and note every change."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin

from moc_opt.errors import RobotError, UnknownNameError, named
from moc_opt.inputs.files import read_text
from moc_opt.robots import urdf
from moc_opt.robots.model import RobotModel
from moc_opt.robots.urdf import Joint, Link, Urdf

FINGERS = 2  #: A branch with at most this many moving joints is a finger, not the arm.
FASTEST = {"turning": 2.0 * math.pi, "sliding": 2.0}
"""Largest plausible joint speeds [rad/s, m/s]."""
CHOSEN = {"turning": 2.0, "sliding": 0.5}  #: Speed limits that replace missing or implausible ones [rad/s, m/s].
TRAVEL_M = 0.5  #: A sliding joint without limits gets this range to either side.
_STRONGEST = {"turning": 2000.0, "sliding": 20000.0}  # largest plausible effort [Nm, N]
_UNITS = {"turning": ("rad", "rad/s"), "sliding": ("m", "m/s")}


@dataclass
class VendorArm:
    """A serial arm, in which joints outside its chain are fixed."""

    urdf: Urdf
    notes: list[str]  #: Assumptions and changes.
    last_link: str = ""
    chain: list[Joint] = field(default_factory=list)  #: Moving joints from base to last link.
    weak: list[str] = field(default_factory=list)  #: Names of the chain's joints that have no usable effort limit.


def read_vendor(
    path: Path, *, tip: str | None = None, lock: Mapping[str, float] | None = None,
    base_rpy: urdf.Numbers = (0.0, 0.0, 0.0),
) -> VendorArm:  # fmt: skip
    """Read a URDF as a serial arm. Implausible masses and limits are replaced.

    Arguments and errors are those of `new.new_robot`.
    """
    text = read_text(path, "urdf", RobotError)
    with named(f"{path}:"):
        return _serial_arm(text, tip, lock or {}, base_rpy)


def _serial_arm(text: str, tip: str | None, lock: Mapping[str, float], base_rpy: urdf.Numbers) -> VendorArm:
    arm = VendorArm(urdf.read(text), [])
    joints = {joint.name: joint for joint in arm.urdf.joints}
    _rename(arm)
    for name, value in lock.items():
        if name not in joints or not joints[name].moves:
            raise UnknownNameError("joint (--lock)", name, [name for name, joint in joints.items() if joint.moves])
        _fix([joints[name]], arm.notes, at=value)
    tree = urdf.Tree(arm.urdf)
    arm.last_link = _last_link(tree) if tip is None else tip
    arm.chain = tree.chain(arm.last_link, "--tip")
    arm.notes.append(f"the tool sits on {arm.last_link!r}, the link of {'--tip' if tip else 'the last joint'}")
    mend_bodies(arm.urdf.links, arm.notes)
    # Only joints outside the chain are fixed. In the chain, `normalize` refuses unknown kinds of joints.
    between = tree.path(arm.last_link)[len(tree.path(arm.chain[0].parent)) :]
    _fix([joint for joint in arm.urdf.joints if joint not in between and joint.kind != "fixed"], arm.notes)
    if any(base_rpy):
        arm.urdf.links.insert(0, Link("stand"))
        arm.urdf.joints.append(Joint("stand_joint", "fixed", "stand", tree.base, rpy=base_rpy))
        arm.notes.append(f"the base is turned by {', '.join(f'{a:g}' for a in base_rpy)} rad about x, y, z")
    arm.weak = _choose_limits(arm.chain, arm.notes)
    urdf.normalize(arm.urdf)
    return arm


def _rename(arm: VendorArm) -> None:
    for kind, parts in (("link", arm.urdf.links), ("joint", arm.urdf.joints)):
        for part in parts:
            if part.name in urdf.TOOL_NAMES[kind] | {"world"}:
                old, part.name = part.name, f"{part.name}_{kind}"
                arm.notes.append(f"{kind} {old!r} is renamed to {part.name!r}: the old name is reserved")
                for joint in arm.urdf.joints if kind == "link" else ():
                    joint.parent = part.name if joint.parent == old else joint.parent
                    joint.child = part.name if joint.child == old else joint.child


def _last_link(tree: urdf.Tree) -> str:
    link, last = tree.base, None
    while branches := [joint for joint in tree.carried[link] if _depth(tree, joint)]:
        if len(branches) > 1:
            long = [joint for joint in branches if _depth(tree, joint) > FINGERS]
            if not long and last is not None:
                break
            if len(long) != 1:
                raise RobotError(
                    f"urdf: {len(branches)} chains leave link {link!r}, towards {[j.child for j in branches][:6]}: say "
                    "with --tip which link carries the tool"
                )
            branches = long
        link = branches[0].child
        last = branches[0] if branches[0].moves else last
    if last is None:
        raise RobotError("urdf: no joint moves: a serial arm is needed")
    return last.child


def _depth(tree: urdf.Tree, joint: Joint) -> int:
    """Return the largest number of moving joints on a path from ``joint`` outwards, itself included."""
    return joint.moves + max((_depth(tree, other) for other in tree.carried[joint.child]), default=0)


def _fix(joints: Iterable[Joint], notes: list[str], at: float | None = None) -> None:
    fixed = []
    for joint in joints:
        told = joint.kind
        if joint.moves:
            reach = {} if joint.kind == "continuous" else joint.limits
            value = min(max(0.0, reach.get("lower", -math.inf)), reach.get("upper", math.inf)) if at is None else at
            _shift(joint, value)
            told = f"at {value:.3g} {'m' if joint.kind == 'prismatic' else 'rad'}"
        fixed.append(f"{joint.name} ({told})")
        joint.kind, joint.mimics, joint.limits = "fixed", False, {}
    if fixed:
        notes.append(f"fixed: {', '.join(fixed)}")


def _shift(joint: Joint, value: float) -> None:
    if value == 0.0:
        return
    R, motion = pin.rpy.rpyToMatrix(*joint.rpy), value * np.array(joint.axis) / np.linalg.norm(joint.axis)
    if joint.kind == "prismatic":
        joint.xyz = tuple((np.array(joint.xyz) + R @ motion).tolist())
    else:
        joint.rpy = tuple(pin.rpy.matrixToRpy(R @ pin.exp3(motion)).tolist())


# --- implausible numbers ---


def mend_bodies(links: Iterable[Link], notes: list[str]) -> None:
    """Make every body physically possible, in place, and note each change."""
    frames = []
    for link in links:
        if link.is_frame:
            continue
        if 0.0 <= link.mass < urdf.SMALLEST_MASS:
            link.mass, link.moments = 0.0, (0.0,) * 6
            frames.append(link.name)
        elif fault := urdf.inertia_fault(link.moments):
            least, middle, most = urdf.principal(link.moments)
            lacking = max(most - least - middle, 1e-3 * most - least, 10.0 * urdf.SMALLEST_MOMENT - least)
            added = lacking * (1.0 + 1e-6) + 1e-12
            notes.append(f"link {link.name!r} has an inertia that no body has: {fault}; {added:.3g} kg m^2 is added")
            link.thicken(added)
    if frames:
        notes.append(f"links without mass become mere frames: {', '.join(frames)}")


def _choose_limits(joints: Iterable[Joint], notes: list[str]) -> list[str]:
    weak = []
    for joint in joints:
        kind = "sliding" if joint.kind == "prismatic" else "turning"
        lower, upper, change = _range(joint, kind)
        if change:
            notes.append(f"{joint.name} {change}")
        speed, effort, unit = joint.limits.get("velocity", 0.0), joint.limits.get("effort", 0.0), _UNITS[kind][1]
        if not 0.0 < speed <= FASTEST[kind]:
            why = f"{speed:g} {unit} is not a plausible speed limit" if speed else "no speed limit"
            notes.append(f"{joint.name}: {why}: {CHOSEN[kind]:g} {unit} is used; see the data sheet")
            speed = CHOSEN[kind]
        if not 0.0 < effort <= _STRONGEST[kind]:
            weak.append(joint.name)
            effort = 1e3  # a placeholder until the arm's weight is known
        joint.limit(lower, upper, speed, effort)
    return weak


def _range(joint: Joint, kind: str) -> tuple[float, float, str]:
    """Return the joint's range, and why it differs from the URDF's range, or ""."""
    lower, upper = joint.limits.get("lower", 0.0), joint.limits.get("upper", 0.0)
    if joint.kind == "continuous":
        return -math.pi, math.pi, "turns without end: +-180 deg is used"
    if lower > upper:
        raise RobotError(
            f"urdf joint {joint.name!r}: lower = {lower:g} lies above upper = {upper:g}: are they exchanged? Give the "
            f"range of the data sheet in {_UNITS[kind][0]}, the smaller number as lower"
        )
    if kind == "sliding":
        good = -100.0 <= lower < upper <= 100.0
        return (lower, upper, "") if good else (-TRAVEL_M, TRAVEL_M, f"has no range: +-{TRAVEL_M} m is used")
    if 0.0 < upper - lower <= 2.0 * math.pi + 1e-6:
        return lower, upper, ""
    middle = 0.5 * (lower + upper)
    middle = middle if abs(middle) < 2.0 * math.pi else 0.0
    told = f"goes from {lower:g} to {upper:g} rad, not a plausible range (are these degrees? see the data sheet)"
    return middle - math.pi, middle + math.pi, f"{told}: one turn is used"


def enough_efforts(robot: RobotModel) -> list[float]:
    """Return effort limits [Nm, N]: 3 max(gravity load, effort for 1 rad/s^2 or 1 m/s^2), but at least 5."""
    poses = np.random.default_rng(0).uniform(robot.q_min, robot.q_max, (200, robot.n))
    most = np.max([np.abs(robot.gravity(q)) for q in poses], axis=0)
    needed = 3.0 * np.maximum(most, np.diag(robot.state(robot.data.q_home).M))
    return [max(5.0, float(f"{effort:.2g}")) for effort in needed]
