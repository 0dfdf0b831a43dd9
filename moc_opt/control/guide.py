"""What may stand in the third level in place of the climb of mu: a joint velocity that is wished for at every tick."""

from __future__ import annotations

from typing import Protocol

from moc_opt.model.robot_state import RobotState
from moc_opt.numerics.arrays import Array


class Guide(Protocol):
    """Says at every tick how the arm should move on its self-motion.

    The controller puts (rho / c2) x_d in the place of grad mu: on the feasible set the subproblem then is
    min rho/2 |x - x_d|^2, and box, solver, supervisor and residual check are those of every other run.
    """

    def start(self) -> None:
        """Begin at t = 0."""

    def wish(self, state: RobotState) -> Array:
        """Return x_d (n,) [rad/s] of this tick; what it holds outside ker A does not count. Called once a tick."""
