"""Non-optimal corners of feasible sets. The optimum is found by trying all active sets."""

from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.qp.problem import NullSpaceQP
from tests.problems import changed, random_problem

Array = NDArray[np.float64]


class Wrong(NamedTuple):
    """A subproblem, a corner x of its feasible set, and (cost of x - optimum) / (largest cost - optimum)."""

    qp: NullSpaceQP
    x: Array
    share: float


def kernel(qp: NullSpaceQP) -> Array:
    """Return orthonormal columns (n, r) that span ker A. A must have rank five."""
    return np.linalg.svd(qp.A)[2][5:].T


def cost(qp: NullSpaceQP, x: Array) -> Array:
    """Return the cost without the part that is constant on A x = b."""
    return 0.5 * qp.regularization * (x**2).sum(-1) - qp.c2 * x @ qp.grad_mu


def candidates(qp: NullSpaceQP, Z: Array, base: Array, *, damped: bool) -> Array:
    """Return the feasible corners (k, n) in base + span Z. With `damped` and rho > 0, add the optima on faces."""
    n, r = Z.shape
    found, width = [], float((qp.upper - qp.lower).max())
    for k in range(r + 1) if damped and qp.regularization > 0.0 else (r,):
        sides = np.array(list(product((0, 1), repeat=k))).reshape(2**k, k)
        for joints in map(list, combinations(range(n), k)):
            C = Z[joints]
            if k and np.linalg.svd(C)[1].min() < 1e-7:
                continue
            at = np.where(sides == 0, qp.lower[joints], qp.upper[joints])
            w = (at - base[joints]) @ np.linalg.pinv(C).T if k else np.zeros((1, r))
            if k < r:
                free = np.linalg.svd(C)[2][k:] if k else np.eye(r)
                w = w + ((Z.T @ (qp.c2 * qp.grad_mu / qp.regularization - base)) - w) @ free.T @ free
            points = base + w @ Z.T
            points[:, joints] = at
            found.append(points)
    points = np.concatenate(found)
    slack = 1e-9 * width
    return points[((points >= qp.lower - slack) & (points <= qp.upper + slack)).all(1)]


def wrong_corners(
    seed: int, n: int, count: int, *, tilt: float = 1.0, size: float = 1.0, regularization: float = 0.0,
    least: float = 0.05
) -> list[Wrong]:
    """Return corners with `share` > `least`. All speeds are scaled by `size`."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        qp = random_problem(rng, n, structured=False)
        x, Z, g = size * np.linalg.lstsq(qp.A, qp.b, rcond=1e-9)[0], kernel(qp), qp.grad_mu
        along = Z @ (Z.T @ g)
        across = g - along
        if tilt < 1.0:  # |part of g in ker A| becomes `tilt` times |part of g orthogonal to ker A|
            g = across / np.linalg.norm(across) + tilt * along / np.linalg.norm(along)
        rho = regularization * qp.c2 * np.linalg.norm(Z.T @ g) / size
        parts = {name: size * getattr(qp, name) for name in ("v_tip", "v_wrist", "lower", "upper")}
        qp = changed(qp, **parts, grad_mu=g, regularization=rho)
        points, others = (candidates(qp, Z, x, damped=damped) for damped in (False, True))
        costs, best = cost(qp, points), cost(qp, others).min()
        share = (costs - best) / (costs.max() - best)
        bad = np.flatnonzero(share > least)
        found += [Wrong(qp, points[i], float(share[i])) for i in rng.permutation(bad)[:4]]
    return found
