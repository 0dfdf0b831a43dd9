"""Difficult subproblems: nearly singular Jacobians and very large or small numbers."""

import numpy as np

from moc_opt.qp.problem import NullSpaceQP
from tests.problems import Arm, changed, random_problem


def rounded(qp: NullSpaceQP, decimals: int) -> NullSpaceQP:
    """Round A to `decimals` decimal places, and recompute b so that the same x solves A x = b."""
    x = np.linalg.lstsq(qp.A, qp.b, rcond=1e-9)[0]
    A = np.round(qp.A, decimals)
    return remade(qp, A, A @ x)


def remade(qp: NullSpaceQP, A: np.ndarray, b: np.ndarray, size: float = 1.0) -> NullSpaceQP:
    """Replace the rows A x = b, and scale the bounds by ``size``."""
    return changed(
        qp, J_tip=A[:3], J_wrist=A[3:], v_tip=b[:3], v_wrist=b[3:], lower=size * qp.lower, upper=size * qp.upper
    )


def nearly_singular(qp: NullSpaceQP, size: float) -> NullSpaceQP:
    """Set the fifth singular value of A to `size` times the first."""
    u = np.linalg.svd(qp.J_tip - qp.J_wrist)[0][:, 2]
    free = np.eye(6) - 0.5 * np.outer(np.r_[u, -u], np.r_[u, -u])
    U, s, V = np.linalg.svd(free @ qp.A, full_matrices=False)
    x = np.linalg.lstsq(qp.A, qp.b, rcond=1e-9)[0]
    s[4:] = size * s[0], 0.0
    A = U * s @ V
    return remade(qp, A, A @ x)


def hard_problems(arm: Arm | None = None, n: int = 7, seed: int = 0) -> list[NullSpaceQP]:
    """Return four hard problems of each kind, two of them with regularization."""
    rng = np.random.default_rng(seed)
    found = []
    for regularization in (0.0, 1e-5):
        for _ in range(2):
            qp = random_problem(rng, n, arm=arm, structured=n == 7, regularization=regularization)
            found += [rounded(qp, decimals) for decimals in range(3, 13)]
            found += [nearly_singular(qp, 10.0**-k) for k in range(3, 15)]
            found += [remade(qp, size * qp.A, size * qp.b) for size in (1e-12, 1e-6, 1e6, 1e12)]
            found += [remade(qp, qp.A, size * qp.b, size) for size in (1e-12, 1e-6, 1e6, 1e12)]
            found += [remade(qp, np.vstack([qp.J_tip, qp.J_tip]), np.r_[qp.v_tip, qp.v_tip])]
    return found
