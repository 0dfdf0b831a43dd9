"""Residuals of an answer to the null-space subproblem: one definition for every solver.

The subproblem (problem.py) is min 1/2 x^T P x + p^T x s.t. A x = b, lower <= x <= upper. Its cost has the terms
-c2 x^T pull and rho/2 |x|^2, and two terms with weights c0 and c1 that are constant if A x = b. y are the duals of
A x = b. The natural residual is the largest entry of ``|x - clip(x - (P x + p + A^T y), lower, upper)|`` (Facchinei &
Pang 2003, section 1.5.2). If A x = b, it is zero exactly at a KKT point. A joint is idle if its column of A is zero.
"""

from __future__ import annotations

import itertools
from functools import lru_cache
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.qp.extremes import ROUNDING, STILL, extremes

# The sixth singular value of A counts as zero below TIED |A|_F, any other singular value below RANK_TOLERANCE |A|_F.
# If the Jacobians are rounded to 7 decimals, the sixth value can reach 8e-8 |A|_F.
TIED = 1e-7
RANK_TOLERANCE = 1e-12
GRADIENT_ROUNDING = 1e-9  # the part of pull in ker A counts as zero below this fraction of |pull|_inf
A_POINT = 1e-9  # a shorter feasible interval counts as a point [rad/s]
FEASIBLE = 1e-6
"""If no x is feasible, the bounds are widened by up to this [rad/s]. If an x then is feasible, the feasible set counts
as a point. If none is, the problem is infeasible."""
MOST_FACETS = 300  # if `_facets` gives more directions, ``natural_best`` uses the optimum's y instead of the best y
TIED_BY_ROUNDING = 1e-14  # a sixth singular value below this share of |A|_F is a rounding error
NEARLY_SINGULAR = 1e-3  # with a smaller singular value (share of |A|_F), A d = r is solved by iterative refinement
REFINEMENTS = 3  # steps of this refinement


class Residuals(NamedTuple):
    """How far an answer is from the optimum. Each entry is a float or an array of the batch shape.

    Attributes:
        primal: max(|A x - b|_inf, violation of the bounds) [m/s or rad/s].
        natural: natural residual with the solver's y. If the solver gave no y, it equals ``natural_best``.
        natural_best: smallest natural residual over all y.
        relative: ``natural_best`` after dividing the cost by max(c2 |Z Z^T pull|_inf, rho times 1 rad/s). The
            columns of Z are an orthonormal basis of ker A.
        loss: (cost of x - smallest cost) / (largest - smallest cost) over the feasible set, in [0, 1]. It is 0 if all
            feasible points have the same cost.
        distance: |x - x*|_inf to the nearest optimum x* [rad/s]. If no point is feasible, the distance is infinite.

    Example:
        >>> from moc_opt.qp.residuals import Residuals
        >>> near = Residuals(primal=1e-9, natural=1e-9, natural_best=1e-9, relative=1e-7, loss=0.0, distance=1e-8)
        >>> bool(near.verified()), bool(near._replace(loss=0.2, distance=0.1).verified())
        (True, False)
    """

    primal: Array
    natural: Array
    natural_best: Array
    relative: Array
    loss: Array
    distance: Array

    def verified(self, primal: float = 1e-6, relative: float = 1e-3, loss: float = 1e-2) -> NDArray[np.bool_]:
        """Return whether the answer is optimal within these tolerances (bool, batch shape).

        The answer has to be feasible within ``primal``. In addition, either ``distance`` is at most ``primal``, or
        ``relative`` and ``loss`` are at most their tolerances.
        """
        near = np.less_equal(self.distance, primal)
        good = np.less_equal(self.relative, relative) & np.less_equal(self.loss, loss)
        return np.less_equal(self.primal, primal) & (near | good)


class Problem(NamedTuple):
    """The arrays of a subproblem; each may have a leading batch shape."""

    A: Array  # (..., 6, n)
    b: Array  # (..., 6)
    pull: Array  # (..., n)
    lower: Array  # (..., n)
    upper: Array  # (..., n)
    weights: Array  # (..., 4): c0, c1, c2, rho


def residuals(problem: Problem, x: Array, y: Array | None = None) -> Residuals:
    """Compute the residuals of answers ``x`` (..., n) and their duals ``y`` (..., 6).

    If a row of ``x`` is not finite, its residuals are infinite and its loss is 1. A row of ``y`` that is not finite
    counts as not given.
    """
    shape = x.shape[:-1]
    n = x.shape[-1]
    ends = [f.shape[-2:] if f is problem.A else f.shape[-1:] for f in problem]
    flat = Problem(*(np.broadcast_to(f, shape + e).reshape(-1, *e) for f, e in zip(problem, ends, strict=True)))
    x = x.reshape(-1, n)
    finite = np.all(np.isfinite(x), axis=-1)
    x = np.where(finite[:, None], x, 0.0)
    slack = np.einsum("kij,kj->ki", flat.A, x) - flat.b
    outside = np.maximum(np.maximum(flat.lower - x, x - flat.upper), 0.0)
    primal = np.maximum(np.abs(slack).max(-1), outside.max(-1))

    size = np.abs(flat.pull).max(-1)
    best, relative, loss, distance = figures = np.zeros((4, len(x)))
    for rows, joints in _idle_patterns(flat.A):
        figures[:, rows] = _idle_joints(_some(flat, rows, ~joints), x[np.ix_(rows, ~joints)], size[rows])
        for these, factors in _by_rank(flat.A[rows][:, :, joints]):
            chosen = rows[these]
            one = _some(flat, chosen, joints)
            judged = _moving_joints(one, x[np.ix_(chosen, joints)], factors, size[chosen])
            figures[:, chosen] = np.maximum(figures[:, chosen], judged)

    natural = best.copy()
    if y is not None:
        y = np.broadcast_to(y, (*shape, 6)).reshape(-1, 6)
        given = np.all(np.isfinite(y), axis=-1)
        c0, c1, c2, rho = flat.weights.T
        rows6 = slack * np.repeat(np.stack([c0, c1], -1), 3, axis=-1) + np.where(given[:, None], y, 0.0)
        full = np.einsum("kij,ki->kj", flat.A, rows6) + rho[:, None] * x - c2[:, None] * flat.pull
        own = np.abs(x - np.clip(x - full, flat.lower, flat.upper)).max(-1)
        natural = np.where(given, own, best)
    for figure in (primal, natural, best, relative, distance):
        figure[~finite] = np.inf
    loss[~finite] = 1.0
    return Residuals(*(f.reshape(shape) for f in (primal, natural, best, relative, loss, distance)))


class _Factors(NamedTuple):
    """Pseudo-inverses of matrices A of equal rank, and bases Z of their kernels."""

    inverse: Array  # (k, n, 6)
    Z: Array  # (k, n, n - rank), orthonormal
    exactly: bool  # whether A is nearly singular, so that `slid` computes products in twice the precision

    def slid(self, A: Array, x: Array, b: Array) -> Array:
        """Return the shortest d (k, n, m) with A (x - d) = b."""
        if not self.exactly:
            return self.inverse @ (A @ x - b)
        d, rows = np.zeros_like(x), np.concatenate([A, -A, np.broadcast_to(-np.eye(6), (len(A), 6, 6))], axis=2)
        for _ in range(REFINEMENTS):
            d = d + self.inverse @ _product(rows, np.concatenate([x, d, b], axis=1))
        return d


def _product(A: Array, x: Array) -> Array:
    """Multiply A by x as if in twice the precision (Ogita, Rump and Oishi 2005, Dot2)."""
    a, b = np.broadcast_arrays(A[:, :, None], np.swapaxes(x, 1, 2)[:, None])
    (a_high, a_low), (b_high, b_low) = ((high := (c := 134217729.0 * v) - (c - v), v - high) for v in (a, b))
    products = a * b
    errors = a_low * b_low - (((products - a_high * b_high) - a_low * b_high) - a_high * b_low)
    total, left = np.zeros(a.shape[:-1]), errors.sum(axis=-1)
    for term in np.moveaxis(products, -1, 0):
        after = total + term
        part = after - total
        left, total = left + ((total - (after - part)) + (term - part)), after
    return np.asarray(total + left)


def _by_rank(A: Array) -> list[tuple[NDArray[np.intp], _Factors]]:
    plain, factors = _rank_five(A)
    groups, others = [(plain, factors)] if plain.size else [], np.setdiff1d(np.arange(len(A)), plain)
    U, s, vh = np.linalg.svd(A[others], full_matrices=True)
    ranked, V = ranks(s), np.swapaxes(vh, 1, 2)
    least = np.where(np.arange(s.shape[1]) < ranked[:, None], s, np.inf).min(axis=1, initial=np.inf)
    kinds = 2 * ranked + (least < NEARLY_SINGULAR * np.linalg.norm(s, axis=1))
    for kind in np.unique(kinds):
        rows, rank = np.flatnonzero(kinds == kind), kind // 2
        inverse = V[rows, :, :rank] / s[rows, None, :rank] @ np.swapaxes(U[rows, :, :rank], 1, 2)
        found = _Factors(inverse, V[rows, :, rank:], bool(kind % 2))
        if found.exactly:
            zero = np.zeros((len(rows), 6, found.Z.shape[2]))
            found = found._replace(Z=found.Z - found.slid(A[others[rows]], found.Z, zero))
        groups.append((others[rows], found))
    return groups


def _rank_five(A: Array) -> tuple[NDArray[np.intp], _Factors]:
    """Factorize by QR the matrices that provably have rank 5 and no small singular value."""
    size = _or_one(np.linalg.norm(A, axis=(1, 2)))[:, None, None]
    Q, R = np.linalg.qr(np.swapaxes(A / size, 1, 2), mode="complete")
    diagonal = np.abs(np.diagonal(R, axis1=1, axis2=2))
    tied = diagonal[:, 5:].max(1, initial=np.inf if A.shape[2] < 6 else 0.0) < TIED_BY_ROUNDING
    rows = np.flatnonzero(tied & (diagonal[:, :5].min(1, initial=np.inf) > NEARLY_SINGULAR))
    top = R[rows, :5]
    inverse = np.linalg.inv(top @ np.swapaxes(top, 1, 2))
    good = np.linalg.norm(inverse, axis=(1, 2)) < NEARLY_SINGULAR**-2
    rows, Q = rows[good], Q[rows[good]]
    return rows, _Factors(Q[:, :, :5] @ (inverse[good] @ top[good]) / size[rows], Q[:, :, 5:], False)


def ranks(s: Array) -> NDArray[np.intp]:
    """Return the ranks of matrices with six rows, from their singular values in descending order."""
    least = np.where(np.arange(s.shape[-1]) < 5, RANK_TOLERANCE, TIED)
    return (s > least * np.linalg.norm(s, axis=-1, keepdims=True)).sum(-1)


def _idle_patterns(A: Array) -> list[tuple[NDArray[np.intp], NDArray[np.bool_]]]:
    moves = np.linalg.norm(A, axis=1) > RANK_TOLERANCE * np.linalg.norm(A, axis=(1, 2))[:, None]
    if (moves == moves[:1]).all():  # the usual case, in which the slow `unique` is avoided
        return [(np.arange(len(A)), pattern) for pattern in moves[:1]]
    patterns, which = np.unique(moves, axis=0, return_inverse=True)
    return [(np.flatnonzero(which.ravel() == i), pattern) for i, pattern in enumerate(patterns)]


def _some(problem: Problem, rows: NDArray[np.intp], joints: NDArray[np.bool_]) -> Problem:
    A, b, pull, lower, upper, weights = (f[rows] for f in problem)
    return Problem(A[:, :, joints], b, pull[:, joints], lower[:, joints], upper[:, joints], weights)


def _gradient(pull: Array, size: Array) -> Array:
    largest = np.abs(pull).max(-1, initial=0.0)
    return np.where((largest > GRADIENT_ROUNDING * size)[:, None], pull, 0.0)


def _idle_joints(problem: Problem, x: Array, size: Array) -> Array:
    _, _, c2, rho = problem.weights.T
    worst = np.zeros((4, len(x)))
    for j in range(x.shape[1]):
        here, low, high = x[:, j], problem.lower[:, j], problem.upper[:, j]
        push = c2 * _gradient(problem.pull[:, j : j + 1], size)[:, 0]
        slope, scale = rho * here - push, np.maximum(np.abs(push), rho)
        natural, relative = (np.abs(here - np.clip(here - s, low, high)) for s in (slope, slope / _or_one(scale)))
        step, loss, _ = _on_an_interval(slope, rho, low - here, high - here)
        worst = np.maximum(worst, [natural, relative, loss, np.abs(step)])
    return worst


def _moving_joints(problem: Problem, x: Array, factors: _Factors, size: Array) -> Array:
    _, _, c2, rho = problem.weights.T
    Z, (n, r) = factors.Z, factors.Z.shape[1:]
    slid = factors.slid(problem.A, x[..., None], problem.b[..., None])[..., 0]
    exact = x - slid
    above = np.einsum("kn,kn->k", slid, 0.5 * rho[:, None] * (x + exact) - c2[:, None] * problem.pull)
    along = _gradient(np.einsum("kni,kmi,km->kn", Z, Z, problem.pull), size)
    scale = np.maximum(c2 * np.abs(along).max(-1, initial=0.0), rho)
    low, high = problem.lower - exact, problem.upper - exact
    if r == 0:
        moved, loss, gap = np.zeros(x.shape), np.zeros(len(x)), above
        natural = np.zeros((2, len(x)))
    else:
        slope = np.einsum("kni,kn->ki", Z, rho[:, None] * exact - c2[:, None] * along)
        if r == 1:
            moved, loss, gap = _along_a_line(Z[:, :, 0], slope[:, 0], rho, low, high, above)
        else:
            moved, loss, gap, pull = _in_a_polytope(Z, slope, rho, low, high, above)
        both = np.array([np.ones(len(x)), 1.0 / _or_one(scale)])[:, :, None]
        if comb(n, r - 1) <= MOST_FACETS:
            natural = _best_natural(problem, x, Z, both * slope)
        else:
            natural = np.abs(x - np.clip(x - both * pull, problem.lower, problem.upper)).max(-1)
    distance = np.abs(exact + moved - x).max(-1, initial=0.0)
    return np.stack([natural[0], np.maximum(natural[1], gap / _or_one(scale)), loss, distance])


def _or_one(scale: Array) -> Array:
    return np.where(scale > 0.0, scale, 1.0)


def _on_an_interval(
    slope: Array, rho: Array, low: Array, high: Array, above: Array | float = 0.0, point: Array | float = A_POINT
) -> tuple[Array, Array, Array]:
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        free = np.where(slope == 0.0, 0.0, -slope / rho)  # infinite if rho = 0
        best = np.clip(free, low, high)
        least, *ends = (s * (slope + 0.5 * rho * s) for s in (best, low, high))
        spread = np.where(high - low > point, np.maximum(*ends) - least, 0.0)
        loss = np.where(spread > 0.0, np.clip((above - least) / _or_one(spread), 0.0, 1.0), 0.0)
        return best, loss, np.where(spread > 0.0, 0.0, above - least)


def _along_a_line(
    z: Array, slope: Array, rho: Array, low: Array, high: Array, above: Array
) -> tuple[Array, Array, Array]:
    moving = np.abs(z) > STILL
    per_step = np.where(moving, z, 1.0)

    def interval(beyond: float) -> tuple[Array, Array, Array]:
        ends = np.stack([(low - beyond) / per_step, (high + beyond) / per_step])
        first, last = np.where(moving, ends.min(0), -np.inf), np.where(moving, ends.max(0), np.inf)
        stops = np.stack([first.argmax(-1), last.argmin(-1)], axis=-1)
        return first.max(-1), last.min(-1), np.take_along_axis(np.abs(per_step), stops, axis=-1).min(-1)

    (first, last, slowest), (wide_first, wide_last, _) = interval(0.0), interval(FEASIBLE)
    empty, middle = wide_first > wide_last, np.clip(0.5 * (first + last), wide_first, wide_last)
    low, high = (np.where(first > last, middle, end) for end in (first, last))
    step, loss, gap = _on_an_interval(slope, rho, low, high, above, A_POINT + ROUNDING / slowest)
    return np.where(empty[:, None], np.inf, step[:, None] * z), np.where(empty, 1.0, loss), np.where(empty, np.inf, gap)


def _in_a_polytope(
    Z: Array, slope: Array, rho: Array, low: Array, high: Array, above: Array
) -> tuple[Array, Array, Array, Array]:
    moved, loss, gap = np.zeros(low.shape), np.zeros(len(low)), np.zeros(len(low))
    pull = np.einsum("kni,ki->kn", Z, slope)
    for i in np.flatnonzero((slope != 0.0).any(-1) | (rho > 0.0)):
        for beyond in (0.0, 1e-13, 1e-10, FEASIBLE):
            found = extremes(Z[i], low[i] - beyond, high[i] + beyond, slope[i], rho[i])
            if found is not None:
                break
        if found is None:
            moved[i], loss[i], gap[i] = np.inf, 1.0, np.inf
            continue
        moved[i], pull[i] = Z[i] @ found.w, found.pull
        if beyond > 0.0 or not found.most > found.least:
            gap[i] = above[i] - found.least
        else:
            loss[i] = np.clip((above[i] - found.least) / (found.most - found.least), 0.0, 1.0)
    return moved, loss, gap, pull


def _best_natural(problem: Problem, x: Array, Z: Array, reduced: Array) -> Array:
    below, above = np.maximum(x - problem.lower, 0.0), np.maximum(problem.upper - x, 0.0)
    worst = np.zeros(reduced.shape[:2])
    for d in _facets(np.ascontiguousarray(Z).tobytes(), Z.shape):
        for side in (d, -d):
            push = np.einsum("ki,cki->ck", side, reduced)
            s = np.einsum("kni,ki->kn", Z, side)
            free_at = np.where(s > STILL, below, np.where(s < -STILL, above, np.inf)).min(-1)
            worst = np.maximum(worst, np.minimum(push / np.abs(s).sum(-1), free_at))
    return worst


@lru_cache(maxsize=8)
def _facets(null_spaces: bytes, shape: tuple[int, int, int]) -> list[Array]:
    k, n, r = shape
    Z = np.frombuffer(null_spaces).reshape(shape)
    if r == 1:
        return [np.ones((k, 1))]
    return [np.linalg.svd(Z[:, list(rows), :])[2][:, -1, :] for rows in itertools.combinations(range(n), r - 1)]
