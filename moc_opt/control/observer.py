"""The generalized-momentum observer: an estimate of the torque that acts on the arm beside the model's.

r = K_o (p - integral(tau + C^T v - g + r) dt - p(0)),   p = M v
(De Luca & Mattone 2003). r follows the external torque like a first-order filter of rate K_o.
Subtracted from the command it compensates friction and model error. It also stiffens the arm against
contact, so the force at the trocar has to be reported too.
"""

from __future__ import annotations

import numpy as np
from numba import float64

from moc_opt.errors import ControlError
from moc_opt.model.kinematics_kernels import state_views
from moc_opt.model.robot_model import RobotModel, RobotState
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import VECTOR, CompiledKernel, borrowed


@njit(cache=True, nogil=True)
def momentum_residual(
    M: Array, energy_slope: Array, gravity: Array, v: Array, tau: Array, gain: float, period: float,
    integral: Array, r: Array,
) -> None:  # fmt: skip
    """Advance the observer by one step, in place on integral (n,) and r (n,); energy_slope (n,) is C^T v."""
    for i in range(r.shape[0]):
        p = 0.0
        for j in range(r.shape[0]):
            p += M[i, j] * v[j]
        integral[i] += (tau[i] + energy_slope[i] - gravity[i] + r[i]) * period
        r[i] = gain * (p - integral[i])


@njit(cache=True, nogil=True)
def observe(record: Array, tau: Array, gain: float, period: float, integral: Array, r: Array) -> None:
    """Apply ``momentum_residual`` to a flat state record."""
    s = state_views(borrowed(record), r.shape[0])
    momentum_residual(s.M, s.energy_slope, s.gravity, s.v, tau, gain, period, integral, r)


_OBSERVE = CompiledKernel(observe, VECTOR, VECTOR, float64, float64, VECTOR, VECTOR)


class MomentumObserver:
    """Estimates the external joint torque, friction included.

    Args:
        robot: the model whose error is to be observed.
        gain: K_o [1/s]; the explicit step needs gain * period < 2, and noise requires much less.
        period: control period [s].
        name: of the setting that the gain stands in.

    Raises:
        ControlError: gain * period is not between 0 and 1.
    """

    def __init__(
        self, robot: RobotModel, gain: float, period: float, name: str = "observer_gain_per_s"
    ) -> None:
        if not 0.0 < gain * period < 1.0:
            raise ControlError(f"{name} = {gain} at a period of {period} s: keep it below {1.0 / period:g}")
        self._observe = _OBSERVE.code
        self._robot, self._gain, self._period = robot, gain, period
        self._integral, self.external_torque = np.zeros(robot.n), np.zeros(robot.n)

    def start(self, state: RobotState) -> None:
        """Begin with no external torque at the momentum of ``state``."""
        self._integral[:] = state.M @ state.v
        self.external_torque = np.zeros(self._robot.n)

    def update(self, state: RobotState, tau: Array) -> Array:
        """Advance by the period over which ``tau`` (n,) acted, and that ended at ``state``; return r (n,) [Nm]."""
        self._observe(state.record, tau, self._gain, self._period, self._integral, self.external_torque)
        return self.external_torque
