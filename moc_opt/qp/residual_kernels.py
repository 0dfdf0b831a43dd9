"""The residuals of a whole recording, compiled: what `moc_opt.qp.residuals` defines, for the problems of one freedom.

There the feasible set is an interval for each idle joint and one for the others, and everything is in closed form. A
problem whose rank is not plain, or with several freedoms, is left to the definition. The tests compare both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import MATRIX, CompiledKernel
from moc_opt.qp.equalities import offsets
from moc_opt.qp.layout import C0, C1, C2, RHO
from moc_opt.qp.problem import compute_residuals
from moc_opt.qp.residuals import A_POINT, FEASIBLE, GRADIENT_ROUNDING, RANK_TOLERANCE, STILL, Residuals

# Between these shares of |A|_F no row's independent part may lie, or the rank is left to its singular values.
INDEPENDENT, DEPENDENT = 1e-4, 1e-12
PRIMAL, NATURAL, BEST, RELATIVE, LOSS, DISTANCE = range(6)  # the order of Residuals


def batch_residuals(rows: Array, x: Array, y: Array) -> Residuals:
    """Do ``compute_residuals`` for answers x (k, n), y (k, 6) to the subproblems ``rows`` (k, 10 n + 10)."""
    rows, x, y = (np.ascontiguousarray(given, dtype=np.float64) for given in (rows, x, y))
    found = np.empty((len(x), 6))
    left = ~_FILL.code(rows, x, y, found) if len(x) else np.zeros(0, dtype=np.bool_)
    if left.any():
        found[left] = np.stack(compute_residuals(rows[left], x[left], y[left]), axis=1)
    return Residuals(*found.T.copy())


@njit(cache=True, nogil=True)
def on_an_interval(slope: float, rho: float, low: float, high: float) -> tuple[float, float]:
    """Step to the optimum of slope s + rho/2 s^2 on [low, high], and the share of its range lost at s = 0."""
    if slope == 0.0:
        free = 0.0
    elif rho == 0.0:
        free = -np.inf if slope > 0.0 else np.inf
    else:
        free = -slope / rho
    best = min(max(free, low), high)
    if not high - low > A_POINT:
        return best, 0.0
    least = best * (slope + 0.5 * rho * best)
    spread = max(low * (slope + 0.5 * rho * low), high * (slope + 0.5 * rho * high)) - least
    return best, min(max(-least / spread, 0.0), 1.0) if spread > 0.0 else 0.0


@njit(cache=True, nogil=True)
def row_space(A: Array, m: int, Q: Array, z: Array, work: Array) -> bool:
    """Fill Q (m - 1, m) with an orthonormal basis of the rows of A (6, m), and z (m,) with the unit vector of ker A.

    By Gram-Schmidt with the largest remaining row first, each twice. False where the rank is not plainly m - 1.
    """
    total = 0.0
    for i in range(6):
        for j in range(m):
            work[i, j] = A[i, j]
            total += A[i, j] * A[i, j]
    for k in range(m - 1):
        pivot, largest = 0, -1.0
        for i in range(6):
            square = 0.0
            for j in range(m):
                square += work[i, j] * work[i, j]
            if square > largest:
                pivot, largest = i, square
        if largest < INDEPENDENT * INDEPENDENT * total:
            return False
        for j in range(m):
            Q[k, j] = work[pivot, j]
        _orthogonalize(Q[k], Q, k, m)
        for i in range(6):
            along = 0.0
            for j in range(m):
                along += Q[k, j] * work[i, j]
            for j in range(m):
                work[i, j] = 0.0 if i == pivot else work[i, j] - along * Q[k, j]
    for i in range(6):
        square = 0.0
        for j in range(m):
            square += work[i, j] * work[i, j]
        if square > DEPENDENT * DEPENDENT * total:
            return False
    farthest, least = 0, np.inf
    for j in range(m):
        inside = 0.0
        for k in range(m - 1):
            inside += Q[k, j] * Q[k, j]
        if inside < least:
            farthest, least = j, inside
    for j in range(m):
        z[j] = 1.0 if j == farthest else 0.0
    _orthogonalize(z, Q, m - 1, m)
    _orthogonalize(z, Q, m - 1, m)
    return True


@njit(cache=True, nogil=True)
def _orthogonalize(vector: Array, Q: Array, k: int, m: int) -> None:
    """Take its part along the first k rows of Q off a vector (m,), and give it unit length."""
    for i in range(k):
        along = 0.0
        for j in range(m):
            along += Q[i, j] * vector[j]
        for j in range(m):
            vector[j] -= along * Q[i, j]
    square = 0.0
    for j in range(m):
        square += vector[j] * vector[j]
    for j in range(m):
        vector[j] /= np.sqrt(square)


@njit(cache=True, nogil=True)
def least_squares(A: Array, slack: Array, Q: Array, m: int, step: Array, R: Array, G: Array) -> None:
    """Fill step (m,) with the shortest solution of A step = slack (6,), in the least-squares sense."""
    k = m - 1
    for i in range(k):
        for row in range(6):
            R[i, row] = 0.0
            for j in range(m):
                R[i, row] += Q[i, j] * A[row, j]
    for i in range(k):  # (R R^T) w = R slack, by Cholesky's factor in G; w in its last column
        G[i, k] = 0.0
        for row in range(6):
            G[i, k] += R[i, row] * slack[row]
        for j in range(i + 1):
            value = 0.0
            for row in range(6):
                value += R[i, row] * R[j, row]
            for c in range(j):
                value -= G[i, c] * G[j, c]
            G[i, j] = np.sqrt(max(value, 1e-300)) if i == j else value / G[j, j]
        for c in range(i):
            G[i, k] -= G[i, c] * G[c, k]
        G[i, k] /= G[i, i]
    for i in range(k - 1, -1, -1):
        for c in range(i + 1, k):
            G[i, k] -= G[c, i] * G[c, k]
        G[i, k] /= G[i, i]
    for j in range(m):
        step[j] = 0.0
        for i in range(k):
            step[j] += Q[i, j] * G[i, k]


@njit(cache=True, nogil=True)
def idle_joint(
    here: float, grad: float, size: float, low: float, high: float, c2: float, rho: float, out: Array
) -> None:
    """Raise the figures ``out`` (6,) to those of a joint that moves neither tip nor wrist."""
    push = c2 * grad if abs(grad) > GRADIENT_ROUNDING * size else 0.0
    slope, scale = rho * here - push, max(abs(push), rho)
    relative = slope / scale if scale > 0.0 else slope
    step, loss = on_an_interval(slope, rho, low - here, high - here)
    out[BEST] = max(out[BEST], abs(here - min(max(here - slope, low), high)))
    out[RELATIVE] = max(out[RELATIVE], abs(here - min(max(here - relative, low), high)))
    out[LOSS], out[DISTANCE] = max(out[LOSS], loss), max(out[DISTANCE], abs(step))


@njit(cache=True, nogil=True)
def along_a_line(z: Array, m: int, slope: float, rho: float, low: Array, high: Array) -> tuple[float, float]:
    """Step s to the optimum within low <= s z <= high, and the loss at s = 0; infinite where nothing is feasible."""
    first, last, wide_first, wide_last = -np.inf, np.inf, -np.inf, np.inf
    for j in range(m):
        if abs(z[j]) > STILL:
            one, other = low[j] / z[j], high[j] / z[j]
            first, last = max(first, min(one, other)), min(last, max(one, other))
            one, other = (low[j] - FEASIBLE) / z[j], (high[j] + FEASIBLE) / z[j]
            wide_first, wide_last = max(wide_first, min(one, other)), min(wide_last, max(one, other))
    if wide_first > wide_last:
        return np.inf, 1.0
    if first > last:
        first = last = min(max(0.5 * (first + last), wide_first), wide_last)
    return on_an_interval(slope, rho, first, last)


@njit(cache=True, nogil=True)
def fill_row(row: Array, x: Array, y: Array, out: Array, scratch: Array) -> bool:
    """Fill ``out`` (6,) with the residuals of one answer; False where they are left to the definition."""
    n = x.shape[0]
    at = offsets(n)
    grad, lower, upper = row[at.grad_mu : at.lower], row[at.lower : at.upper], row[at.upper : at.weights]
    c0, c1 = row[at.weights + C0], row[at.weights + C1]
    c2, rho = row[at.weights + C2], row[at.weights + RHO]
    A, work, Q, R, G = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    z, step, low, high, here = scratch[5, 0], scratch[5, 1], scratch[5, 2], scratch[5, 3], scratch[5, 4]
    slack, dual = scratch[6, 0], scratch[6, 1]
    for j in range(n):
        if not np.isfinite(x[j]):
            out[:] = np.inf
            out[LOSS] = 1.0
            return True
    for k in range(at.q):
        if not np.isfinite(row[k]):
            return False
    total, size = 0.0, 0.0
    for k in range(6 * n):
        total += row[k] * row[k]
    for j in range(n):
        size = max(size, abs(grad[j]))
    out[:] = 0.0

    for i in range(6):
        slack[i] = -row[at.b + i]
        for j in range(n):
            slack[i] += row[i * n + j] * x[j]
        out[PRIMAL] = max(out[PRIMAL], abs(slack[i]))
    m = 0
    for j in range(n):
        out[PRIMAL] = max(out[PRIMAL], lower[j] - x[j], x[j] - upper[j])
        square = 0.0
        for i in range(6):
            square += row[i * n + j] * row[i * n + j]
        if square > RANK_TOLERANCE * RANK_TOLERANCE * total:
            for i in range(6):
                A[i, m] = row[i * n + j]
            low[m], high[m], here[m], step[m] = lower[j], upper[j], x[j], grad[j]
            m += 1
        else:
            idle_joint(x[j], grad[j], size, lower[j], upper[j], c2, rho, out)
    if (m != 6 and m != 7) or not row_space(A, m, Q, z, work):
        return False

    pull, largest, length = 0.0, 0.0, 0.0
    for j in range(m):
        pull += z[j] * step[j]
        length += abs(z[j])
    for j in range(m):
        largest = max(largest, abs(pull * z[j]))
    if largest <= GRADIENT_ROUNDING * size:
        pull = largest = 0.0
    scale = max(c2 * largest, rho)
    least_squares(A, slack, Q, m, step, R, G)  # from here on step leads from A x = b to x
    slope = 0.0
    for j in range(m):
        slope += z[j] * rho * (here[j] - step[j])
    slope -= c2 * pull
    room = np.inf  # how far x may go down the slope before a joint meets its bound
    for j in range(m):
        push = z[j] * slope
        if abs(z[j]) > STILL and push != 0.0:
            room = min(room, max(here[j] - low[j], 0.0) if push > 0.0 else max(high[j] - here[j], 0.0))
        low[j] -= here[j] - step[j]
        high[j] -= here[j] - step[j]
    out[BEST] = max(out[BEST], min(abs(slope) / length, room))
    out[RELATIVE] = max(out[RELATIVE], min(abs(slope) / (scale if scale > 0.0 else 1.0) / length, room))
    move, loss = along_a_line(z, m, slope, rho, low, high)
    out[LOSS] = max(out[LOSS], loss)
    for j in range(m):
        out[DISTANCE] = max(out[DISTANCE], np.inf if np.isinf(move) else abs(move * z[j] - step[j]))

    out[NATURAL] = out[BEST]
    given = True
    for i in range(6):
        given = given and np.isfinite(y[i])
        dual[i] = y[i] + (c0 if i < 3 else c1) * slack[i]
    if given:
        out[NATURAL] = 0.0
        for j in range(n):
            full = rho * x[j] - c2 * grad[j]
            for i in range(6):
                full += row[i * n + j] * dual[i]
            out[NATURAL] = max(out[NATURAL], abs(x[j] - min(max(x[j] - full, lower[j]), upper[j])))
    return True


@njit(cache=True, nogil=True)
def fill_residuals(rows: Array, x: Array, y: Array, found: Array) -> NDArray[np.bool_]:
    """Fill ``found`` (k, 6) with the residuals of k answers; return which ones are there, (k,)."""
    n = x.shape[1]
    done, scratch = np.zeros(len(x), dtype=np.bool_), np.empty((7, max(n, 6), max(n, 6)))
    for k in range(len(x)):
        done[k] = fill_row(rows[k], x[k], y[k], found[k], scratch)
    return done


_FILL = CompiledKernel(fill_residuals, MATRIX, MATRIX, MATRIX, MATRIX)
