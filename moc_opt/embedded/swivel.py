"""The `exact` solver without branches, for arms whose self-motion is one swivel beside idle joints.

Householder reflections turn the five independent rows A x = b of the k = 6 joints that move the tool into a
triangle: x = particular + w z, with z the unit null vector and `particular` the shortest solution. They need
no pivoting and no square of A, so that the same fixed sequence of operations is accurate at every pose where
A has its five ranks. The rest is the ratio test of `moc_opt.solvers.exact.elimination.swivel`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca

from moc_opt.qp.residuals import RANK_TOLERANCE
from moc_opt.solvers.exact.elimination import EMPTY, IDLE_COLUMN, OK, STUCK

SX = Any

_UNBOUNDED = 1e30  # [rad/s] instead of infinity, which times zero is no number


class Triangle(NamedTuple):
    """A^T = Q [R; 0] for A (r, r + 1)."""

    reflections: list[tuple[SX, SX]]
    """(u, beta) of H = I - beta u u^T, in the order in which they were applied"""
    R: SX
    """(r,r) upper triangle"""
    regular: SX
    """whether A has full rank"""

    def rotate(self, x: SX) -> SX:
        """Return Q x (r + 1,)."""
        for u, beta in reversed(self.reflections):
            x = x - beta * ca.dot(u, x) * u
        return x


class Box(NamedTuple):
    """lower <= x <= upper [rad/s]."""

    lower: SX
    upper: SX


class Answer(NamedTuple):
    """Status of the solver."""

    x: SX
    """(n,) [rad/s]; zero where there is none"""
    dual: SX
    """(r,) multipliers of the rows; no meaning where there is no x"""
    status: SX
    """OK, EMPTY or STUCK of `moc_opt.solvers.exact.elimination`"""


def triangulate(A: SX) -> Triangle:
    """Reflect A^T into a triangle (Householder), one reflection a row of A (r, r + 1); zeros of A cost nothing."""
    T = ca.SX(A.T)
    r = T.shape[1]
    reflections, diagonal = [], []
    for i in range(r):
        column = T[i:, i]
        length = ca.norm_2(column)
        turned = ca.if_else(column[0] < 0, length, -length)  # away from the column: no cancellation
        u = ca.vertcat(ca.SX.zeros(i), column[0] - turned, column[1:])
        reaches = length > 0
        beta = ca.if_else(reaches, -1 / ca.if_else(reaches, turned * u[i], -1), 0)
        for j in range(i + 1, r):
            T[:, j] = T[:, j] - beta * ca.dot(u, T[:, j]) * u
        T[i, i] = turned
        reflections.append((u, beta))
        diagonal.append(length)
    largest = smallest = diagonal[0]
    for length in diagonal[1:]:
        largest, smallest = ca.fmax(largest, length), ca.fmin(smallest, length)
    return Triangle(reflections, ca.triu(T[:r, :]), smallest > RANK_TOLERANCE * largest)


def null_vector(triangle: Triangle) -> SX:
    """Return the unit z (r + 1,) with A z = 0, also where A has lost rank."""
    r = triangle.R.shape[0]
    return triangle.rotate(ca.vertcat(ca.SX.zeros(r), 1))


def solve(
    triangle: Triangle, z: SX, b: SX, gradient: SX, box: Box, active: list[int], *,
    c2: float, rho: float, tolerance: float,
) -> Answer:  # fmt: skip
    """Maximise c2 gradient . x - rho/2 |x|^2 on A x = b inside the box.

    Args:
        triangle, z: of A (r, r + 1), the rows of the active joints.
        b: (r,).
        gradient: (n,) of mu; zero for the joints that are not active.
        box: for all n joints.
        active: the r + 1 joints that move the tool; the others rest, as near to zero as their box allows.
        tolerance: box violation that still counts as feasible [rad/s].
    """
    R, r, n = triangle.R, len(active) - 1, gradient.shape[0]
    regular = triangle.regular
    pivots = ca.if_else(regular, ca.diag(R), 1)
    forward: list[SX] = []
    for i in range(r):  # R^T y = b
        forward.append((b[i] - sum((R[j, i] * forward[j] for j in range(i)), ca.SX(0))) / pivots[i])
    particular = triangle.rotate(ca.vertcat(*forward, 0))

    low, high = ca.SX(-_UNBOUNDED), ca.SX(_UNBOUNDED)
    levers = ca.SX(1), ca.SX(1)
    joints = ca.SX(-1), ca.SX(-1)
    g, lower, upper = (ca.vertcat(*(values[j] for j in active)) for values in (gradient, *box))
    for i in range(r + 1):
        moves = ca.fabs(z[i]) > IDLE_COLUMN
        slope = 1 / ca.if_else(moves, z[i], 1)
        ends = (lower[i] - particular[i]) * slope, (upper[i] - particular[i]) * slope
        first = ca.if_else(moves, ca.fmin(*ends), -_UNBOUNDED)
        last = ca.if_else(moves, ca.fmax(*ends), _UNBOUNDED)
        raises, sinks = first > low, last < high
        levers = ca.if_else(raises, z[i], levers[0]), ca.if_else(sinks, z[i], levers[1])
        joints = ca.if_else(raises, i, joints[0]), ca.if_else(sinks, i, joints[1])
        low, high = ca.if_else(raises, first, low), ca.if_else(sinks, last, high)

    pull = c2 * ca.dot(g, z)
    best = pull / rho if rho > 0.0 else _UNBOUNDED * ca.sign(pull)
    above, below = best > high, best < low
    w = ca.if_else(above, high, ca.if_else(below, low, best))
    x = particular + w * z
    inside = low <= high + tolerance
    for i in range(r + 1):
        inside = ca.logic_and(inside, x[i] >= lower[i] - tolerance)
        inside = ca.logic_and(inside, x[i] <= upper[i] + tolerance)
    x = ca.fmin(ca.fmax(x, lower), upper)
    status = ca.if_else(regular, ca.if_else(inside, OK, EMPTY), STUCK)
    answered = status == OK

    # A^T y + rho x - c2 g is the force of the binding bound, and zero on the other joints.
    force = rho * x - c2 * g
    bound = ca.if_else(above, joints[1], ca.if_else(below, joints[0], -1))
    lever = ca.if_else(above, levers[1], ca.if_else(below, levers[0], 1))
    reaction = ca.dot(z, force) / lever
    right = ca.vertcat(*(ca.if_else(bound == i, reaction, 0) for i in range(r + 1))) - force
    for u, beta in triangle.reflections:
        right = right - beta * ca.dot(u, right) * u
    dual: list[SX] = [ca.SX(0)] * r
    for i in reversed(range(r)):  # R y = Q^T right
        dual[i] = (right[i] - sum((R[i, j] * dual[j] for j in range(i + 1, r)), ca.SX(0))) / pivots[i]

    full = [ca.fmin(ca.fmax(0, box.lower[j]), box.upper[j]) for j in range(n)]
    for i, j in enumerate(active):
        full[j] = x[i]
    return Answer(ca.if_else(answered, ca.vertcat(*full), 0), ca.vertcat(*dual), status)
