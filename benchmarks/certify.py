"""Compute the answers of a test set in rational numbers, without the solvers and residuals of moc_opt."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import combinations, product

import numpy as np
from scipy.optimize import linprog

from moc_opt.arrays import Array
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.study.testsets import CertificateError, TestSet

TIED = 1e-12  # largest difference, relative to |A|, between the velocities of tip and wrist along a rigid shaft
RANK_TOLERANCE = 1e-12  # A singular value up to this share of |A| counts as zero.
FEASIBLE, INFEASIBLE = 0, 2  # status of scipy's linprog
ZERO = Fraction(0)
Vector = list[Fraction]


def five_rows(qp: NullSpaceQP) -> tuple[Array, Array]:
    """Return A (5, n) and b (5,): the tip's three rows and the wrist's two across the shaft.

    Along the shaft, the wrist's row equals the tip's up to rounding. It is left out, because exact arithmetic could
    find the two rows contradictory.
    """
    directions, sizes, _ = np.linalg.svd(qp.J_tip - qp.J_wrist)
    if sizes[2] > TIED * np.linalg.norm(qp.A):
        raise CertificateError(f"the tool is not rigid: along the shaft, tip and wrist move apart by {sizes[2]:.1e}")
    across = directions[:, :2].T
    A, b = np.vstack([qp.J_tip, across @ qp.J_wrist]), np.concatenate([qp.v_tip, across @ qp.v_wrist])
    smallest = np.linalg.svd(A)[1][-1]
    if smallest <= RANK_TOLERANCE * np.linalg.norm(A):
        raise CertificateError(f"the five rows are dependent up to rounding (smallest singular value {smallest:.1e})")
    return A, b


def optimum(A: Array, b: Array, pull: Vector, rho: float, lower: Array, upper: Array) -> Vector | None:
    """Minimise rho/2 |x|^2 - pull^T x subject to A x = b, lower <= x <= upper, without rounding.

    Each joint whose column of A is zero is solved alone. For the joints with nonzero columns, all sets of active bounds
    are tried. If rho is 0, only vertices are tried. A tried point is an optimum if it is within the bounds and its
    multipliers have the right signs, because the problem is convex. Return None if the problem is infeasible.
    """
    weight, ends = Fraction(rho), [(Fraction(low), Fraction(high)) for low, high in zip(lower, upper, strict=True)]
    moving = [j for j in range(len(ends)) if A[:, j].any()]
    x = [_alone(gain, weight, *both) for gain, both in zip(pull, ends, strict=True)]
    count = len(moving)
    exact = [[Fraction(value) for value in (*row[moving], right)] for row, right in zip(A, b, strict=True)]
    rows, pivots = eliminated(exact)
    if count in pivots:
        return None
    if not moving:
        return x
    free = [j for j in range(count) if j not in pivots]
    start, basis = [ZERO] * count, [[Fraction(j == k) for k in free] for j in range(count)]
    for row, pivot in zip(rows, pivots, strict=False):
        start[pivot], basis[pivot] = row[count], [-row[k] for k in free]
    gains, boxes = [pull[j] for j in moving], [ends[j] for j in moving]
    for k in range(len(free) + 1) if rho else (len(free),):
        for joints, sides in product(combinations(range(count), k), product((0, 1), repeat=k)):
            active = {j: boxes[j][side] for j, side in zip(joints, sides, strict=True)}
            point, multipliers = _stationary(basis, start, gains, weight, active) or ([], [])
            inside = point and all(low <= value <= high for value, (low, high) in zip(point, boxes, strict=True))
            if inside and all(m <= 0 if side else m >= 0 for m, side in zip(multipliers, sides, strict=True)):
                for j, value in zip(moving, point, strict=True):
                    x[j] = value
                return x
    return None


def _alone(gain: Fraction, weight: Fraction, low: Fraction, high: Fraction) -> Fraction:
    """Minimise weight/2 x^2 - gain x on [low, high]. If weight and gain are 0, return the x nearest to zero."""
    if weight or not gain:
        return min(max(gain / weight if weight else ZERO, low), high)
    return high if gain > 0 else low


def _stationary(
    basis: list[Vector], start: Vector, gains: Vector, weight: Fraction, active: dict[int, Fraction]
) -> tuple[Vector, Vector] | None:
    """Return (stationary point x, multipliers m) for these active bounds, or None if x or m is not unique.

    N^T (weight x - gains) = N_S^T m. N is the basis of ker A. N_S has the rows of N for the joints in ``active``.
    """
    r, columns = len(basis[0]), list(zip(*basis, strict=True))
    left = [gain - weight * value for gain, value in zip(gains, start, strict=True)]
    system = [
        [*(weight * dot(one, other) for other in columns), *(-one[j] for j in active), dot(one, left)]
        for one in columns
    ]
    system += [[*basis[j], *[ZERO] * len(active), bound - start[j]] for j, bound in active.items()]
    rows, pivots = eliminated(system)
    if pivots != list(range(len(system))):
        return None
    found = [row[-1] for row in rows]
    return [value + dot(row, found[:r]) for value, row in zip(start, basis, strict=True)], found[r:]


def dot(one: Iterable[Fraction], other: Iterable[Fraction]) -> Fraction:
    return sum((a * b for a, b in zip(one, other, strict=True)), ZERO)


def eliminated(matrix: list[Vector]) -> tuple[list[Vector], list[int]]:
    """Return (reduced row echelon form, pivot columns)."""
    rows = [list(row) for row in matrix]
    pivots: list[int] = []
    for column in range(len(rows[0]) if rows else 0):
        place = len(pivots)
        chosen = next((i for i in range(place, len(rows)) if rows[i][column]), None)
        if chosen is None:
            continue
        rows[place], rows[chosen] = rows[chosen], rows[place]
        rows[place] = [value / rows[place][column] for value in rows[place]]
        for i, row in enumerate(rows):
            if i != place and row[column]:
                rows[i] = [a - row[column] * b for a, b in zip(row, rows[place], strict=True)]
        pivots.append(column)
    return rows, pivots


def certified(qp: NullSpaceQP) -> Vector | None:
    """Return an exact optimum (n,) under the five rows, or None if the problem is infeasible."""
    A, b = five_rows(qp)
    pull = [Fraction(qp.c2) * Fraction(g) for g in qp.pull]
    return optimum(A, b, pull, qp.regularization, qp.lower, qp.upper)


def certify(name: str, problems: Sequence[NullSpaceQP]) -> TestSet:
    """Return problems with exact answers. Raise a CertificateError if HiGHS and this module disagree on feasibility."""
    X = np.full((len(problems), problems[0].n), np.nan)
    for i, qp in enumerate(problems):
        found = certified(qp)
        if found is not None:
            X[i] = [float(value) for value in found]
        A, b = five_rows(qp)
        bounds = list(zip(qp.lower, qp.upper, strict=True))
        program = linprog(np.zeros(qp.n), A_eq=A, b_eq=b, bounds=bounds, method="highs")
        if program.status != (INFEASIBLE if found is None else FEASIBLE):
            word = "infeasible" if found is None else "feasible"
            raise CertificateError(f"{name}[{i}]: {word} by enumeration, but HiGHS says: {program.message}")
    return TestSet(name, np.array([qp.row for qp in problems]), X, ~np.isnan(X[:, 0]))
