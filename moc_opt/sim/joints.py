"""The arm's joints in MuJoCo's state: where links and motors stand, and the torque that reaches the motors."""

from __future__ import annotations

import mujoco
import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.robots import RobotData
from moc_opt.sim.elastic import drive, gather, stiffnesses
from moc_opt.sim.mismatch import Mismatch
from moc_opt.sim.settings import PlantSettings

_SAGGING_ROUNDS = 12
"""Rounds of a fixed point: the weight deflects a joint by milliradians, which changes its torque by a thousandth."""


class Joints:
    """Joint coordinates and torques: MuJoCo's own arrays, unless joints are elastic or torques ripple.

    Attributes:
        q, v: (n,) true positions and velocities of the links [rad], [rad/s].
        torque: (n,) of the drives, before ripple [Nm].
        bias: (n,) torque of weight and velocity on the motors, as MuJoCo last computed it [Nm].
        motors: the motors' entries among MuJoCo's degrees of freedom.
        theta, omega: the same of the motors.
        stride: MuJoCo's coordinates of a joint: 1, or 2 where there is a spring.
        ripple: (3, n) as ``elastic.drive`` takes it.
        direct: whether `torque` is MuJoCo's own array; if not, ``drive`` puts it on the motors before each plant step.
        on_links: whether the encoders are there.
    """

    def __init__(
        self, data: RobotData, settings: PlantSettings, mismatch: Mismatch, model: mujoco.MjModel, state: mujoco.MjData
    ) -> None:
        """Bind them to a compiled model; arrays are taken once, and must stay MuJoCo's."""
        self._model, self._state = model, state
        self.on_links = settings.encoder_side == "link"
        self._stiffness = stiffnesses(data, settings)
        self.stride = 2 if settings.elastic else 1  # motor, then spring
        self.motors = slice(None, None, self.stride)
        self.bias = state.qfrc_bias[self.motors]
        self.q, self.v = self.theta, self.omega = state.qpos, state.qvel
        if settings.elastic:
            self.q, self.v, self.theta, self.omega = np.zeros((4, data.n))
        self.direct = not settings.elastic and settings.torque_ripple == 0.0
        self.torque = state.qfrc_applied if self.direct else np.zeros(data.n)
        self.ripple = np.empty((3, data.n))
        self.ripple[0], self.ripple[1] = settings.torque_ripple * data.tau_max, settings.torque_ripple_per_turn
        self.ripple[2] = mismatch.ripple_phase

    def place(self, shown: Array) -> None:
        """Put the arm at rest where encoders without bias show (n,) [rad]; elastic joints bear its weight."""
        state, model = self._state, self._model
        state.qpos[self.motors] = shown
        mujoco.mj_forward(model, state)
        if self.stride == 1:
            return
        for _ in range(_SAGGING_ROUNDS):
            sag = -self.bias / self._stiffness
            state.qpos[1::2] = sag
            state.qpos[::2] = shown - sag if self.on_links else shown
            mujoco.mj_forward(model, state)

    def start(self, speed: Array) -> None:
        """Let motors and links move at (n,) [rad/s], with the torque of the drives on them."""
        state = self._state
        state.qvel[self.motors] = speed
        if not self.direct:
            drive(self.torque, state.qpos, self.stride, self.ripple, state.qfrc_applied)
        mujoco.mj_forward(self._model, state)
        if self.stride != 1:
            gather(state.qpos, state.qvel, self.q, self.v, self.theta, self.omega)

    @property
    def shown(self) -> tuple[Array, Array]:
        """Positions and velocities (n,) of the side that the encoders are on [rad], [rad/s]."""
        return (self.q, self.v) if self.on_links else (self.theta, self.omega)
