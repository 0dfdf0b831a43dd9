"""Gains for an untuned arm, derived from its inertia and from the gains of the tuned LWR4+."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from moc_opt.arrays import Array

if TYPE_CHECKING:
    from moc_opt.robots.model import RobotModel, RobotState

Table = dict[str, float | tuple[float, ...]]

JOINT_RATE = 12.0
JOINTS: Mapping[str, tuple[float, float, float]] = {
    "moc": (JOINT_RATE, 1.0 / 7.0, 125.0), "default": (JOINT_RATE, 1.0 / 7.0, 125.0),
    "tuned": (26.0, 0.087, 125.0), "robust": (17.0, 0.133, 85.0),
}  # fmt: skip
"""For each table: K_N2 / inertia [1/s], D_N2 / K_N2, and upper bound on (K_N2 + D_N2) / inertia [1/s]."""
CARTESIAN_RATE = 160.0
"""Upper bound on D_X / mass and D_N / mass [1/s]: 0.72 of the stability limit with three ticks of delay at 500 Hz."""
CARTESIAN: Mapping[str, tuple[float, float, float, float]] = {
    "dcac": (2000.0, 20.0, 600.0, 10.0), "moc": (3000.0, 30.0, 800.0, 10.0), "default": (3000.0, 80.0, 800.0, 60.0),
    "tuned": (3000.0, 80.0, 1670.0, 74.2), "robust": (3000.0, 50.0, 1670.0, 74.2),
}  # fmt: skip
"""K_X, D_X, K_N, D_N [N/m, N s/m]; "dcac" and "moc" from Su et al. (2019), Table I."""
_POSES = 16


def derived_gains(robot: RobotModel) -> dict[str, Table]:
    """Derive one table of gains for each name in `CARTESIAN`.

    K_N2 of joint i is proportional to M_ii at home, and D_N2 to K_N2. The other gains are those of the LWR4+. The
    ratios of gain to inertia have upper bounds, so that the sampled loop is stable. If a ratio exceeds its bound, both
    gains of its level (K and D of tip, RCM or manipulability) are scaled down by the same factor.
    """
    inertia = np.diag(robot.state(robot.data.q_home).M)
    inverse_masses = largest_inverse_masses(robot)
    tables: dict[str, Table] = {}
    for name, cartesian in CARTESIAN.items():
        tables[name] = {}
        for letter, inverse, (K, D) in zip("XN", inverse_masses, (cartesian[:2], cartesian[2:]), strict=True):
            share = CARTESIAN_RATE / max(CARTESIAN_RATE, D * inverse)
            tables[name] |= {f"K_{letter}": _rounded(share * K), f"D_{letter}": _rounded(share * D)}
        if name in JOINTS:
            rate, share, most = JOINTS[name]
            rate *= min(1.0, most / largest_null_rate(robot, (1.0 + share) * rate * inertia))
            joints = tuple(_rounded(rate * float(m)) for m in inertia)
            tables[name] |= {"K_N2": joints, "D_N2": tuple(_rounded(share * gain) for gain in joints)}
    return tables


def largest_inverse_masses(robot: RobotModel) -> tuple[float, float]:
    """Return the largest eigenvalue of J M^-1 J^T [1/kg] at tip and wrist."""
    found = [
        [np.linalg.eigvalsh(J @ np.linalg.solve(state.M, J.T))[-1] for J in (state.J_tip, state.J_wrist)]
        for state in surveyed(robot)
    ]
    tip, wrist = np.max(found, axis=0).tolist()
    return tip, wrist


def largest_null_rate(robot: RobotModel, gains: Array) -> float:
    """Return the largest eigenvalue of (Z M Z^T)^-1 Z diag(gains) Z^T [1/s]."""
    found = 0.0
    for state in surveyed(robot):
        _, values, rows = np.linalg.svd(state.A)
        Z = rows[int(np.sum(values > 1e-6 * values[0])) :]
        if len(Z):
            rates = np.linalg.eigvals(np.linalg.solve(Z @ state.M @ Z.T, Z @ (gains[:, None] * Z.T)))
            found = max(found, float(rates.real.max()))
    return found


def surveyed(robot: RobotModel) -> Iterator[RobotState]:
    """Yield the states at the home pose and at seeded random poses."""
    rng = np.random.default_rng(0)
    for q in [robot.data.q_home, *rng.uniform(robot.q_min, robot.q_max, (_POSES, robot.n))]:
        yield robot.state(q)


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")
