"""Compiled ascent of manipulability over all poses with the same tip and wrist, however many freedoms they have.

On poses inside the joint limits: a step along the gradient of mu, projected onto ker A with the joints that would leave
their range held, then Newton's method back to tip and wrist. It ends at a local maximum over the feasible set.
"""

from __future__ import annotations

import numpy as np

from moc_opt.model.kinematics_kernels import point_jacobian
from moc_opt.model.manipulability_kernels import manipulability
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.dense import cholesky, gram, solve_in_place, times, transpose_times
from moc_opt.redundancy.continuation import TOLERANCE, Constraint, forward

LONGEST = 0.3  # of a step, in joint space [rad]
SHORTEST = 1e-6  # below it an ascent has arrived: mu is flat there to its square
FLAT = 1e-9  # of the gradient: less of it along the allowed ways is none
STEPS = 200
NEWTON = 40
DAMPING = 1e-12  # of the trace of A A^T: A has a row too many


@njit(cache=True)
def look(arm: Constraint, q: Array, error: Array, a: Array, grad: Array) -> float:
    """Fill the error (6,) of tip and wrist, A (6,n) and the gradient (n,) of mu; returns mu."""
    n = q.shape[0]
    axes, points = np.empty((n, 6)), np.empty((2, 3))
    forward(arm, q, axes, points)
    point_jacobian(axes, points[0], arm.moves[0], a[0:3])
    point_jacobian(axes, points[1], arm.moves[1], a[3:6])
    for row in range(6):
        error[row] = arm.target[row // 3, row % 3] - points[row // 3, row % 3]
    return float(manipulability(axes, a[0:3], grad))


@njit(cache=True)
def allowed(
    arm: Constraint, q: Array, a: Array, error: Array, desired: Array, near: float, step: Array
) -> None:
    """Compute the step (n,) nearest to the desired one that moves tip and wrist by the error and leads to no limit.

    No joint within ``near`` of a limit goes towards it. An active-set method: joints that would leave are held, and
    one that its multiplier draws inwards is let go.
    """
    n = q.shape[0]
    part, still = a.copy(), desired.copy()
    held = np.zeros(n)
    for _ in range(4 * n):
        S = gram(part)
        trace = S[0, 0] + S[1, 1] + S[2, 2] + S[3, 3] + S[4, 4] + S[5, 5]
        for row in range(6):
            S[row, row] += DAMPING * trace + 1e-14
        force = error - times(part, still)
        solve_in_place(cholesky(S), force)
        free = desired + transpose_times(a, force)
        left, drawn, most = False, -1, 0.0
        for j in range(n):
            step[j] = free[j] * (1.0 - held[j])
            outwards = (q[j] >= arm.q_max[j] - near and free[j] > 0.0) or (
                q[j] <= arm.q_min[j] + near and free[j] < 0.0
            )
            if outwards and held[j] == 0.0:
                left = True
                held[j], still[j], step[j] = 1.0, 0.0, 0.0
                part[:, j] = 0.0
            elif held[j] == 1.0 and not outwards and abs(free[j]) > most:
                drawn, most = j, abs(free[j])
        if left:
            continue
        if drawn < 0:
            return
        held[drawn], still[drawn] = 0.0, desired[drawn]
        part[:, drawn] = a[:, drawn]


@njit(cache=True)
def place(arm: Constraint, q: Array, rounds: int) -> bool:
    """Move q (n,) inside its limits onto tip and wrist by Newton's method; whether it came there."""
    n = q.shape[0]
    error, a, grad = np.empty(6), np.empty((6, n)), np.empty(n)
    desired, step = np.zeros(n), np.empty(n)
    for _ in range(rounds):
        look(arm, q, error, a, grad)
        if np.abs(error).max() < TOLERANCE:
            return True
        allowed(arm, q, a, error, desired, 0.0, step)
        length = np.abs(step).max()
        if not length > 1e-13:
            return False
        share = min(1.0, LONGEST / length)
        for j in range(n):
            q[j] = min(max(q[j] + share * step[j], arm.q_min[j]), arm.q_max[j])
    return False


@njit(cache=True)
def ascend(arm: Constraint, q: Array) -> float:
    """Place q (n,) and climb to a local maximum of mu, in place; returns it, or -1 where q cannot be placed."""
    n = q.shape[0]
    if not place(arm, q, NEWTON):
        return -1.0
    error, a, grad, nothing = np.empty(6), np.empty((6, n)), np.empty(n), np.zeros(6)
    way, trial = np.empty(n), np.empty(n)
    mu = look(arm, q, error, a, grad)
    h = 0.1
    for _ in range(STEPS):
        allowed(arm, q, a, nothing, grad, 0.01 * h, way)  # a step that a limit cuts short leads nowhere
        length = np.sqrt(np.sum(way * way))
        found = -1.0
        while length > FLAT * np.sqrt(np.sum(grad * grad)) and h >= SHORTEST:
            for j in range(n):
                trial[j] = min(max(q[j] + h / length * way[j], arm.q_min[j]), arm.q_max[j])
            if place(arm, trial, 10):
                found = look(arm, trial, error, a, grad)
                if found > mu:
                    break
            h *= 0.3
        if found > mu:
            q[:] = trial
            mu = found
            h = min(2.0 * h, LONGEST)
        elif h < SHORTEST:
            return mu
        else:
            h *= 0.3
    return mu


@njit(cache=True)
def ascend_all(arm: Constraint, starts: Array, mus: Array) -> None:
    """Climb by `ascend` from every row of starts (k,n), in place, with mu into mus (k,)."""
    for k in range(starts.shape[0]):
        mus[k] = ascend(arm, starts[k])
