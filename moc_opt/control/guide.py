"""The protocol of a guide: a desired joint velocity at every tick, in place of the climb of mu in the third level."""

from __future__ import annotations

from typing import Protocol

from moc_opt.arrays import Array
from moc_opt.robots.state import RobotState


class Guide(Protocol):
    """Gives the desired self-motion of every tick.

    The subproblem's `pull` is (rho / c2) x_d in place of grad mu: on the feasible set the subproblem then is
    min rho/2 |x - x_d|^2, and box, solver, supervisor and residual check are those of every other run.
    """

    def start(self) -> None:
        """Begin at t = 0."""

    def desired_velocity(self, state: RobotState) -> Array:
        """Return x_d (n,) [rad/s] of this tick; its part outside ker A has no effect. Called once a tick."""
