"""The largest mu that an arm can have at given tips and wrists, over every pose inside its joint limits.

An arm with a spherical shoulder and wrist has all its poses in closed form (`pose_map`): they are scanned, on every
branch. Any other arm, and any arm with several freedoms, is climbed on from many seeded starts
(`moc_opt/core/plan.c`): some pose reaches the value that is found, but nothing proves that it is the largest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from moc_opt import core
from moc_opt.arrays import Array
from moc_opt.planning.course import Targets
from moc_opt.planning.pose_map import closed_form, map_of
from moc_opt.robots.model import RobotModel

SCANNED = "scanned, all branches"
STARTS = 96  #: Random starts at the first point, where nothing is in closed form.
LATER = 8  #: At each later point one of so many starts is tried: maxima are followed along the path.
KEPT = 6  #: Different maxima that are followed from a point to its neighbours.
SAME = 1e-5  #: Maxima of mu nearer than this share are one.


class Largest(NamedTuple):
    """The largest mu at k points, and how it was found."""

    mu: Array  #: (k,) [m^3]
    method: str  #: `SCANNED`, or "best found of N starts" with the number of starts at all points together.


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
    if closed_form(robot) is not None:
        rows = np.append(np.arange(len(inside)), 0)  # a map has two points or more
        at = np.arange(float(len(rows)))
        found = map_of(robot, inside[0], Targets(at, tips[rows], wrists[rows], at)).highest()
        return Largest(np.fmax(found[:-1], own), SCANNED)
    found = _climbed(robot, inside, np.stack([tips, wrists], axis=1), starts, np.random.default_rng(seed))
    drawn = starts + (len(inside) - 1) * -(-starts // LATER)
    return Largest(np.fmax(found, own), f"best found of {drawn} starts")


def _climbed(robot: RobotModel, own: Array, targets: Array, starts: int, rng: np.random.Generator) -> Array:
    kept: list[Array] = [np.empty((0, robot.n))] * len(own)
    best = np.empty(len(own))
    for k, q in enumerate(own):
        drawn = rng.uniform(robot.q_min, robot.q_max, (-(-starts // LATER) if k else starts, robot.n))
        kept[k], best[k] = _maxima(robot, targets[k], np.vstack([q[None], kept[k - 1], drawn]))
    for k in range(len(own) - 2, -1, -1):
        kept[k], best[k] = _maxima(robot, targets[k], np.vstack([kept[k], kept[k + 1]]))
    return best


def _maxima(robot: RobotModel, target: Array, starts: Array) -> tuple[Array, float]:
    mus, target = np.empty(len(starts)), np.ascontiguousarray(target)
    core.ascend(robot.arm, np.array(robot.q_min), np.array(robot.q_max), target, None, starts, mus)
    chosen: list[int] = []
    for i in (int(i) for i in np.argsort(-mus) if mus[i] > 0.0):
        if len(chosen) < KEPT and all(mus[j] - mus[i] > SAME * mus[j] for j in chosen):
            chosen.append(i)
    return starts[chosen], float(mus.max(initial=-1.0))
