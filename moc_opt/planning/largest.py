"""The largest mu that an arm can have at given tips and wrists, over every pose inside its joint limits.

An arm with a spherical shoulder and wrist has all its poses in closed form (`spherical`): they are scanned, on every
branch. Any other arm, and any arm with several freedoms, is climbed on from many seeded starts
(`moc_opt.redundancy.ascent`): some pose reaches the value that is found, but nothing proves that it is the largest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.planning.pose_map import spherical_map
from moc_opt.planning.spherical import spherical
from moc_opt.planning.targets import Targets
from moc_opt.redundancy.ascent import ascend_all
from moc_opt.redundancy.continuation import Constraint

SCANNED = "scanned, all branches"
STARTS = 96
"""Random starts at the first point, where nothing is in closed form."""
LATER = 8
"""At each later point one of so many starts is tried: maxima are followed along the path."""
KEPT = 6
"""Different maxima that are followed from a point to its neighbours."""
SAME = 1e-5
"""Maxima of mu nearer than this share are one."""


class Largest(NamedTuple):
    """The largest mu at k points, and how it was found."""

    mu: Array
    """(k,) [m^3]"""
    method: str
    """`SCANNED`, or "best found of N starts" with the number of starts at all points together."""


def largest_mu(robot: RobotModel, poses: Array, *, starts: int = STARTS, seed: int = 0) -> Largest:
    """Find the largest mu over every feasible pose with the same tip and wrist as each of the given ones.

    Never below mu of the poses themselves.

    Args:
        poses: (k, n), in the order of a path, as neighbours hand on their maxima [rad, m]; put inside the limits first.
        starts: random starts at the first point, for arms without closed form; an eighth of them at each later one.
    """
    inside = np.clip(poses, robot.q_min, robot.q_max)
    own = robot.mu_along(inside)
    tips, wrists = robot.tool_along(inside)
    arm = spherical(robot)
    if arm is not None:
        rows = np.append(np.arange(len(inside)), 0)  # a map has two points or more
        at = np.arange(float(len(rows)))
        found = spherical_map(robot, arm, Targets(at, tips[rows], wrists[rows], at)).highest()
        return Largest(np.fmax(found[:-1], own), SCANNED)
    found = _climbed(robot, inside, np.stack([tips, wrists], axis=1), starts, np.random.default_rng(seed))
    drawn = starts + (len(inside) - 1) * -(-starts // LATER)
    return Largest(np.fmax(found, own), f"best found of {drawn} starts")


def _climbed(robot: RobotModel, own: Array, targets: Array, starts: int, rng: np.random.Generator) -> Array:
    """Return the best of random starts and of the neighbours' maxima, along the path and back again."""
    kept: list[Array] = [np.empty((0, robot.n))] * len(own)
    best = np.empty(len(own))
    before = np.empty((0, robot.n))
    for k, q in enumerate(own):
        count = -(-starts // LATER) if k else starts
        drawn = rng.uniform(robot.q_min, robot.q_max, (count, robot.n))
        before, best[k] = _maxima(robot, targets[k], np.vstack([q[None], before, drawn]))
        kept[k] = before
    for k in range(len(own) - 2, -1, -1):
        kept[k], best[k] = _maxima(robot, targets[k], np.vstack([kept[k], kept[k + 1]]))
    return best


def _maxima(robot: RobotModel, target: Array, starts: Array) -> tuple[Array, float]:
    """Return the `KEPT` best different maxima reached from the starts, and the largest mu."""
    chain = robot.chain
    moving = np.flatnonzero(robot.moves.any(axis=0)).astype(np.int64)
    arm = Constraint(chain.joints, chain.offsets, robot.moves, robot.q_min, robot.q_max, active=moving, target=target)
    mus = np.empty(len(starts))
    ascend_all(arm, starts, mus)
    order = [int(i) for i in np.argsort(-mus) if mus[i] > 0.0]
    chosen: list[int] = []
    for i in order:
        if len(chosen) < KEPT and all(mus[j] - mus[i] > SAME * mus[j] for j in chosen):
            chosen.append(i)
    return starts[chosen], float(mus.max(initial=-1.0))
