"""Where the tool sits on a new arm, and a home pose: regular, tool down, with manipulability to gain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from moc_opt.arrays import Array
from moc_opt.errors import MocOptError, RobotError
from moc_opt.planning.self_motion import freedoms, limit_shares, self_motion
from moc_opt.robots.model import RobotModel
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.layout import lay_out

_SAME = 1e-6
DRAWS = 6000  #: Poses that are drawn; forward kinematics of one takes microseconds.
SHORTLIST = 60  #: Poses whose self-motion is scanned.
DOWN = (0.94, 0.8, -1.0)
"""Least cosine between tool and vertical that is asked for, first to last: 20 deg, 37 deg, any direction."""
CLEARANCE_M = 0.05
"""Least height of tip and wrist over the plane that the arm stands on, or depth under that it hangs from [m]."""
MARGIN = 0.2  #: Least distance from a limit, as a share of half of the joint's range.
REGULAR = (0.15, 0.08)  #: Least singular values over the largest, of the tip's Jacobian and of A; see `freedoms`.
SHARE = (0.7, 0.9)
"""mu over the largest mu of the pose's own self-motion: below 1, so that there is something to gain."""


@dataclass(frozen=True, eq=False)
class Home:
    """A pose and why it was taken."""

    q: Array  #: (n,) [rad, m]
    mu: float  #: [m^3]
    mu_best: float  #: The largest on its own self-motion curve [m^3].
    margin: float  #: Least distance to a limit over half the range, idle joints left out.
    task: str  #: Empty where the default task can be done from it, else why not.

    @property
    def order(self) -> tuple[bool, float]:
        """Smaller is better: the task can be done, and mu is near the middle of `SHARE`."""
        return bool(self.task), abs(self.mu / self.mu_best - 0.5 * (SHARE[0] + SHARE[1]))


def search_home(robot: RobotModel, *, seed: int = 0) -> Home:
    """Search the joint ranges for a home pose; the same seed finds the same pose.

    Poses with tip and wrist on the arm's side of the plane that it stands on or hangs from are ranked by their
    distance from limits and singularities and by mu. The first one is taken whose mu is between `SHARE` of the best on
    its self-motion and from which the default scenario's path can be followed. Where there is none, the direction of
    the tool is given up first, then the share.

    Raises:
        RobotError: every pose drawn is singular or near a limit.
    """
    rng, idle = np.random.default_rng(seed), ~robot.moves.any(axis=0)
    middle, half = 0.5 * (robot.q_min + robot.q_max), 0.5 * (robot.q_max - robot.q_min)
    poses = middle + (1.0 - MARGIN) * half * rng.uniform(-1.0, 1.0, (DRAWS, robot.n))
    poses[:, idle] = middle[idle]
    tips, wrists = robot.tool_along(poses)
    down = (wrists - tips)[:, 2] / np.linalg.norm(wrists - tips, axis=1)
    side = np.sign(np.mean(tips[:, 2]))  # of the base, on which the arm is: below it, if it hangs
    clear = np.minimum(side * tips[:, 2], side * wrists[:, 2])
    found: list[Home] = []
    for least in DOWN:
        found += _ranked(robot, poses[(down >= least) & (clear > CLEARANCE_M)])
        if any(not home.task for home in found):
            break
    if not found:
        raise RobotError(
            f"home pose: {DRAWS} poses drawn, each with a joint near its limit, the tip below the base, or singular "
            f"(singular values below {REGULAR} of the largest): is the last link right, and do the limits leave room?"
        )
    return min(found, key=lambda home: home.order)


def _ranked(robot: RobotModel, poses: Array) -> list[Home]:
    """Return the best of the poses as homes, the last one the first that is as wanted."""
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
            continue  # singular along the curve: not a pose to begin with
        here = robot.state(q).mu
        # Following the path costs more than the scan: only where the share is right, or nothing was found yet.
        wanted = SHARE[0] <= here / largest <= SHARE[1]
        task = task_fault(robot, q) if wanted or not homes else "not tried"
        homes.append(Home(q, here, largest, float(limit_shares(robot, q)[moving].min()), task))
        if wanted and not task:
            break
    return homes


def task_fault(robot: RobotModel, q: Array, scenario: Scenario | None = None) -> str:
    """Say why the default scenario's path (or that of ``scenario``) cannot be followed from q; empty if it can."""
    asked = (scenario or Scenario()).change(start={"q_rad": tuple(q.tolist())})
    try:
        lay_out(asked, robot, np.random.default_rng(0))
    except MocOptError as error:
        return str(error)
    return ""


class Shaft(NamedTuple):
    """Where the tool sits, in the frame of the last link."""

    wrist: Array  #: (3,) [m]
    mount: Array  #: (3,) [m]; the link's own origin, put onto the last axis where it is on it but for rounding
    rpy: tuple[float, float, float]  #: turns z of the link into the tool's direction [rad]
    note: str


def find_shaft(text: str, last_link: str, *, wrist_m: float | None = None) -> Shaft:
    """Lay the tool along the last turning axis, away from the arm, from the last link's origin.

    The wrist point is the point of the shaft nearest to the axis before it: where they cross on a spherical wrist.
    Where the last joint slides, the tool runs along z of the last link and the wrist point is its origin.

    Args:
        text: a clean URDF.
        last_link: the link that carries the tool.
        wrist_m: distance from wrist point to mount along the shaft [m], in place of the one found.
    """
    model = pin.buildModelFromXML(text)
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    pin.updateFramePlacements(model, data)
    place = data.oMf[model.getFrameId(last_link, pin.FrameType.BODY)]
    origin, z = place.translation.copy(), place.rotation[:, 2]
    axes = data.J.reshape(6, -1)[3:].T  # of one joint pinocchio gives a vector; zero where it slides
    lines = [(data.oMi[j + 1].translation, axis) for j, axis in enumerate(axes) if np.linalg.norm(axis) > 0.5]
    direction, foot, note = z, origin, "the last joint slides: the tool runs along z of the last link"
    if np.linalg.norm(axes[-1]) > 0.5:
        point, axis = lines[-1]
        crossing = [line for line in lines[:-1] if np.linalg.norm(np.cross(line[1], axis)) > 1e-3]
        if crossing:  # the point of the last axis that is nearest to the one before it
            other, before = crossing[-1]
            b, gap = float(axis @ before), other - point
            foot = point + (gap @ axis - b * (gap @ before)) / (1.0 - b * b) * axis
        ahead = float(axis @ (origin - foot))
        if abs(ahead) < 1e-4:  # the flange stands on the crossing: z of the link decides
            ahead = float(axis @ z) if abs(float(axis @ z)) > 0.5 else 1.0
        on_axis = point + (origin - point) @ axis * axis
        direction, note = np.sign(ahead) * axis, "the tool runs along the last axis"
        if np.linalg.norm(origin - on_axis) < _SAME:
            origin = on_axis
        else:
            note = "the last link is off the last axis: the tool runs parallel to it, and no joint is idle"
    behind = float((origin - foot) @ direction) if wrist_m is None else wrist_m
    if wrist_m is None and behind < _SAME:
        behind, note = 0.0, f"{note}; the wrist point is the mount"
    elif wrist_m is None:
        note = f"{note}; the wrist point, {behind:.4g} m behind the mount, is the nearest to the axis before it"
    down = place.rotation.T @ direction
    mount = _tidy(place.rotation.T @ (origin - place.translation))
    return Shaft(_tidy(mount - behind * down), mount, _towards(down), note)


def _tidy(point: Array) -> Array:
    return np.where(np.abs(point) < 1e-15, 0.0, point)  # rounding errors to zero


def _towards(direction: Array) -> tuple[float, float, float]:
    if np.hypot(direction[0], direction[1]) < 1e-14:  # a tilt of 1e-9 rad would make an idle joint move the tip
        return (0.0, 0.0, 0.0) if direction[2] > 0.0 else (float(np.pi), 0.0, 0.0)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), direction).toRotationMatrix()
    roll, pitch, yaw = pin.rpy.matrixToRpy(turn).tolist()
    return roll, pitch, yaw
