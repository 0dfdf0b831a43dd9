"""The interface of a peer, and the parts of the job that its library lacks."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np
import pinocchio as pin
from numba import njit
from numpy.typing import NDArray

from moc_opt.model.kinematics_kernels import point_jacobian
from moc_opt.model.manipulability_kernels import manipulability
from moc_opt.model.place_kernels import point_in_world
from moc_opt.model.robot_model import RobotModel
from moc_opt.model.shaft_kernels import desired_wrist
from moc_opt.numerics.arrays import Array

CLIMB = 30.0
"""Joint velocity per gradient of the manipulability [1/m^3 rad^2/s]: c2/rho of the subproblem, here 1/0.033."""
STIFFNESS_PER_S = 100.0
"""How fast a velocity-level peer closes an error of tip or shaft [1/s]."""


class Peer(Protocol):
    """A controller of another library, set up for the job."""

    @property
    def level(self) -> Literal["torque", "velocity"]:
        """The result of a tick; a velocity still needs a servo."""

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Return the joint torques (n,) [Nm] or velocities (n,) [rad/s].

        Args:
            q, v: (n,) measured [rad], [rad/s].
            tip_ref: (3, 3) rows X_d, dX_d, ddX_d.
            trocar: (2, 3) rows P_t, dP_t.
        """


@njit(cache=True)
def _gradient(axes: Array, rotation_t: Array, origin: Array, offsets: Array, moves: NDArray[np.bool_]) -> Array:
    n = axes.shape[0]
    tip, jacobian, grad = np.empty(3), np.empty((3, n)), np.empty(n)
    point_in_world(rotation_t, origin, offsets[0], tip)
    point_jacobian(axes, tip, moves[0], jacobian)
    manipulability(axes, jacobian, grad)
    return grad


class TipGradient:
    """dmu/dq (n,) at a pose, compiled: no peer is slowed by a term that its library lacks."""

    def __init__(self, robot: RobotModel) -> None:
        self._model = pin.buildModelFromXML(robot.data.urdf)
        self._data = data = self._model.createData()
        last = data.oMi[robot.n]
        self._views = (data.J.T, last.rotation.T, last.translation, robot.chain.offsets, robot.moves)

    def __call__(self, q: Array) -> Array:
        """Return the gradient (n,) at q (n,)."""
        pin.computeJointJacobians(self._model, self._data, q)
        grad: Array = _gradient(*self._views)
        return grad


@njit(cache=True)
def wrist_reference(tip_ref: Array, trocar: Array, span: float) -> tuple[Array, Array]:
    """Return wrist (3,) [m] and velocity (3,) [m/s] that put the shaft of a tip on its reference through the trocar."""
    return desired_wrist(tip_ref[0], tip_ref[1], trocar[0], trocar[1], span)
