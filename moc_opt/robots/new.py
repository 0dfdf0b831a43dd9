"""Make a robot file (TOML and URDF) from a vendor's URDF."""

from __future__ import annotations

import math
import re
import tempfile
import textwrap
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from jinja2 import Environment, PackageLoader, StrictUndefined

from moc_opt.arrays import Array
from moc_opt.errors import MocOptError, RobotError, printable
from moc_opt.inputs.files import check_replaceable, write_whole
from moc_opt.planning.self_motion import freedoms, limit_shares, require_freedom, self_motion
from moc_opt.robots.gains import derived_gains
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.robots.vendor import VendorArm, enough_efforts, read_vendor
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.layout import lay_out

DRAWS = 6000  #: Number of random poses from which the home pose is chosen.
SHORTLIST = 60  #: Largest number of poses whose self-motions are scanned.
DOWN = (0.94, 0.8, -1.0)  #: Cosines of the tool's largest angle from straight down, tried in turn: 20, 37 and 180 deg.
CLEARANCE_M = 0.05  #: Smallest distance of tip and wrist from the base's plane.
MARGIN = 0.2  #: Smallest distance from a joint limit, divided by half the range.
REGULAR = (0.15, 0.08)
"""Smallest ratios of singular values at home: `Freedoms.tip` and `Freedoms.both` of planning/self_motion.py."""
SHARE = (0.7, 0.9)
"""Wanted range of mu / (largest mu on the self-motion) at home. Below 1, so that mu can rise."""


class NewRobot(NamedTuple):
    """The written files, their robot, and the notes in the TOML."""

    toml: Path
    urdf: Path
    robot: RobotModel
    notes: list[str]


def new_robot(
    source: Path, out: Path, *, tip: str | None = None, tool_m: float = 0.30,
    lock: Mapping[str, float] | None = None, base_rpy: tuple[float, float, float] = (0.0, 0.0, 0.0), seed: int = 0,
) -> NewRobot:  # fmt: skip
    """Write ``out`` (a TOML) and a URDF beside it, from the vendor's URDF ``source``.

    Args:
        tip: the link that carries the tool, by default the link beyond the last moving joint.
        tool_m: length of the tool [m].
        lock: joints to be fixed, each with its position [rad, m].
        base_rpy: roll, pitch, yaw of the base [rad]; with (pi, 0, 0) the arm hangs from the ceiling.
        seed: seed of the search for a home pose.

    Raises:
        RobotError: the file is no serial arm, no null space is left, or an output file exists.
        UnknownNameError: ``tip`` or a joint of ``lock`` is not in the file.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,99}\.toml", out.name):
        raise RobotError(f"--out {out.name!r}: the robot gets this name: give letters, digits, _ and -, then .toml")
    for option, value, least, most in (
        ("tool", tool_m, 1e-3, 10.0), ("seed", seed, 0, 2**63), *(("base-rpy", angle, -10, 10) for angle in base_rpy),
        *((f"lock {joint}", place, -1e3, 1e3) for joint, place in (lock or {}).items()),
    ):  # fmt: skip
        if not least <= value <= most:
            raise RobotError(f"--{option} {value:g}: give a number from {least:g} to {most:g}")
    beside = out.with_suffix(".urdf")
    for file in (out, beside):
        if file.exists():
            raise RobotError(f"{str(file)!r} exists: choose another --out, or move this file away")
        check_replaceable(file, "robot file", RobotError)
    arm, name = read_vendor(source, tip=tip, lock=lock, base_rpy=base_rpy), out.stem
    shaft = find_shaft(arm.urdf.to_text(name), arm.last_link)
    arm.notes.append(shaft.note)

    def write(path: Path, q: Array, **more: Any) -> RobotModel:
        write_whole(path.with_suffix(".urdf"), arm.urdf.to_text(name), "robot file", RobotError)
        toml = _FORM.get_template("new.toml.jinja").render(
            {"home": None, "gains": None, **more}, name=name, notes=arm.notes, last_link=arm.last_link, shaft=shaft,
            tool_m=tool_m, q=q, drives=_drives(arm), slides="prismatic" in {joint.kind for joint in arm.chain},
        )  # fmt: skip
        write_whole(path, toml, "robot file", RobotError)
        return load_robot(path)

    middle = np.array([min(max(0.0, joint.limits["lower"]), joint.limits["upper"]) for joint in arm.chain])
    with tempfile.TemporaryDirectory(prefix="moc-opt-") as folder:
        draft = Path(folder, out.name)
        robot = write(draft, middle)
        require_freedom(robot)
        if arm.weak:
            for joint, effort in zip(arm.chain, enough_efforts(robot), strict=True):
                joint.limits["effort"] = effort if joint.name in arm.weak else joint.limits["effort"]
            weak = ", ".join(arm.weak)
            arm.notes.append(f"{weak}: no usable torque limit: a limit is derived from the arm's masses")
            robot = write(draft, middle)
        home = search_home(robot, seed=seed)
        gains = derived_gains(write(draft, home.q))
    if home.task:
        arm.notes.append(f"the default task cannot be done from the home pose: {home.task}")
    robot = write(out, home.q, home=home, gains=gains)
    return NewRobot(out, beside, robot, arm.notes)


def _drives(arm: VendorArm) -> dict[str, list[float]]:
    # Vendors do not publish rotor inertia and friction. Both are guessed from the torque limit.
    rotors, friction = [], []
    for joint in arm.chain:
        effort, sliding = joint.limits["effort"], joint.kind == "prismatic"
        rotors.append(float(f"{0.04 * effort if sliding else 0.2 * min(1.0, effort / 10.0):.2g}"))
        friction.append(float(f"{0.008 * effort if sliding else min(1.0, 0.008 * effort):.2g}"))
    return {
        "rotor_inertia_kg_m2": rotors, "viscous_friction_Nm_s_per_rad": friction, "coulomb_friction_Nm": friction,
    }  # fmt: skip


def _numbers(values: float | Iterable[float]) -> str:
    if isinstance(values, float):
        return repr(values)
    return f"[{', '.join(repr(round(float(value), 12) + 0.0) for value in values)}]"


def _comment(note: str) -> str:
    return textwrap.fill(printable(note), 112, initial_indent="# - ", subsequent_indent="#   ")


_FORM = Environment(
    loader=PackageLoader("moc_opt", "robots"), trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    undefined=StrictUndefined,
)  # fmt: skip
_FORM.filters.update(numbers=_numbers, comment=_comment)


# --- where the tool sits ---


class Shaft(NamedTuple):
    """The tool's place in the last link's frame; rpy turns the frame's z into the tool's direction."""

    wrist: Array  #: (3,) wrist centre, a point of the shaft [m]
    mount: Array  #: (3,) where the tool begins [m]
    rpy: tuple[float, float, float]  #: [rad]
    note: str


def find_shaft(text: str, last_link: str) -> Shaft:
    """Choose the line of the tool's shaft, and the wrist on it.

    If the last joint turns, the shaft is parallel to its axis and points away from the arm. Of the other turning axes,
    the last one that is not parallel to the shaft determines the wrist: the shaft's point nearest to this axis. If
    there is no such axis, or if this point is ahead of the mount, the wrist is the mount. If the last joint slides, the
    shaft runs along the last link's z, and the wrist is the mount.
    """
    model = pin.buildModelFromXML(text)
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    pin.updateFramePlacements(model, data)
    place = data.oMf[model.getFrameId(last_link, pin.FrameType.BODY)]
    origin, z = place.translation.copy(), place.rotation[:, 2]
    axes = data.J.reshape(6, -1)[3:].T  # J is a vector if n = 1; sliding joints have zero rows
    lines = [(data.oMi[j + 1].translation, axis) for j, axis in enumerate(axes) if np.linalg.norm(axis) > 0.5]
    direction, foot, note = z, origin, "the last joint slides: the tool runs along z of the last link"
    if np.linalg.norm(axes[-1]) > 0.5:
        point, axis = lines[-1]
        crossing = [line for line in lines[:-1] if np.linalg.norm(np.cross(line[1], axis)) > 1e-3]
        if crossing:
            other, before = crossing[-1]
            b, gap = float(axis @ before), other - point
            foot = point + (gap @ axis - b * (gap @ before)) / (1.0 - b * b) * axis
        ahead = float(axis @ (origin - foot))
        if abs(ahead) < 1e-4:  # the link's origin is at the wrist, so the link's z axis decides
            ahead = float(axis @ z) if abs(float(axis @ z)) > 0.5 else 1.0
        on_axis = point + (origin - point) @ axis * axis
        direction, note = np.sign(ahead) * axis, "the tool runs along the last axis"
        if np.linalg.norm(origin - on_axis) < 1e-6:
            origin = on_axis
        else:
            note = "the last link is off the last axis: the tool runs parallel to this axis, so all joints move the tip"
    behind = float((origin - foot) @ direction)
    if behind < 1e-6:
        behind, note = 0.0, f"{note}; the wrist point is the mount"
    else:
        note = f"{note}; the wrist, {behind:.4g} m behind the mount, is the shaft's point nearest to the previous axis"
    down = place.rotation.T @ direction
    mount = place.rotation.T @ (origin - place.translation)
    across = math.hypot(down[0], down[1])
    rpy = (0.0, math.atan2(across, down[2]), math.atan2(down[1], down[0]) if across > 1e-12 else 0.0)
    return Shaft(mount - behind * down, mount, rpy, note)


# --- the home pose ---


class Home(NamedTuple):
    """A home pose and its rating."""

    q: Array  #: (n,) [rad, m]
    mu: float  #: [m^3]
    mu_best: float  #: Largest mu on its self-motion [m^3].
    margin: float  #: Distance to the nearest joint limit, divided by half the range.
    task: str  #: Why the default task fails, or "not tried"; empty if the task can be done.

    @property
    def order(self) -> tuple[bool, float]:
        """Sort key: whether the task fails, then the distance of mu / mu_best from the middle of `SHARE`."""
        return bool(self.task), abs(self.mu / self.mu_best - 0.5 * (SHARE[0] + SHARE[1]))


def search_home(robot: RobotModel, *, seed: int = 0) -> Home:
    """Search for a home pose. Raise a RobotError if no pose is suitable.

    Random poses are scored by mu and by their distance from limits and singularities. Of the poses with the best
    scores, the first in `Home.order` is chosen.
    """
    rng, idle = np.random.default_rng(seed), ~robot.moves.any(axis=0)
    middle, half = 0.5 * (robot.q_min + robot.q_max), 0.5 * (robot.q_max - robot.q_min)
    poses = middle + (1.0 - MARGIN) * half * rng.uniform(-1.0, 1.0, (DRAWS, robot.n))
    poses[:, idle] = middle[idle]
    tips, wrists = robot.tool_along(poses)
    down = (wrists - tips)[:, 2] / np.linalg.norm(wrists - tips, axis=1)
    side = np.sign(np.mean(tips[:, 2]))  # 1: the arm is above the base's plane; -1: it hangs below
    clear = np.minimum(side * tips[:, 2], side * wrists[:, 2])
    found: list[Home] = []
    for least in DOWN:
        found += _ranked(robot, poses[(down >= least) & (clear > CLEARANCE_M)])
        if any(not home.task for home in found):
            break
    if not found:
        raise RobotError(
            f"home pose: none of {DRAWS} random poses has tip and wrist clear of the base's plane and is regular "
            f"(ratios of singular values above {REGULAR}): is the last link right, and are the limits wide enough?"
        )
    return min(found, key=lambda home: home.order)


def _ranked(robot: RobotModel, poses: Array) -> list[Home]:
    """Return home poses by descending score, up to the first that can do the task and has mu / mu_best in `SHARE`."""
    moving, mu = robot.moves.any(axis=0), robot.mu_along(poses)
    scores = np.full(len(poses), -np.inf)
    for k, q in enumerate(poses):
        left = freedoms(robot, q)
        if left.tip >= REGULAR[0] and left.both >= REGULAR[1]:
            scores[k] = limit_shares(robot, q)[moving].min() + min(left.tip, 2.0 * left.both) + 0.25 * mu[k] / mu.max()
    best = [int(k) for k in np.argsort(-scores)[:SHORTLIST] if np.isfinite(scores[k])]
    homes: list[Home] = []
    for q in np.round(poses[best], 2):
        try:
            largest = self_motion(robot, q).mu_best
        except RobotError:
            continue  # the curve meets a singularity
        here = robot.state(q).mu
        # `task_fault` is slow, so not all poses are tried.
        wanted = SHARE[0] <= here / largest <= SHARE[1]
        task = task_fault(robot, q) if wanted or not homes else "not tried"
        homes.append(Home(q, here, largest, float(limit_shares(robot, q)[moving].min()), task))
        if wanted and not task:
            break
    return homes


def task_fault(robot: RobotModel, q: Array, scenario: Scenario | None = None) -> str:
    """Return why a scenario's path cannot be followed from q, or "" if it can."""
    asked = (scenario or Scenario()).change(start={"q_rad": tuple(q.tolist())})
    try:
        lay_out(asked, robot)
    except MocOptError as error:
        return str(error)
    return ""
