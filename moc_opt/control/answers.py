"""What a solver's answer is worth, in a microsecond: its form, and how far it is from what it claims to be."""

from __future__ import annotations

import numpy as np
from numba import int64, njit
from numpy.typing import NDArray

from moc_opt.compiled import MATRIX, VECTOR, Entry, borrowed
from moc_opt.control.dense import dot
from moc_opt.model_kernels import all_finite
from moc_opt.solvers.base import Solution, Status, no_answer

Array = NDArray[np.float64]

_DOUBLE, _CLOSE = np.dtype(np.float64), (8,)


def well_formed(solution: object, n: int) -> Solution:
    """The answer as it is, or one without an x where a solver hands back something else than a Solution.

    The x of the result is an array (n,) of float64, without gaps in memory.
    """
    if not isinstance(solution, Solution) or not isinstance(solution.status, Status):
        return no_answer(n, Status.NUMERICAL)
    x, y, status, iterations = solution
    right = isinstance(x, np.ndarray) and x.shape == (n,) and x.dtype == _DOUBLE
    if (
        right
        and x.strides == _CLOSE
        and (y is None or (isinstance(y, np.ndarray) and y.shape == (6,)))
        and type(iterations) is int
    ):
        return solution
    x = np.array(x) if right else np.full(n, np.nan)
    y = y if isinstance(y, np.ndarray) and y.shape == (6,) else None
    return Solution(x, y, status, iterations if isinstance(iterations, int) else 0)


@njit(cache=True, nogil=True)
def answer_residuals(row: Array, n: int, Z: Array, x: Array) -> tuple[float, float, float, float, float]:
    """What the supervisor judges an answer x (n,) by, for use in the loop.

    Along the self-motion that raises mu, x stands at s; there the cost c2 (-g s) + rho s^2 / 2 has its
    optimum at clip(c2 g / rho) on the segment that the box leaves, and that of the opposite gradient at
    clip(-c2 g / rho). Where the elbow swivel is the only freedom this line is the whole feasible set.

    Returns:
        |A x - b|_inf, NaN where x is not finite; box violation; natural residual along the line with the cost
        divided by c2 |grad_mu|_inf and the best duals (``moc_opt.optimality``'s, where the line is all there
        is); distance from the optimum and from the opposite optimum [rad/s].
    """
    row, Z, x = borrowed(row), borrowed(Z), borrowed(x)
    if not all_finite(x):
        return np.nan, np.nan, np.nan, np.nan, np.nan
    o = 6 * n
    grad_mu = row[o + 6 : o + 6 + n]
    lower, upper = row[o + 6 + n : o + 6 + 2 * n], row[o + 6 + 2 * n : o + 6 + 3 * n]
    c2, rho = row[o + 8 + 3 * n], row[o + 9 + 3 * n]
    primal, outside = 0.0, 0.0
    for i in range(6):
        gap = -row[o + i]
        for j in range(n):
            gap += row[i * n + j] * x[j]
        primal = max(primal, abs(gap))
    for j in range(n):
        outside = max(outside, lower[j] - x[j], x[j] - upper[j])

    line = np.zeros(n)
    for i in range(Z.shape[0]):
        line += dot(Z[i], grad_mu) * Z[i]
    length = np.sqrt(dot(line, line))
    largest = np.max(np.abs(grad_mu))
    if length <= 1e-12 * largest or c2 == 0.0:
        return primal, outside, 0.0, 0.0, 0.0
    slope, total, place, low, high = 0.0, 0.0, 0.0, -np.inf, np.inf
    for j in range(n):
        line[j] /= length
        slope += line[j] * (rho * x[j] - c2 * grad_mu[j]) / (c2 * largest)
        total += abs(line[j])
        place += line[j] * x[j]
        if abs(line[j]) > 1e-9:
            one, other = (lower[j] - x[j]) / line[j], (upper[j] - x[j]) / line[j]
            low, high = max(low, min(one, other)), min(high, max(one, other))
    low, high = min(low, 0.0), max(high, 0.0)  # x itself counts as allowed: its violation is judged above
    room = np.inf
    for j in range(n):
        push = line[j] * slope
        if push > 1e-9 * abs(slope):
            room = min(room, max(x[j] - lower[j], 0.0))
        elif push < -1e-9 * abs(slope):
            room = min(room, max(upper[j] - x[j], 0.0))
    wish = c2 * length / rho if rho > 0.0 else np.inf
    best, worst = min(max(wish - place, low), high), min(max(-wish - place, low), high)
    return primal, outside, min(abs(slope) / total, room), abs(best), abs(worst)


RESIDUALS = Entry(answer_residuals, VECTOR, int64, MATRIX, VECTOR)
"""`answer_residuals` for the loop."""
