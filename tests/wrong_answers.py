"""Wrong answers that satisfy everything but the one thing that is checked: each is feasible, none is optimal.

The feasible set is a box cut by A x = b: at a corner r joints are at their bounds and the others follow. How wrong a
corner is, is found by going through all of them, without the solvers and without the judge.
"""

from __future__ import annotations

from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.qp.problem import NullSpaceQP
from tests.problems import random_problem

Array = NDArray[np.float64]


class Wrong(NamedTuple):
    """A subproblem, a corner x of its feasible set, and the share of the cost's range that x gives away."""

    qp: NullSpaceQP
    x: Array
    share: float


def kernel(qp: NullSpaceQP) -> Array:
    """Orthonormal columns (n, r) of ker A; the rank of A is five, as tip and wrist are tied."""
    return np.linalg.svd(qp.A)[2][5:].T


def corners(qp: NullSpaceQP, x: Array) -> Array:
    """All corners (k, n) of the feasible set, which passes through x: r joints at their bounds."""
    Z = kernel(qp)
    n, r = Z.shape
    found = []
    for joints in map(list, combinations(range(n), r)):
        if abs(np.linalg.det(Z[joints])) < 1e-6:
            continue
        sides = np.array(list(product((0, 1), repeat=r)))
        bounds = np.where(sides == 0, qp.lower[joints], qp.upper[joints])
        points = x + (Z @ np.linalg.solve(Z[joints], (bounds - x[joints]).T)).T
        points[:, joints] = bounds
        found.append(points)
    points = np.concatenate(found)
    width = (qp.upper - qp.lower).max()
    inside = (points >= qp.lower - 1e-10 * width) & (points <= qp.upper + 1e-10 * width)
    return points[inside.all(1)]


def cost(qp: NullSpaceQP, x: Array) -> Array:
    """What is left of the cost on A x = b."""
    return 0.5 * qp.regularization * (x**2).sum(-1) - qp.c2 * x @ qp.grad_mu


def changed(qp: NullSpaceQP, x: Array, tilt: float, size: float, regularization: float) -> tuple[NullSpaceQP, Array]:
    """The problem with its reduced gradient ``tilt`` of |grad_mu|, and with velocities and box ``size`` times as large.

    The regularization is in proportion to the reduced gradient: 0.3 of what would stop the elbow at one rad/s.
    """
    Z, g = kernel(qp), np.array(qp.grad_mu)
    along = Z @ (Z.T @ g)
    across = g - along
    if tilt < 1.0:
        g = across / np.linalg.norm(across) + tilt * along / np.linalg.norm(along)
    pull = qp.c2 * np.linalg.norm(Z.T @ g)
    made = NullSpaceQP(
        qp.J_tip, qp.J_wrist, size * qp.v_tip, size * qp.v_wrist, g, size * qp.lower, size * qp.upper,
        regularization=regularization * pull / size,
    )  # fmt: skip
    return made, size * x


def wrong_corners(
    seed: int, n: int, count: int, *, tilt: float = 1.0, size: float = 1.0, regularization: float = 0.0,
    least: float = 0.05
) -> list[Wrong]:
    """Corners that give away more than ``least`` of the range, of ``count`` random arms of n joints."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        qp = random_problem(rng, n, structured=False)
        x = np.linalg.lstsq(qp.A, qp.b, rcond=1e-9)[0]
        qp, x = changed(qp, x, tilt, size, regularization)
        points = corners(qp, x)
        costs = cost(qp, points)
        best = min(costs.min(), smallest_cost(qp, points)) if regularization > 0.0 else costs.min()
        share = (costs - best) / (costs.max() - best)
        bad = np.flatnonzero(share > least)
        found += [Wrong(qp, points[i], float(share[i])) for i in rng.permutation(bad)[:4]]
    return found


def smallest_cost(qp: NullSpaceQP, points: Array) -> float:
    """Smallest damped cost over the hull of the corners, by Frank-Wolfe with away steps (Guelat and Marcotte 1986)."""
    weights = np.zeros(len(points))
    weights[np.argmin(cost(qp, points))] = 1.0
    for _ in range(3000):
        x = weights @ points
        slope = points @ (qp.regularization * x - qp.c2 * qp.grad_mu)
        to, off = int(np.argmin(slope)), int(np.argmax(np.where(weights > 0.0, slope, -np.inf)))
        here = weights @ slope
        if here - slope[to] >= slope[off] - here:
            d, most = -weights, 1.0
            d[to] += 1.0
        else:
            d, most = np.array(weights), weights[off] / max(1.0 - weights[off], 1e-300)
            d[off] -= 1.0
        move, gain = d @ points, -(d @ slope)
        if gain <= 1e-13 * np.abs(slope).max():
            break
        weights = np.maximum(weights + min(most, gain / max(qp.regularization * move @ move, 1e-300)) * d, 0.0)
        weights /= weights.sum()
    return float(cost(qp, weights @ points))
