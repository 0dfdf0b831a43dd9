"""Every pose that an arm can take at every point of a path: manipulability, room to the joint limits, feasibility.

An arm with a spherical shoulder and wrist has its poses in closed form, over (time x branch x swivel). Any other arm
has them by continuation (`traced`), over (time x 1 x sample): what stands there in place of a swivel is the number of
a sample along the self-motion curves that were found.
"""

from __future__ import annotations

import numbers
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import RobotError, shown
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.planning import spherical_kernels as kernels
from moc_opt.planning.spherical import BRANCHES, Spherical
from moc_opt.planning.targets import Targets
from moc_opt.redundancy.arm_angle import Elbow

Flags = NDArray[np.bool_]
Margin = float | Array
"""From the joint limits: one number for all, or one per joint (n,) [rad], [m] of a joint that slides."""

ROUNDING_RAD = 1e-9
"""A pose this far beyond a limit still stands on it."""
SWIVELS = 720
"""Samples of one turn, where no other number is asked for."""
MOST_SWIVELS = 2880
"""Of one turn: planning over 1000 times then takes 2.5 GB."""
CANDIDATES = 4
"""Local maxima of mu that are climbed to their top at each point of the path."""


@dataclass(frozen=True, eq=False)
class PoseMap:
    """k times, b branches, m swivels or samples, n joints."""

    targets: Targets
    mu: Array
    """(k,b,m) [m^3], of forbidden poses too; NaN where there is no pose"""
    room_rad: Array
    """(k,b,m) distance of the nearest joint from its limit, below zero beyond it; idle joints do not count"""

    def poses(self, k: int) -> Array:
        """Return the poses (b,m,n) [rad] at time k; NaN where there is none."""
        raise NotImplementedError

    def crossing(self, k: int, step_rad: Array) -> NDArray[np.int64]:
        """Return (m,) bits of the branch's number that may change within a period with these joint steps (n,) [rad]."""
        return np.zeros(self.mu.shape[2], dtype=np.int64)

    def feasible(self, margin: Margin = 0.0) -> Flags:
        """Return (k,b,m) whether every joint keeps the margin from its limits."""
        found: Flags = self.room_rad >= np.max(margin) - ROUNDING_RAD
        return found

    def highest(self, margin: Margin = 0.0) -> Array:
        """Return (k,) the largest feasible mu at each time [m^3]; NaN where nothing is feasible."""
        score = np.where(self.feasible(margin), self.mu, -np.inf).max(axis=(1, 2))
        return np.where(np.isfinite(score), score, np.nan)


@dataclass(frozen=True, eq=False)
class SphericalMap(PoseMap):
    """The closed form; the same mu for all branches of one swivel."""

    arm: Spherical
    swivel_rad: Array
    """(m,) evenly over one turn, that of the start among them, in the sense of `moc_opt.redundancy.arm_angle.Elbow`"""
    angles: Array
    """(k,m,6) of the branch without negative signs, in the normal form [rad]"""
    reference: Array
    """(3,) the direction from which the swivel counts"""
    idle_rad: float
    """Joint 7, which moves neither tip nor wrist, stands here throughout."""

    def poses(self, k: int) -> Array:
        """Return the poses (8,m,7) [rad] at time k."""
        return self._poses(self.angles[k])

    def _poses(self, angles: Array) -> Array:
        found = np.empty((BRANCHES, len(angles), 7))
        kernels.fill_poses(self.arm.offset, self.arm.middle, angles, found)
        found[..., 6] = np.where(np.isnan(angles[:, 0]), np.nan, self.idle_rad)
        return found

    def crossing(self, k: int, step_rad: Array) -> NDArray[np.int64]:
        """Return (m,) bits of joints 2, 4 and 6 within two steps of zero or half a turn, where they change sign."""
        with np.errstate(invalid="ignore"):
            near = np.abs(np.sin(self.angles[k][:, 1::2])) <= np.sin(np.minimum(2.0 * step_rad[1:6:2], 0.5 * np.pi))
        return near @ np.array([1, 2, 4])

    def at(self, k: int, swivel_rad: float, branch: int) -> Array:
        """Return the pose (7,) at one time, swivel [rad] and branch, between the map's swivels too."""
        one = slice(k, k + 1)
        angles, _, _ = _evaluate(
            self.arm, self.reference, self.targets.tip[one], self.targets.wrist[one], np.array([[swivel_rad]])
        )
        pose: Array = self._poses(angles[0])[branch, 0]
        return pose

    def highest(self, margin: Margin = 0.0) -> Array:
        """Return (k,) the largest feasible mu at each time, maxima climbed between the map's swivels to rounding."""
        return self.peaks(margin)[0]

    def peaks(self, margin: Margin = 0.0) -> tuple[Array, Array]:
        """Return the largest feasible mu (k,) [m^3] and its swivel (k,) [rad]; NaN where nothing is feasible."""
        score = np.where(self.feasible(margin).any(axis=1), self.mu[:, 0], -np.inf)
        peak = (score >= np.roll(score, 1, axis=1)) & (score >= np.roll(score, -1, axis=1)) & np.isfinite(score)
        order = np.argsort(np.where(peak, score, -np.inf), axis=1)[:, ::-1][:, :CANDIDATES]
        rows, best = np.arange(len(score)), np.full((2, len(score)), -np.inf)
        for column in order.T:
            swivel, value = self.swivel_rad[column], score[rows, column]
            width = self.swivel_rad[1] - self.swivel_rad[0]
            while width > 1e-10:
                tried = swivel[:, None] + width * np.linspace(-1.0, 1.0, 21)
                _, mu, room = _evaluate(self.arm, self.reference, self.targets.tip, self.targets.wrist, tried)
                allowed = (room >= np.max(margin) - ROUNDING_RAD).any(axis=1)
                reached = np.where(allowed, mu, -np.inf)
                at = reached.argmax(axis=1)
                better = reached[rows, at] > value
                swivel, value = np.where(better, tried[rows, at], swivel), np.maximum(value, reached[rows, at])
                width /= 5.0
            higher = value > best[1]
            best[0], best[1] = np.where(higher, swivel, best[0]), np.where(higher, value, best[1])
        known = np.isfinite(best[1])
        return np.where(known, best[1], np.nan), np.where(known, best[0], np.nan)


def spherical_map(
    robot: RobotModel, arm: Spherical, targets: Targets, *, swivels: int = SWIVELS, start: Array | None = None
) -> SphericalMap:
    """Compute the closed form over the path.

    Args:
        arm: its normal form.
        swivels: samples of one turn.
        start: (7,) [rad] a pose whose swivel is one of the samples, and where joint 7 stands; None: from -pi, and 0.

    Raises:
        RobotError: fewer than 8 swivels, or more than `MOST_SWIVELS`.
    """
    check_swivels(swivels)
    elbow = Elbow(robot, targets.wrist)
    reference, first = elbow.reference, -np.pi
    if start is not None:
        first += float(np.mod(elbow.swivel(start[None])[0] + np.pi, 2.0 * np.pi / swivels))
    swivel = first + 2.0 * np.pi * np.arange(swivels) / swivels
    each = np.broadcast_to(swivel, (len(targets), swivels))
    angles, mu, room = _evaluate(arm, reference, targets.tip, targets.wrist, each)
    shared = np.broadcast_to(mu[:, None], room.shape)
    idle_rad = 0.0 if start is None else float(start[6])
    return SphericalMap(
        targets, shared, room, arm=arm, swivel_rad=swivel, angles=angles, reference=reference, idle_rad=idle_rad
    )


def check_swivels(swivels: object) -> None:
    """Check a number of samples of one turn.

    Raises:
        RobotError: it is no whole number from 8 to `MOST_SWIVELS`.
    """
    if not isinstance(swivels, numbers.Integral) or not 8 <= int(swivels) <= MOST_SWIVELS:
        raise RobotError(f"swivels = {shown(swivels)}: give a whole number from 8 to {MOST_SWIVELS}")


def _evaluate(
    arm: Spherical, reference: Array, tips: Array, wrists: Array, swivels: Array
) -> tuple[Array, Array, Array]:
    """Return angles (k,m,6), mu (k,m) and room (k,8,m) at swivels (k,m)."""
    k, m = swivels.shape
    angles, mu, room = np.empty((k, m, 6)), np.empty((k, m)), np.empty((k, BRANCHES, m))
    kernels.fill_map(
        arm.base, arm.shoulder, arm.upper, arm.fore, arm.tool, arm.offset, arm.middle, arm.half,
        np.ascontiguousarray(reference), np.ascontiguousarray(tips), np.ascontiguousarray(wrists),
        np.ascontiguousarray(swivels), angles, mu, room,
    )  # fmt: skip
    return angles, mu, room
