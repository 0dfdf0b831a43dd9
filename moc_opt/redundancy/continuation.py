"""Compiled kernels that follow a self-motion: forward kinematics, Newton correction, continuation.

They work on the plain numbers of a `Chain`, several hundred poses a scan. Loops are written out where numpy
would do: on matrices this small that is faster to run, and several times faster to compile.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.model.kinematics_kernels import point_jacobian
from moc_opt.model.manipulability_kernels import yoshikawa
from moc_opt.model.place_kernels import place_joints, point_in_world, spatial_axes
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit

TOLERANCE = 1e-10  # on tip and wrist [m]
LIMIT, CLOSED, SINGULAR, LENGTH = range(4)


class Constraint(NamedTuple):
    """An arm (see `Chain` and `RobotModel`) and the tip and wrist it has to keep."""

    joints: Array
    offsets: Array
    moves: NDArray[np.bool_]
    q_min: Array
    q_max: Array
    active: NDArray[np.int64]
    """(m,) the joints that may move, m - 1 of them fixed by tip and wrist"""
    target: Array
    """(2,3) tip and wrist [m]"""


@njit(cache=True)
def forward(arm: Constraint, q: Array, axes: Array, points: Array) -> None:
    """Write the spatial axes (n,6), as in kinematics_kernels, and the points (2,3) tip and wrist of the chain at q."""
    n = q.shape[0]
    places = np.empty((n, 12))
    place_joints(arm.joints, q, places)
    spatial_axes(arm.joints, places, axes)
    r_t, origin = places[n - 1, :9].reshape((3, 3)), places[n - 1, 9:]
    point_in_world(r_t, origin, arm.offsets[0], points[0])
    point_in_world(r_t, origin, arm.offsets[1], points[1])


@njit(cache=True)
def evaluate(arm: Constraint, q: Array, error: Array, a: Array) -> float:
    """Fill the error (6,) of tip and wrist and A (6,m) of the active joints; returns mu."""
    n = q.shape[0]
    axes, points, full = np.empty((n, 6)), np.empty((2, 3)), np.empty((6, n))
    forward(arm, q, axes, points)
    point_jacobian(axes, points[0], arm.moves[0], full[0:3])
    point_jacobian(axes, points[1], arm.moves[1], full[3:6])
    for row in range(6):
        error[row] = arm.target[row // 3, row % 3] - points[row // 3, row % 3]
        for i in range(arm.active.shape[0]):
            a[row, i] = full[row, arm.active[i]]
    return float(yoshikawa(full[0:3]))


@njit(cache=True)
def bordered(a: Array, t: Array, b: Array, c: float, x: Array) -> None:
    """Solve [A; t^T] x = [b; c] for x (m,) in the sense of least squares, by Cholesky on its normal equations.

    Near a singularity the added 1e-14 keeps the matrix positive; a poor step is found out by its residual.
    """
    m = t.shape[0]
    low = np.empty((m, m))
    for i in range(m):
        x[i] = t[i] * c
        for row in range(6):
            x[i] += a[row, i] * b[row]
        for j in range(i + 1):
            total = t[i] * t[j] + (1e-14 if i == j else 0.0)
            for row in range(6):
                total += a[row, i] * a[row, j]
            for k in range(j):
                total -= low[i, k] * low[j, k]
            low[i, j] = math.sqrt(max(total, 1e-16)) if i == j else total / low[j, j]
    for i in range(m):
        for k in range(i):
            x[i] -= low[i, k] * x[k]
        x[i] /= low[i, i]
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            x[i] -= low[k, i] * x[k]
        x[i] /= low[i, i]


@njit(cache=True)
def outside(arm: Constraint, q: Array) -> bool:
    """Return whether any joint is beyond a limit."""
    beyond = False
    for i in range(q.shape[0]):
        beyond = beyond or q[i] < arm.q_min[i] or q[i] > arm.q_max[i]
    return beyond


@njit(cache=True)
def distance(p: Array, q: Array) -> float:
    """Compute |p - q|."""
    total = 0.0
    for i in range(p.shape[0]):
        total += (p[i] - q[i]) ** 2
    return math.sqrt(total)


@njit(cache=True)
def correct(arm: Constraint, q: Array, h: float, tangent: Array, out: Array, a: Array) -> tuple[bool, float]:
    """Go h along the tangent (n,) from q, then by Newton's method across it onto the curve, into `out`.

    Returns whether it converged, and mu there; A (6,m) of that pose is in `a`.
    """
    m = arm.active.shape[0]
    error, t, dq = np.empty(6), np.empty(m), np.empty(m)
    for i in range(q.shape[0]):
        out[i] = q[i] + h * tangent[i]
    for i in range(m):
        t[i] = tangent[arm.active[i]]
    for _ in range(10):
        mu = evaluate(arm, out, error, a)
        worst = 0.0
        for row in range(6):
            worst = max(worst, abs(error[row]))
        if worst < TOLERANCE:
            return True, mu
        bordered(a, t, error, 0.0, dq)
        for i in range(m):
            out[arm.active[i]] += dq[i]
    return False, 0.0


@njit(cache=True)
def turn_tangent(arm: Constraint, a: Array, tangent: Array) -> None:
    """Replace the unit tangent (n,) by that of A (6,m) which points the same way: A t = 0, t_old . t > 0."""
    m = arm.active.shape[0]
    t, new = np.empty(m), np.empty(m)
    for i in range(m):
        t[i] = tangent[arm.active[i]]
    bordered(a, t, np.zeros(6), 1.0, new)
    length = 0.0
    for i in range(m):
        length += new[i] * new[i]
    for i in range(m):
        tangent[arm.active[i]] = new[i] / math.sqrt(length)


@njit(cache=True)
def follow(
    arm: Constraint,
    q_start: Array,
    tangent_start: Array,
    step: float,
    s: Array,
    poses: Array,
    mus: Array,
) -> tuple[int, int]:
    """Fill s, poses, mus from q_start on along the tangent; returns how many, and why it stopped.

    At a joint limit the last step is bisected, so that the last pose lies on the limit to 1e-10 rad. A curve
    that comes back to its start, up to whole turns of a joint, is closed with that pose.
    """
    n = q_start.shape[0]
    q, tangent, trial = q_start.copy(), tangent_start.copy(), np.empty(n)
    a = np.empty((6, arm.active.shape[0]))
    _, mu = correct(arm, q, 0.0, tangent, trial, a)
    s[0], mus[0] = 0.0, mu
    poses[0, :] = q
    count, h = 1, step
    low, high = 0.0, -1.0  # the bracket of the limit, once one has been crossed
    while count < s.shape[0]:
        ok, mu = correct(arm, q, h, tangent, trial, a)
        if high < 0.0 and (not ok or distance(trial, q) > 2.0 * h):
            h *= 0.5
            if h < 1e-3 * step:
                return count, SINGULAR
            continue
        if high >= 0.0 or outside(arm, trial):
            if not ok or outside(arm, trial):
                high = h
            else:
                low = h
                poses[count, :] = trial
                mus[count] = mu
            if high - low > 1e-10:
                h = 0.5 * (low + high)
                continue
            if low < 1e-9:  # it stood on the limit already
                return count, LIMIT
            s[count] = s[count - 1] + distance(poses[count], q)
            return count + 1, LIMIT
        s[count], mus[count] = s[count - 1] + distance(trial, q), mu
        poses[count, :] = trial
        count += 1
        q[:] = trial
        turn_tangent(arm, a, tangent)
        ahead = 0.0
        for i in range(n):
            turns = 0.0 if arm.joints[i, 15] > 0.0 else round((q[i] - q_start[i]) / (2.0 * math.pi))
            trial[i] = q_start[i] + 2.0 * math.pi * turns
            ahead += (trial[i] - q[i]) * tangent[i]
        gap = distance(trial, q)
        back = gap <= 1.01 * step and ahead > 0.0 and not outside(arm, trial)
        if back and count > 3 and count < s.shape[0]:
            last = count if gap > 0.1 * step else count - 1  # no two samples on top of each other
            s[last], mus[last] = s[count - 1] + gap, mus[0]
            poses[last, :] = trial
            return last + 1, CLOSED
        h = min(step, 2.0 * h)
    return count, LENGTH
