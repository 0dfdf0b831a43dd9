"""The climb of mu at a speed that does not depend on the pose: the gradient scaled by the curvature that it finds.

    d = (I - A^+ A) (grad mu + p grad mu_shaft),  t = d / |d|,  h = dd/ds along t
    x_d = k t |d| / max(-h, |d| / r)

Newton's step to the local maximum, at most r, in 1/k seconds. As the paper has it the speed is c2/rho |d|: where mu
is small or flat the climb is slow, and at a sharp maximum it is stiff. p is `tick.shaft_push`, not zero close to where
the shaft is lost.
"""

from __future__ import annotations

import numpy as np

from moc_opt.control.feedforward import independent_rows
from moc_opt.control.tick import shaft_push
from moc_opt.model.robot_model import RobotModel
from moc_opt.model.robot_state import RobotState
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.dense import cholesky, gram, solve_factored, times, transpose_times

RATE_PER_S = 5.0
"""k."""
LONGEST_RAD = 1.0
"""r."""
PROBE_RAD = 1e-3
"""Way over which the slope's change is taken."""


@njit(cache=True, nogil=True)
def on_self_motion(A: Array, u: Array, gradient: Array) -> Array:
    """Project a gradient (n,) on ker A."""
    A5, _ = independent_rows(A, u)
    found: Array = gradient - transpose_times(A5, solve_factored(cholesky(gram(A5)), times(A5, gradient)))
    return found


class ScaledClimb:
    """The guide of ``[control] climb = "scaled"``; see `moc_opt.control.guide.Guide`."""

    def __init__(self, robot: RobotModel, shaft_margin_m2: float = 0.0) -> None:
        self._robot, self._shaft_margin = robot, shaft_margin_m2

    def start(self) -> None:
        """Do nothing: nothing is remembered."""

    def desired_velocity(self, state: RobotState) -> Array:
        """Return x_d (n,) [rad/s]; zero at a top of mu, and where the pose is singular."""
        slope = self._slope(state)
        steepness = float(np.sqrt(slope @ slope))
        if not steepness > 1e-12:  # also catches NaN
            return np.zeros(state.n)
        way = slope / steepness
        ahead = self._robot.state(state.q + PROBE_RAD * way)
        bend = (float(self._slope(ahead) @ way) - steepness) / PROBE_RAD
        step = steepness / max(-bend, steepness / LONGEST_RAD)
        found: Array = RATE_PER_S * step * way
        return found if np.isfinite(step) else np.zeros(state.n)

    def _slope(self, state: RobotState) -> Array:
        push = shaft_push(state.mu_shaft, self._shaft_margin)
        return on_self_motion(state.A, state.tool_direction, state.grad_mu + push * state.grad_mu_shaft)
