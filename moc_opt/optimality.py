"""How an answer to the null-space subproblem is judged: one set of residuals for every solver.

All functions take a leading batch shape ``(...,)`` and need numpy only, so that one call judges
a single tick or a whole recording. None of them asks the solver what it thinks of its answer.

The stationarity measure is the natural residual of the box-constrained Lagrangian,
``x - clip(x - (P x + p + A^T y), lower, upper)`` (Facchinei & Pang 2003, section 1.5.2): it is zero
exactly at a KKT point and needs no multipliers of the box.
"""

from __future__ import annotations

import itertools
from functools import lru_cache
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import SubproblemError

Array = NDArray[np.float64]

RANK_TOLERANCE = 1e-12  # singular values of A below this fraction of the largest count as zero
# Singular values that may be divided by to bring x onto A x = b: near a straight elbow the smallest would
# blow a residual of rounding size up to a rad/s.
PROJECTION_TOLERANCE = 1e-6
A_POINT = 1e-9  # a feasible interval no longer than this [rad/s] has no ends: rounding decides where on it x is
MOST_FACETS = 200_000  # some ten seconds for a problem that has not been seen yet; 25 joints


class Residuals(NamedTuple):
    """How far an answer is from optimal; each entry is a float or has the batch shape.

    Attributes:
        primal: max(|A x - b|_inf, box violation) [m/s or rad/s].
        natural: natural residual with the solver's own y (the best y where it gave none).
        natural_best: natural residual with the best y for that x: a good x with bad duals is
            told from a bad x by ``natural >> natural_best``.
        relative: ``natural_best`` of the same problem with its cost divided by
            c2 |grad_mu|_inf, whose scale (about 1e-4) is otherwise below most tolerances [rad/s].
        loss: where on the feasible interval of self-motion x stopped, in [0, 1]:
            0 is the optimum, 1 the opposite end.
    """

    primal: Array
    natural: Array
    natural_best: Array
    relative: Array
    loss: Array

    def verified(self, primal: float = 1e-6, relative: float = 1e-3, loss: float = 1e-2) -> NDArray[np.bool_]:
        """Whether the answer is optimal to these tolerances (bool, batch shape)."""
        within = (self.primal <= primal, self.relative <= relative, self.loss <= loss)
        return np.logical_and.reduce(within)


class Problem(NamedTuple):
    """The arrays of a subproblem that the residuals need; every one may carry a batch shape."""

    A: Array  # (..., 6, n)
    b: Array  # (..., 6)
    grad_mu: Array  # (..., n)
    lower: Array  # (..., n)
    upper: Array  # (..., n)
    weights: Array  # (..., 4): c0, c1, c2, damping


def residuals(problem: Problem, x: Array, y: Array | None = None) -> Residuals:
    """Judge answers ``x`` (..., n) with their duals ``y`` (..., 6), or None where there are none.

    Rows of ``x`` that are not finite are infinitely wrong (loss 1); rows of ``y`` that are not
    finite count as "no dual given".

    Raises:
        SubproblemError: more freedoms than the best multipliers can be found for (see ``_best_natural``).
    """
    shape = x.shape[:-1]
    n = x.shape[-1]
    flat = Problem(
        *(
            np.broadcast_to(f, shape + f.shape[-k:]).reshape(-1, *f.shape[-k:])
            for f, k in zip(problem, (2, 1, 1, 1, 1, 1), strict=True)
        )
    )
    x = x.reshape(-1, n)
    finite = np.all(np.isfinite(x), axis=-1)
    x = np.where(finite[:, None], x, 0.0)
    slack = np.einsum("kij,kj->ki", flat.A, x) - flat.b
    outside = np.maximum(np.maximum(flat.lower - x, x - flat.upper), 0.0)
    primal = np.maximum(np.abs(slack).max(-1), outside.max(-1))

    c0, c1, c2, damping = flat.weights.T
    tracking = slack * np.repeat(np.stack([c0, c1], -1), 3, axis=-1)
    cost = damping[:, None] * x - c2[:, None] * flat.grad_mu  # the part of P x + p outside range(A^T)
    gradient = np.einsum("kij,ki->kj", flat.A, tracking) + cost
    scale = c2 * np.abs(flat.grad_mu).max(-1)
    scale = np.where(scale > 0.0, scale, 1.0)

    best, relative, loss = (np.empty(len(x)) for _ in range(3))
    for rank, rows, Z in null_spaces(flat.A):
        if rank == n:  # A determines x: stationarity asks nothing of it
            best[rows] = relative[rows] = loss[rows] = 0.0
            continue
        part = Problem(*(f[rows] for f in flat))
        reduced = np.einsum("kni,kn->ki", Z, cost[rows])
        both = np.stack([reduced, reduced / scale[rows, None]])
        best[rows], relative[rows] = _best_natural(part, x[rows], Z, both)
        loss[rows] = _self_motion_loss(part, x[rows], Z, slack[rows])

    natural = best.copy()
    if y is not None:
        y = np.broadcast_to(y, (*shape, 6)).reshape(-1, 6)
        given = np.all(np.isfinite(y), axis=-1)
        full = gradient + np.einsum("kij,ki->kj", flat.A, np.where(given[:, None], y, 0.0))
        own = np.abs(x - np.clip(x - full, flat.lower, flat.upper)).max(-1)
        natural = np.where(given, own, best)
    wrong = ~finite
    for figure in (primal, natural, best, relative):
        figure[wrong] = np.inf
    loss[wrong] = 1.0
    return Residuals(*(f.reshape(shape) for f in (primal, natural, best, relative, loss)))


def null_spaces(A: Array) -> list[tuple[int, NDArray[np.intp], Array]]:
    """Orthonormal bases of ker A for a batch ``A`` (k, 6, n), grouped by rank.

    Returns:
        (rank, row indices (m,), Z (m, n, n - rank)) for every rank that occurs.
    """
    _, s, vh = np.linalg.svd(A, full_matrices=True)
    ranks = (s > RANK_TOLERANCE * s[:, :1]).sum(-1)
    groups = []
    for rank in np.unique(ranks):
        rows = np.flatnonzero(ranks == rank)
        groups.append((int(rank), rows, np.swapaxes(vh[rows, rank:, :], 1, 2)))
    return groups


def _best_natural(problem: Problem, x: Array, Z: Array, reduced: Array) -> Array:
    """Smallest natural residual over all y, in closed form, for several costs ``reduced`` (c, k, r): (c, k).

    y moves w = P x + p + A^T y freely but for Z^T w = reduced. A residual of t allows
    w_i in [-t, t], without the upper end where x_i is within t of its lower bound and without
    the lower end near its upper bound. By support functions, such a w exists if and only if
    d.reduced <= max_w d.(Z^T w) for every facet normal d of that polytope; these are the
    directions orthogonal to r - 1 rows of Z.
    """
    below, above = np.maximum(x - problem.lower, 0.0), np.maximum(problem.upper - x, 0.0)
    worst = np.zeros(reduced.shape[:2])
    for d in _facets(np.ascontiguousarray(Z).tobytes(), Z.shape):
        for side in (d, -d):
            push = np.einsum("ki,cki->ck", side, reduced)
            s = np.einsum("kni,ki->kn", Z, side)
            free_at = np.where(s > 1e-9, below, np.where(s < -1e-9, above, np.inf)).min(-1)
            worst = np.maximum(worst, np.minimum(push / np.abs(s).sum(-1), free_at))
    return worst


@lru_cache(maxsize=8)
def _facets(null_spaces: bytes, shape: tuple[int, int, int]) -> list[Array]:
    """Directions (k, r) orthogonal to r - 1 rows of each Z (k, n, r), for every choice of rows.

    Remembered, as every solver of a comparison is judged on the same problems: with 14 joints there are 3432 of them.
    """
    k, n, r = shape
    Z = np.frombuffer(null_spaces).reshape(shape)
    if r == 1:
        return [np.ones((k, 1))]
    if comb(n, r - 1) > MOST_FACETS:
        raise SubproblemError(
            f"n: {n} joints with {r} freedoms have {comb(n, r - 1)} directions that an answer is judged along; "
            "judge arms of up to 25 joints, or A x - b and x - clip(x - (P x + p + A^T y)) by hand"
        )
    return [np.linalg.svd(Z[:, list(rows), :])[2][:, -1, :] for rows in itertools.combinations(range(n), r - 1)]


def _self_motion_loss(problem: Problem, x: Array, Z: Array, slack: Array) -> Array:
    """Distance from the optimum along the self-motion that raises mu, over its largest value, (k,).

    x is first moved onto A x = b. The line through it runs along the projection of grad_mu on
    ker A; where that freedom is a single one (an arm with an elbow swivel) this line is the
    whole feasible set, up to joints that move neither tip nor wrist.
    """
    _, _, c2, damping = problem.weights.T
    line = np.einsum("kni,ki->kn", Z, np.einsum("kni,kn->ki", Z, problem.grad_mu))
    length = np.linalg.norm(line, axis=-1)
    flat_mu = length <= 1e-12 * np.maximum(np.linalg.norm(problem.grad_mu, axis=-1), 1e-300)
    line = np.where(flat_mu[:, None], Z[:, :, 0], line / np.where(flat_mu, 1.0, length)[:, None])
    x = x - np.einsum("kni,ki->kn", np.linalg.pinv(problem.A, rcond=PROJECTION_TOLERANCE), slack)
    moving = np.abs(line) > 1e-9
    step = np.where(moving, line, 1.0)
    ends = np.stack([(problem.lower - x) / step, (problem.upper - x) / step])
    low = np.where(moving, ends.min(0), -np.inf).max(-1)
    high = np.where(moving, ends.max(0), np.inf).min(-1)
    slope = np.einsum("kn,kn->k", line, damping[:, None] * x - c2[:, None] * problem.grad_mu)
    # stepping against the slope: to the vertex where the cost is linear
    free = np.where(
        damping > 0.0, -slope / np.where(damping > 0.0, damping, 1.0), np.where(slope > 0.0, -np.inf, np.inf)
    )
    middle = 0.5 * (low + high)
    best = np.where(slope == 0.0, 0.0, np.clip(free, np.minimum(low, middle), np.maximum(high, middle)))
    room = np.maximum(np.abs(high - best), np.abs(best - low))
    loss = np.where(room > A_POINT, np.abs(best) / np.where(room > A_POINT, room, 1.0), 0.0)
    return np.where(high < low - 1e-6, 1.0, np.minimum(loss, 1.0))
