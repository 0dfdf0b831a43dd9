"""The smallest and the largest cost over all x that satisfy A x = b and the bounds.

Let x = x0 + Z w, where A x0 = b and Z is an orthonormal basis of ker A. The cost is slope^T w + rho/2 |w|^2, and the
bounds are low <= Z w <= high. A box width is the largest entry of high - low.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations, product
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array

MOST_CORNERS = 10_000  # with more corners to try (dim(ker A) active bounds), the largest cost is searched only locally
FAR = 1e3  # length of a proximal step that meets no bound [box widths]
ROUNDS, STEPS = 200, 20  # at most ROUNDS proximal steps to the smallest cost, and STEPS * n steps to the largest cost
ROUNDING = 1e-14  # rounding error of numbers of order one
SETTLED = 1e-11  # a shorter proximal step ends the search
FLAT = 1e-9  # a slope or multiplier below this fraction of the largest one counts as zero
STILL = 1e-10  # a joint with a shorter row of Z does not move in ker A, and its bounds are ignored
TOUCHING = 1e-8  # if the feasible set is a point, the bounds are widened by this [box widths]
LEVEL = 1e-12  # a scaled cost that varies by less counts as constant


class Extremes(NamedTuple):
    """Smallest and largest cost on the feasible set, relative to the cost at w = 0.

    Attributes:
        w: (r,) a point of smallest cost.
        least: a lower bound on the cost, by weak duality. If w is optimal, this bound equals the cost of w.
        most: the largest cost. With rho > 0 and more than `MOST_CORNERS` corners, it may be only a local maximum.
        pull: (n,) gradient of cost + y^T (A x - b) at w = 0, with the optimum's multipliers y.
    """

    w: Array
    least: float
    most: float
    pull: Array


def extremes(Z: Array, low: Array, high: Array, slope: Array, rho: float) -> Extremes | None:
    """Find the smallest and largest slope^T w + rho/2 |w|^2 over low <= Z w <= high; None if no w is feasible.

    Z (n, r) has orthonormal columns. ``low`` and ``high`` (n,) [rad/s] are finite. If ``slope`` (r,) is zero, rho
    must be positive.
    """
    width = max(float((high - low).max()), 1e-12)
    steep = max(float(np.linalg.norm(slope)), rho * width)
    low, high, slope, rho = low / width, high / width, slope / steep, rho * width / steep
    found = optimum(Z, low, high, slope, rho)
    if found is None:
        return None
    w, force = found
    pull = Z @ slope + force - Z @ (Z.T @ force)
    least = _lower_bound(low, high, pull, rho)
    most = _largest(Z, low, high, slope, rho, w)
    if most - least <= LEVEL:
        most = least
    return Extremes(width * w, steep * width * least, steep * width * most, steep * pull)


def optimum(Z: Array, low: Array, high: Array, slope: Array, rho: float) -> tuple[Array, Array] | None:
    """Return (w, f): the w (r,) of smallest cost, and the multipliers f (n,) of its bounds; None if no w is feasible.

    The method uses proximal steps (Ferris 1991, Finite termination of the proximal point algorithm).
    """
    w = np.zeros(len(slope))
    if rho * FAR >= np.linalg.norm(slope):
        found = nearest(Z, low, high, -slope / rho)
        return None if found is None else (found[0], rho * found[1])
    weight = rho + 1.0 / FAR
    force = np.zeros(len(low))
    for _ in range(ROUNDS):
        found = nearest(Z, low, high, (w / FAR - slope) / weight)
        if found is None:
            return None
        before, w, force = w, found[0], weight * found[1]
        if np.abs(w - before).max() <= SETTLED:
            break
    return w, force


def nearest(Z: Array, low: Array, high: Array, start: Array) -> tuple[Array, Array] | None:
    """Return (w, f): the w (r,) nearest to ``start`` with low <= Z w <= high, and f (n,) with w - start = Z^T f.

    f is positive at active lower bounds, negative at active upper ones. Return None if no w is feasible. The method is
    non-negative least squares (Lawson, Hanson, Solving Least Squares Problems, 1974, chapter 23).
    """
    # Each row of G has length 1, so that an error means the same distance in w for every joint.
    moves = np.linalg.norm(Z, axis=1)
    moves = np.where(moves > STILL, moves, np.inf)
    G, away = Z / moves[:, None], Z @ start
    G, short = np.vstack([G, -G]), np.concatenate([low - away, away - high]) / np.tile(moves, 2)
    size = float(short.max())
    if size <= 0.0:
        return start, np.zeros(len(low))
    from scipy.optimize import nnls  # a slow import

    for loose in (0.0, TOUCHING):
        u, _ = nnls(np.vstack([G.T, (short - loose) / size]), np.append(np.zeros(len(start)), 1.0))
        left = 1.0 - float((short - loose) @ u) / size
        if u.max() * size <= left / TOUCHING:
            break
    if left <= 1e-12:
        return None
    active = u > 0.0
    u *= size / left
    # Usually, the active bounds, solved as equations, give a more exact step than G^T u.
    step, *_ = np.linalg.lstsq(G[active], short[active], rcond=None)
    if (short - G @ step).max() > max((short - G @ (G.T @ u)).max(), 0.0) + ROUNDING:
        step = G.T @ u
    return start + step, (u[: len(low)] - u[len(low) :]) / moves


def _lower_bound(low: Array, high: Array, pull: Array, rho: float) -> float:
    best = np.clip(-pull / rho, low, high) if rho > 0.0 else np.where(pull > 0.0, low, high)
    return float((pull * best + 0.5 * rho * best**2).sum())


def _largest(Z: Array, low: Array, high: Array, slope: Array, rho: float, w: Array) -> float:
    n, r = Z.shape
    if rho == 0.0:
        found = optimum(Z, low, high, -slope, 0.0)
        return float(slope @ (w if found is None else found[0]))
    if comb(n, r) << r <= MOST_CORNERS:  # w counts too: rounding may leave no feasible corner
        return max(float(slope @ w + 0.5 * rho * w @ w), _largest_corner(Z, low, high, slope, rho))
    axis = np.eye(r)[0]
    return max(_uphill(Z, low, high, slope, rho, w, way=way) for way in (slope, -slope, axis, -axis))


def _uphill(Z: Array, low: Array, high: Array, slope: Array, rho: float, w: Array, way: Array) -> float:
    n, r = Z.shape
    active: list[int] = []
    side, moved = np.zeros(n), Z @ w
    most = float(slope @ w + 0.5 * rho * w @ w)
    for _ in range(STEPS * n):
        if active:
            way = slope + rho * w
            basis, corner = np.linalg.qr(Z[active].T)
            flat = way - basis @ (basis.T @ way)
            if len(active) == r or np.linalg.norm(flat) <= FLAT * np.linalg.norm(way):
                pull = side[active] * np.linalg.solve(corner, basis.T @ way)
                if pull.min() >= -FLAT * np.abs(pull).max():
                    break
                del active[int(np.argmin(pull))]
                continue
            way = flat
        rise = Z @ way
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(rise > 0.0, (high - moved) / rise, (low - moved) / rise)
        room[np.abs(rise) <= FLAT * np.linalg.norm(way)] = np.inf
        room[active] = np.inf
        j = int(np.argmin(room))
        if not np.isfinite(room[j]):
            break
        w = w + max(float(room[j]), 0.0) * way
        moved = Z @ w
        active.append(j)
        side[j] = np.sign(rise[j])
        most = max(most, float(slope @ w + 0.5 * rho * w @ w))
    return most


def _largest_corner(Z: Array, low: Array, high: Array, slope: Array, rho: float) -> float:
    n, r = Z.shape
    joints, sides = _choices(n, r)
    basis = Z[joints]
    sound = np.abs(np.linalg.det(basis)) > 1e-9
    joints, basis = joints[sound], basis[sound]
    ends = np.stack([low[joints], high[joints]], axis=-1)  # (k, r, 2)
    bounds = ends[:, np.arange(r), sides]  # (k, 2^r, r)
    w = np.linalg.solve(basis, np.swapaxes(bounds, 1, 2))  # (k, r, 2^r)
    moved = Z @ w
    inside = (moved >= low[:, None] - 1e-9) & (moved <= high[:, None] + 1e-9)
    costs = np.einsum("krs,r->ks", w, slope) + 0.5 * rho * (w**2).sum(1)
    return float(np.where(inside.all(1), costs, -np.inf).max(initial=-np.inf))


@lru_cache(maxsize=8)
def _choices(n: int, r: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    return np.array(list(combinations(range(n), r))), np.array(list(product((0, 1), repeat=r)))
