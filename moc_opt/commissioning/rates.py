"""Gains against the inertia behind them: how near a sampled loop is to swinging by itself."""

from __future__ import annotations

import math
from typing import NamedTuple

from moc_opt.control import ControlSettings
from moc_opt.model.gains import largest_inverse_masses, largest_null_rate, largest_rate
from moc_opt.model.robot_model import RobotModel
from moc_opt.sim.settings import PlantSettings


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
    tip, wrist = largest_inverse_masses(robot)
    return Rates(gains.D_X * tip, gains.D_N * wrist, largest_null_rate(robot, gains.K_N2 + gains.D_N2))


def allowed_rate(plant: PlantSettings) -> float:
    """Return the largest stable rate [1/s] with the plant's period and delay; its velocity filter counts as delay."""
    lag = 0.0
    if plant.velocity_cutoff_Hz > 0.0:
        lag = 1.0 / (2.0 * math.pi * plant.velocity_cutoff_Hz * plant.period_s)
    return largest_rate(plant.period_s, plant.delay_ticks + math.ceil(lag))
