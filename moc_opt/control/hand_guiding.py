"""Hand guiding: the arm carries its own weight and resists motion a little, so that a hand can move it.

tau = g(q) - D v: gravity compensation with joint damping, the law of step one of the operative procedure
(Su et al. 2019). The arm has no position to return to: errors of the model's masses push it slowly, unless
joint friction or a hand holds it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.arrays import Array
from moc_opt.errors import ControlError
from moc_opt.robots.model import RobotModel, RobotState


class HandGuiding:
    """The torque law of hand guiding."""

    def __init__(self, robot: RobotModel, damping_Nm_s_per_rad: ArrayLike = 3.0) -> None:
        """Set the damping D, one number or one a joint; a ControlError where one is not finite or below zero."""
        self.robot = robot
        damping = np.asarray(damping_Nm_s_per_rad, dtype=np.float64)
        if damping.shape not in ((), (robot.n,)) or not np.isfinite(damping).all() or (damping < 0.0).any():
            raise ControlError(f"damping_Nm_s_per_rad = {damping.tolist()!r}: give 1 or {robot.n} numbers of 0 or more")
        self._damping = np.broadcast_to(damping, (robot.n,))

    def tick(self, state: RobotState) -> Array:
        """Compute the torque (n,) [Nm] for the measured state, cut at the joints' limits."""
        tau = self.robot.gravity(state.q) - self._damping * state.v
        return np.clip(tau, -self.robot.tau_max, self.robot.tau_max)
