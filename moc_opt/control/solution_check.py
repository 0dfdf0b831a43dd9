"""The check of a solver's answer within a microsecond: its form, and its distance from the claimed optimum."""

from __future__ import annotations

import numpy as np
from numba import int64

from moc_opt.model.kinematics_kernels import all_finite
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import MATRIX, VECTOR, CompiledKernel, borrowed
from moc_opt.numerics.dense import dot
from moc_opt.qp.equalities import offsets
from moc_opt.qp.layout import C2, RHO
from moc_opt.qp.residuals import GRADIENT_ROUNDING, RANK_TOLERANCE
from moc_opt.solvers.base import Solution, Status, no_answer

AT_BOUND = 1e-4  # a joint this near to a bound is at it [rad/s]
SWEEPS = 200
PASSES = 2e-3  # an answer with a smaller natural residual may be verified: the line is not searched

MOST_ITERATIONS = 2**31 - 1
"""The largest number that a trace can hold."""

_DOUBLE, _SIX = np.dtype(np.float64), (6,)
_INTEGERS = frozenset({int, *(np.dtype(code).type for code in np.typecodes["AllInteger"])})  # no types made from them


def received(given: object, n: int) -> tuple[Solution, str]:
    """Copy a solver's answer, and return what is wrong with its form as a ``Solution`` ("" for nothing).

    The copy shares no memory with the solver's: x (n,) and y (6,) are arrays of float64 without gaps, iterations an
    int that fits 32 bits. If any part is malformed, the whole answer is refused and x is NaN. NaN in x or y is no
    error of form.
    """
    if not isinstance(given, Solution):
        return no_answer(n, Status.NUMERICAL), f"solve returned a {type(given).__name__}: return a Solution"
    x, y, status, iterations = Solution._make(tuple.__iter__(given)) if type(given) is not Solution else given
    if not (
        type(x) is np.ndarray
        and x.dtype == _DOUBLE
        and x.shape == (n,)
        and (y is None or (type(y) is np.ndarray and y.dtype == _DOUBLE and y.shape == _SIX))
        and type(status) is Status
        and type(iterations) in _INTEGERS
        and 0 <= iterations <= MOST_ITERATIONS
    ):
        return no_answer(n, status if type(status) is Status else Status.NUMERICAL), _wrong(x, y, status, iterations, n)
    return Solution(x.copy(), None if y is None else y.copy(), status, int(iterations)), ""


def _wrong(x: object, y: object, status: object, iterations: object, n: int) -> str:
    if type(status) is not Status:
        return f"the status is a {type(status).__name__}: give a Status"
    return _unlike("x", x, n) or ("" if y is None else _unlike("y", y, 6)) or _uncountable(iterations)


def _unlike(name: str, value: object, length: int) -> str:
    if type(value) is not np.ndarray:
        return f"{name} is a {type(value).__name__}: give an array of float64"
    if value.dtype != _DOUBLE:
        return f"{name} is an array of {value.dtype}: give an array of float64"
    return "" if value.shape == (length,) else f"{name} has shape {value.shape}: give ({length},)"


def _uncountable(iterations: object) -> str:
    if type(iterations) not in _INTEGERS:
        return f"iterations is a {type(iterations).__name__}: give an int"
    return f"iterations is out of range: give 0 to {MOST_ITERATIONS}"


@njit(cache=True, nogil=True)
def freedoms(row: Array, n: int, r: int) -> int:
    """Count the dimensions of ker A (r in all) that turn joints which move tip or wrist; the rest are idle joints."""
    total = 0.0
    for k in range(6 * n):
        total += row[k] * row[k]
    for j in range(n):
        column = 0.0
        for i in range(6):
            column += row[i * n + j] * row[i * n + j]
        r -= column <= RANK_TOLERANCE * RANK_TOLERANCE * total
    return r


@njit(cache=True, nogil=True)
def way_down(row: Array, n: int, Z: Array, x: Array, d: Array) -> float:
    """Fill d (n,) with the steepest descent from x that stays in ker A and in the box; return the scale of the cost.

    That is the projection of minus the reduced gradient on the tangent cone of the feasible set, and zero at an optimum
    and nowhere else. Joints that are ``AT_BOUND`` may only move inwards; their multipliers are found one after the
    other (Hildreth 1957), which is exact for one and converges for several. Idle joints are left out.
    """
    at = offsets(n)
    c2, rho = row[at.weights + C2], row[at.weights + RHO]
    cost, projector, side, multiplier = np.zeros(n), np.zeros((n, n)), np.zeros(n), np.zeros(n)
    for j in range(n):
        cost[j] = c2 * row[at.grad_mu + j] - rho * x[j]
        for i in range(Z.shape[0]):
            for k in range(n):
                projector[j, k] += Z[i, j] * Z[i, k]
    largest, length = 0.0, 0.0
    for j in range(n):
        moved, raised = 0.0, 0.0
        for k in range(n):
            moved += projector[j, k] * cost[k]
            raised += projector[j, k] * row[at.grad_mu + k]
        idle = projector[j, j] > 1.0 - 1e-12  # e_j itself lies in ker A
        d[j] = 0.0 if idle else moved
        largest = max(largest, 0.0 if idle else c2 * abs(raised))
        length = max(length, abs(d[j]))
        if not idle and projector[j, j] > 1e-12:
            at_lower = x[j] - row[at.lower + j] <= AT_BOUND
            at_upper = row[at.upper + j] - x[j] <= AT_BOUND
            side[j] = 2.0 if at_lower and at_upper else 1.0 if at_lower else -1.0 if at_upper else 0.0
    for _ in range(SWEEPS):
        change = 0.0
        for j in range(n):
            if side[j] != 0.0:
                step = -d[j] / projector[j, j]
                if side[j] == 1.0:
                    step = max(step, -multiplier[j])
                elif side[j] == -1.0:
                    step = min(step, -multiplier[j])
                multiplier[j] += step
                for k in range(n):
                    d[k] += step * projector[j, k]
                change = max(change, abs(step))
        if change <= 1e-10 * length:
            break
    left = whole = 0.0
    for j in range(n):
        left, whole = max(left, abs(d[j])), max(whole, abs(cost[j]))
    if left <= max(1e-8 * length, GRADIENT_ROUNDING * whole):
        d[:] = 0.0
    return max(largest, rho)


@njit(cache=True, nogil=True)
def answer_residuals(row: Array, n: int, Z: Array, x: Array) -> tuple[float, float, float, float, float]:
    """Compute the figures by which the supervisor accepts an answer x (n,).

    Let s be the coordinate of x along a line of self-motion. On it the cost c2 (-g s) + rho s^2 / 2 has its
    optimum at clip(c2 g / rho) on the segment that the box leaves, and that of the opposite gradient at
    clip(-c2 g / rho). Where the elbow swivel is the only freedom the line is the whole feasible set. With
    several freedoms it is the steepest way down that the box leaves open at x (``way_down``), and all is zero where
    there is none.

    Returns:
        |A x - b|_inf, NaN where x is not finite; box violation; natural residual along the line with the best duals
        and the cost divided by max(c2 |grad_mu|_inf, rho), with several freedoms by the size of the reduced
        gradient: never above the residuals' ``relative``; distance from the optimum and from the opposite optimum
        [rad/s], zero where rho is that scale, or with several freedoms, and the natural residual is below `PASSES`.
    """
    row, Z, x = borrowed(row), borrowed(Z), borrowed(x)
    if not all_finite(x):
        return np.nan, np.nan, np.nan, np.nan, np.nan
    at = offsets(n)
    grad_mu, lower, upper = row[at.grad_mu : at.lower], row[at.lower : at.upper], row[at.upper : at.weights]
    c2, rho = row[at.weights + C2], row[at.weights + RHO]
    primal, outside = 0.0, 0.0
    for i in range(6):
        gap = -row[at.b + i]
        for j in range(n):
            gap += row[i * n + j] * x[j]
        primal = max(primal, abs(gap))
    for j in range(n):
        outside = max(outside, lower[j] - x[j], x[j] - upper[j])

    line = np.zeros(n)
    for i in range(Z.shape[0]):
        line += dot(Z[i], grad_mu) * Z[i]
    largest = np.max(np.abs(grad_mu))
    if np.sqrt(dot(line, line)) <= 1e-12 * largest or c2 == 0.0:
        return primal, outside, 0.0, 0.0, 0.0
    # The floor rho: a course that rests asks for x_d = 0, and its gradient (rho/c2) x_d is no scale then.
    several, still, scale = freedoms(row, n, Z.shape[0]) > 1, 1e-9, max(c2 * largest, rho)
    faint = rho >= c2 * largest
    if several:
        scale, still = way_down(row, n, Z, x, line), 1e-6
    length = np.sqrt(dot(line, line))
    if length == 0.0:
        return primal, outside, 0.0, 0.0, 0.0
    slope, total, place, pull, low, high = 0.0, 0.0, 0.0, 0.0, -np.inf, np.inf
    for j in range(n):
        line[j] /= length
        slope += line[j] * (rho * x[j] - c2 * grad_mu[j]) / scale
        pull += c2 * line[j] * grad_mu[j]
        total += abs(line[j])
        place += line[j] * x[j]
        if abs(line[j]) > still:
            one, other = (lower[j] - x[j]) / line[j], (upper[j] - x[j]) / line[j]
            low, high = max(low, min(one, other)), min(high, max(one, other))
    low, high = min(low, 0.0), max(high, 0.0)  # x itself counts as feasible: its violation is checked above
    room = np.inf
    for j in range(n):
        push = line[j] * slope
        if push > still * abs(slope):
            room = min(room, max(x[j] - lower[j], 0.0))
        elif push < -still * abs(slope):
            room = min(room, max(upper[j] - x[j], 0.0))
    desired = pull / rho if rho > 0.0 else np.inf
    best, worst = min(max(desired - place, low), high), min(max(-desired - place, low), high)
    natural = min(abs(slope) / total, room)
    if (several or faint) and natural <= PASSES:
        return primal, outside, natural, 0.0, 0.0
    return primal, outside, natural, abs(best), abs(worst)


RESIDUALS = CompiledKernel(answer_residuals, VECTOR, int64, MATRIX, VECTOR)
"""`answer_residuals` for the loop."""
