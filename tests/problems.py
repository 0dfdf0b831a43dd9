"""Seeded subproblems for the tests, of the random arms that the benchmarks use too."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.subproblems.arms import (
    Arm,
    problem_of,
    random_arm,
    random_box,
    rotation,
    smooth_sequence,
    unit,
)
from moc_opt.qp.problem import NullSpaceQP

Array = NDArray[np.float64]
__all__ = [
    "Arm", "infeasible_problem", "on_rows", "out_of_reach", "problem_of", "random_arm", "random_box", "random_problem",
    "rotation", "smooth_sequence", "unit", "unstructured_problems",
]  # fmt: skip


def random_problem(
    rng: np.random.Generator, n: int = 7, *, arm: Arm | None = None, structured: bool = True, feasible: bool = True,
    **weights: float,
) -> NullSpaceQP:  # fmt: skip
    """One subproblem of a random arm (or of ``arm``) at a random pose; weights: c0, c1, c2, regularization."""
    arm = random_arm(rng, n, structured) if arm is None else arm
    q = rng.uniform(-1.5, 1.5, arm.n)
    lower, upper = random_box(rng, arm.n)
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    qp = problem_of(arm, q, middle + 0.6 * half * rng.uniform(-1.0, 1.0, arm.n), lower, upper, **weights)
    return qp if feasible else out_of_reach(rng, qp)


def unstructured_problems(n: int, count: int, rng: np.random.Generator) -> list[NullSpaceQP]:
    """Feasible subproblems with a rigid tool and otherwise random Jacobians: no structure that a solver could use."""
    found = []
    for _ in range(count):
        spin, wrist = rng.normal(size=(3, n)), rng.normal(scale=0.4, size=(3, n))
        u = rng.normal(size=3)
        tip = wrist + np.cross(spin.T, 0.38 * u / np.linalg.norm(u)).T
        lower, upper = -rng.uniform(0.3, 3.0, n), rng.uniform(0.3, 3.0, n)
        x = 0.5 * (lower + upper) + 0.3 * (upper - lower) * rng.uniform(-1.0, 1.0, n)
        gradient = rng.normal(scale=0.1, size=n)
        found.append(NullSpaceQP(tip, wrist, tip @ x, wrist @ x, gradient, lower=lower, upper=upper))
    return found


def out_of_reach(rng: np.random.Generator, qp: NullSpaceQP) -> NullSpaceQP:
    """The same subproblem with references that no velocity in the box meets, by Farkas' lemma.

    With w = A^T y, no x in the box has y^T A x above the sum of max(w_i lower_i, w_i upper_i);
    b = s A w exceeds that by 10 to 100 %, and stays consistent with the rigid tool.
    """
    w = qp.A.T @ rng.normal(size=6)
    reach = np.maximum(w * qp.lower, w * qp.upper).sum()
    b = qp.A @ w * (rng.uniform(1.1, 2.0) * reach / (w @ w))
    return NullSpaceQP(
        qp.J_tip, qp.J_wrist, b[:3], b[3:], qp.grad_mu, qp.lower, qp.upper, qp.c0, qp.c1, qp.c2, qp.regularization, qp.q
    )


def on_rows(qp: NullSpaceQP, x: Array) -> Array:
    """The point of A x = b nearest to x: where an answer to the nonlinear problem, which is off it, is compared."""
    return np.asarray(x - np.linalg.pinv(qp.A, rcond=1e-6) @ (qp.A @ x - qp.b))


def infeasible_problem(rng: np.random.Generator, n: int = 7, **options: Any) -> NullSpaceQP:
    """One subproblem that has no feasible velocity."""
    return random_problem(rng, n, feasible=False, **options)
