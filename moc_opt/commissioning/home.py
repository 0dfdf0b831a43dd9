"""A pose to begin with: away from limits and singularities, tool down, and with some manipulability to gain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from moc_opt.errors import MocOptError, RobotError
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.redundancy.freedoms import freedoms, limit_shares
from moc_opt.redundancy.self_motion import self_motion
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.layout import lay_out

DRAWS = 6000
"""Poses that are drawn; forward kinematics of one takes microseconds."""
SHORTLIST = 60
"""Poses whose self-motion is scanned."""
DOWN = (0.94, 0.8, -1.0)
"""Least cosine between tool and vertical that is asked for, first to last: 20 deg, 37 deg, any direction."""
CLEARANCE_M = 0.05
"""Least height of tip and wrist over the plane that the arm stands on, or depth under that it hangs from [m]."""
MARGIN = 0.2
"""Least distance from a limit, as a share of half of the joint's range."""
REGULAR = (0.15, 0.08)
"""Least singular values over the largest, of the tip's Jacobian and of A; see `freedoms`."""
SHARE = (0.7, 0.9)
"""mu over the largest mu of the pose's own self-motion: below 1, so that there is something to gain."""


@dataclass(frozen=True, eq=False)
class Home:
    """A pose and why it was taken."""

    q: Array
    """(n,) [rad, m]"""
    mu: float
    """[m^3]"""
    mu_best: float
    """The largest on its own self-motion curve [m^3]."""
    margin: float
    """Least distance to a limit over half the range, idle joints left out."""
    task: str
    """Empty where the default task can be done from it, else why not."""


def search_home(robot: RobotModel, *, seed: int = 0) -> Home:
    """Search the joint ranges for a pose to begin with; the same seed finds the same pose.

    Poses with tip and wrist on the arm's side of the plane that it stands on or hangs from are ranked by their
    distance from limits and singularities and by mu. The first one is taken whose mu is between `SHARE` of the best on
    its self-motion and from which the default scenario's path can be followed; if there is none, what was asked for
    last is given up first.

    Raises:
        RobotError: every pose drawn is singular or near a limit.
    """
    rng = np.random.default_rng(seed)
    middle, half = 0.5 * (robot.q_min + robot.q_max), 0.5 * (robot.q_max - robot.q_min)
    poses = middle + (1.0 - MARGIN) * half * rng.uniform(-1.0, 1.0, (DRAWS, robot.n))
    poses[:, ~robot.moves.any(axis=0)] = middle[~robot.moves.any(axis=0)]
    tips, wrists = robot.tool_along(poses)
    down = (wrists - tips)[:, 2] / np.linalg.norm(wrists - tips, axis=1)
    side = np.sign(
        np.mean(tips[:, 2])
    )  # most poses lie on the side of the base where the arm is: below it, if it hangs
    clear = np.minimum(side * tips[:, 2], side * wrists[:, 2])
    found: Home | None = None
    for least in DOWN:
        fit = np.flatnonzero((down >= least) & (clear > CLEARANCE_M))
        for home in _ranked(robot, poses[fit]):
            if not home.task and SHARE[0] <= home.mu / home.mu_best <= SHARE[1]:
                return home
            if found is None or (bool(found.task), abs(_gain(found))) > (bool(home.task), abs(_gain(home))):
                found = home
        if found is not None and not found.task:
            return found
    if found is None:
        raise RobotError(
            f"home pose: {DRAWS} poses drawn, each with a joint near its limit, the tip below the base, or singular "
            f"(singular values below {REGULAR} of the largest): is the last link right, and do the limits leave room?"
        )
    return found


def _gain(home: Home) -> float:
    """Return how far its share of the best is from the wanted one."""
    return home.mu / home.mu_best - 0.5 * (SHARE[0] + SHARE[1])


def _ranked(robot: RobotModel, poses: Array) -> list[Home]:
    """Return the best poses by limits, singularities and mu, each with its self-motion's best, until one is fit."""
    moving = robot.moves.any(axis=0)
    scores, mu = np.full(len(poses), -np.inf), robot.mu_along(poses)
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
        wanted = SHARE[0] <= here / largest <= SHARE[1]
        # Following the path costs more than the scan: only where the share is right, or nothing was found yet.
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
