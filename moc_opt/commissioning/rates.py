"""Gains against the inertia behind them: how near a sampled loop is to swinging by itself."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.control import ControlSettings
from moc_opt.model.gains import largest_rate
from moc_opt.model.robot_model import RobotModel
from moc_opt.sim.settings import PlantSettings

Array = NDArray[np.float64]
_POSES = 16


class Rates(NamedTuple):
    """Largest gain on a velocity over the inertia behind it, over home and seeded poses [1/s]."""

    D_X: float
    D_N: float
    K_N2: float
    """K_N2 and D_N2 together, in the null space of tip and wrist, idle joints included."""

    @property
    def largest(self) -> tuple[str, float]:
        """The gain that is nearest to its limit, and its rate."""
        name = max(self._fields, key=lambda field: float(getattr(self, field)))
        return name, float(getattr(self, name))


def gain_rates(robot: RobotModel, control: ControlSettings) -> Rates:
    """Compute the rates of the gains that ``control`` resolves to on this arm.

    Tip: D_X over the lightest direction, the largest eigenvalue of D_X J_T M^-1 J_T^T; the wrist alike with D_N. Null
    space: the largest eigenvalue of (Z M Z^T)^-1 Z (K_N2 + D_N2) Z^T.
    """
    gains = control.resolve_gains(robot.data.gains, robot.n)
    joints = np.diag(gains.K_N2 + gains.D_N2)
    rng = np.random.default_rng(0)
    found = np.zeros(3)
    for q in [robot.data.q_home, *rng.uniform(robot.q_min, robot.q_max, (_POSES, robot.n))]:
        state = robot.state(q)
        yields = np.linalg.solve(state.M, state.A.T)
        tip, wrist = state.J_tip @ yields[:, :3], state.J_wrist @ yields[:, 3:]
        _, values, rows = np.linalg.svd(state.A)
        Z = rows[int(np.sum(values > 1e-6 * values[0])) :]
        null = (
            np.linalg.eigvals(np.linalg.solve(Z @ state.M @ Z.T, Z @ joints @ Z.T)).real if len(Z) else [0.0]
        )
        here = [
            gains.D_X * np.linalg.eigvalsh(tip)[-1],
            gains.D_N * np.linalg.eigvalsh(wrist)[-1],
            np.max(null),
        ]
        found = np.maximum(found, here)
    return Rates(*(float(rate) for rate in found))


def allowed_rate(plant: PlantSettings) -> float:
    """The largest stable rate [1/s] with the plant's period and delay; its velocity filter counts as delay."""
    lag = 0.0
    if plant.velocity_cutoff_Hz > 0.0:
        lag = 1.0 / (2.0 * math.pi * plant.velocity_cutoff_Hz * plant.period_s)
    return largest_rate(plant.period_s, plant.delay_ticks + math.ceil(lag))
