"""Self-motion: the poses that an arm can take while tip and wrist stay in place.

With one freedom, the poses form a curve. Its tangent is the null vector of A = [J_tip; J_wrist].
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.arrays import Array, read_only
from moc_opt.errors import RobotError
from moc_opt.robots.model import RobotModel

HELD = 1e-6  #: Singular values of A below this share of the largest count as zero in `freedoms`.
RANK = 1e-9  #: Singular values of A below this count as zero in `self_motion`.
LEAST_STEP, MOST_STEP = 1e-5, 10.0  #: Bounds on the spacing of the samples on a curve [rad].


class Freedoms(NamedTuple):
    """The freedoms of n joints with fixed tip and wrist."""

    rank: int  #: Rank of A, 5 if the arm can place the shaft freely.
    real: int  #: Number of freedoms: n - rank - (number of idle joints).
    idle: tuple[int, ...]  #: Joints (counted from 0) that move neither tip nor wrist at any pose.
    tip: float  #: Ratio of the smallest to the largest singular value of the tip's Jacobian.
    both: float  #: Ratio of the fifth to the largest singular value of A.

    def refusal(self, robot: RobotModel) -> str:
        """Return the message that no freedom is left for level 3."""
        idle = ", ".join(robot.data.joint_names[j] for j in self.idle)
        return (
            f"robot {robot.data.name!r}: no freedom is left for the third level: of {robot.n} joints, the tool's tip "
            f"and shaft need {self.rank}, and {len(self.idle)} turn only the tool{f' ({idle})' if idle else ''}; "
            "use control.law = 'dcac' (needs no freedom), an arm with one more joint, or a tool off the last axis"
        )


def freedoms(robot: RobotModel, q: ArrayLike) -> Freedoms:
    """Count the freedoms at q (n,) [rad, m]."""
    state = robot.state(q)
    idle = tuple(int(j) for j in np.flatnonzero(~robot.moves.any(axis=0)))
    tip, both = (np.linalg.svd(J, compute_uv=False) for J in (state.J_tip, state.A))
    rank = int(np.sum(both > HELD * both[0]))
    five = float(both[4] / both[0]) if len(both) > 4 else 0.0
    return Freedoms(rank, robot.n - rank - len(idle), idle, float(tip[-1] / tip[0]), five)


def best_freedoms(robot: RobotModel, poses: int = 8) -> Freedoms:
    """Return the freedoms at the most regular of ``poses`` seeded random poses: highest rank, then largest ``both``."""
    drawn = np.random.default_rng(0).uniform(robot.q_min, robot.q_max, (poses, robot.n))
    return max((freedoms(robot, q) for q in drawn), key=lambda found: (found.rank, found.both))


def require_freedom(robot: RobotModel) -> None:
    """Raise a RobotError if no freedom is left with fixed tip and shaft."""
    found = best_freedoms(robot)
    if found.real < 1:
        raise RobotError(found.refusal(robot))


def limit_shares(robot: RobotModel, q: Array) -> Array:
    """Return (distance to the nearer limit) / (half the range) of each joint, (n,)."""
    nearest: Array = np.minimum(q - robot.q_min, robot.q_max - q) / (0.5 * (robot.q_max - robot.q_min))
    return nearest


def parabola_peak(x: Array, y: Array) -> tuple[float, float]:
    """Compute the peak of the parabola through three points (x[i], y[i]), where x rises.

    Return the step from x[1] to the peak, clipped to the samples, and the height above y[1]; zeros if there is no peak.
    """
    (left, right), (rise, fall) = np.diff(x), np.diff(y)
    bend = (fall / right - rise / left) / (left + right)
    if not -np.inf < bend < 0.0:
        return 0.0, 0.0
    slope = (rise / left * right + fall / right * left) / (left + right)
    step = float(np.clip(-0.5 * slope / bend, -left, right))
    return step, float(slope * step + bend * step * step)


@dataclass(frozen=True, eq=False)
class SelfMotion:
    """Samples along the feasible self-motion, in the order of the curve."""

    s: Array  #: (k,) arc length in joint space [rad], 0 at the pose from which the curve was followed
    q: Array  #: (k,n) [rad]
    mu: Array  #: (k,) manipulability of the tip [m^3]
    held: tuple[int, ...]  #: joints (counted from 0) that are idle, or held still to leave a single freedom
    _robot: RobotModel = field(repr=False)
    _task: tuple[Array, Array, Array] = field(repr=False)  # lower and upper bounds (n,), tip and wrist (2,3)

    def at(self, fractions: ArrayLike) -> Array:
        """Return the poses (k, n) at fractions (k,) in [0, 1] of the arc length."""
        places = np.interp(self.s[0] + np.asarray(fractions) * np.ptp(self.s), self.s, np.arange(len(self.s)))
        i = places.astype(int)
        poses = self.q[i] + (places - i)[:, None] * (self.q[np.minimum(i + 1, len(self.q) - 1)] - self.q[i])
        for k in np.flatnonzero(places % 1.0):
            miss, pose = self._robot.arm.nearest_pose(*self._task, poses[k], 10)
            # Newton's method can fail near a joint limit or a singular pose.
            poses[k] = pose if miss < 1e-10 else self.q[round(places[k])]
        return poses

    @property
    def best(self) -> Array:
        """The pose (n,) of the largest mu, refined by a parabola."""
        i = int(np.argmax(self.mu))
        if not 0 < i < len(self.mu) - 1:
            return np.array(self.q[i])
        peak = self.s[i] + parabola_peak(self.s[i - 1 : i + 2], self.mu[i - 1 : i + 2])[0]
        (pose,) = self.at([np.clip((peak - self.s[0]) / (self.s[-1] - self.s[0]), 0.0, 1.0)])
        return pose if self._robot.mu_along(pose[None])[0] > self.mu[i] else np.array(self.q[i])

    @property
    def mu_best(self) -> float:
        """mu of `best` [m^3]."""
        return float(self._robot.mu_along(self.best[None])[0])


def self_motion(robot: RobotModel, q: ArrayLike, step: float = 0.02) -> SelfMotion:
    """Scan the feasible self-motion through q at fixed tip and wrist.

    With several freedoms, joints are held still until one freedom is left. Then the largest mu of all poses with this
    tip and wrist may lie off the curve. Without a freedom, the curve is a single pose.

    Args:
        q: (n,) a pose inside the joint limits [rad].
        step: spacing of the samples in joint space [rad], 1e-5 to 10.

    Raises:
        RobotError: q is singular or beyond a limit, or the step is out of range.
    """
    if not LEAST_STEP <= step <= MOST_STEP:
        raise RobotError(f"step = {step!r}: give {LEAST_STEP:g} to {MOST_STEP:g} rad")
    state = robot.state(q)
    outside = np.flatnonzero((state.q < robot.q_min) | (state.q > robot.q_max))
    if outside.size:
        raise RobotError(f"q = {state.q.tolist()}: joints {(outside + 1).tolist()} are outside their limits")
    active = _active_joints(robot, state.A)
    low, high = np.array(state.q), np.array(state.q)
    low[active], high[active] = robot.q_min[active], robot.q_max[active]
    task = low, high, np.array([state.tip, state.wrist])
    s, poses, mu = np.zeros(1), state.q[None], np.array([state.mu])
    if len(active) > np.linalg.matrix_rank(state.A[:, active], tol=RANK):
        # The number of samples is bounded, in case a curve never ends.
        most = int(np.ceil(4 * np.sum(robot.q_max - robot.q_min) / step)) + 2

        def follow(tangent: Array) -> tuple[Array, Array, Array, bool]:
            s, poses, mu = np.empty(most), np.empty((most, robot.n)), np.empty(most)
            count, closed = robot.arm.follow_curve(*task, np.array(state.q), tangent, step, s, poses, mu)
            return s[:count].copy(), poses[:count].copy(), mu[:count].copy(), bool(closed)

        tangent = np.zeros(robot.n)
        tangent[active] = np.linalg.svd(state.A[:, active])[2][-1]
        tangent *= np.sign(tangent[np.argmax(np.abs(tangent))])
        s, poses, mu, closed = follow(tangent)
        if not closed:
            s_down, q_down, mu_down, _ = follow(-tangent)
            pairs = ((s, -s_down), (poses, q_down), (mu, mu_down))
            s, poses, mu = (np.concatenate([down[:0:-1], up]) for up, down in pairs)
    held = tuple(j for j in range(robot.n) if j not in active)
    return SelfMotion(read_only(s), read_only(poses), read_only(mu), held, robot, task)


def curve_through(robot: RobotModel, q: ArrayLike, step: float) -> SelfMotion | None:
    """Return `self_motion`, or None if it raises a RobotError."""
    try:
        return self_motion(robot, q, step)
    except RobotError:
        return None


def _active_joints(robot: RobotModel, a: Array) -> list[int]:
    def rank(matrix: Array) -> int:
        return int(np.linalg.matrix_rank(matrix, tol=RANK))

    active = np.flatnonzero(robot.moves.any(axis=0)).tolist()
    rng = np.random.default_rng(0)
    draws = [robot.state(rng.uniform(robot.q_min, robot.q_max)).A for _ in range(3)]
    usual = max(rank(draw[:, active]) for draw in draws)
    while len(active) > usual + 1 and robot.chain.prismatic[active[0]] and rank(a[:, active[1:]]) == usual:
        active = active[1:]
    active = active[: usual + 1]
    found = rank(a[:, active])
    if found < min(usual, len(active)):
        raise RobotError(f"q is singular (tip and wrist Jacobians have rank {found}, not {usual}): change q slightly")
    return active
