"""The arm's joints in MuJoCo's state: where links and motors stand, and the torque that reaches the motors."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from moc_opt.robots import RobotData
from moc_opt.sim.elastic import DRIVE, GATHER, stiffnesses
from moc_opt.sim.mismatch import Mismatch
from moc_opt.sim.settings import PlantSettings

Array = NDArray[np.float64]

_SAGGING_ROUNDS = 12
"""The weight bends a joint by milliradians, which changes the torque of the weight by a thousandth, and so on."""


class Joints:
    """Joint coordinates and torques: MuJoCo's own arrays, unless joints are elastic or torques ripple.

    Attributes:
        q, v: (n,) true positions and velocities of the links [rad], [rad/s].
        shown: the same of the side that the encoders are on.
        torque: (n,) of the drives, before ripple [Nm].
        bias: (n,) torque of weight and velocity on the motors, as MuJoCo last computed it [Nm].
        motors: the motors' entries among MuJoCo's degrees of freedom.
        act: puts torque and ripple on the motors, before each plant step; None where `torque` is MuJoCo's own array.
        gather: brings q, v and shown up to date after the last plant step; None where they are MuJoCo's own.
    """

    act: Callable[[], Any] | None = None
    gather: Callable[[], Any] | None = None

    def __init__(
        self, data: RobotData, settings: PlantSettings, mismatch: Mismatch, model: mujoco.MjModel, state: mujoco.MjData
    ) -> None:
        """Bind them to a compiled model; arrays are taken once, and must stay MuJoCo's."""
        self._model, self._state = model, state
        self._on_links = settings.encoder_side == "link"
        self._stiffness = stiffnesses(data, settings)
        rigid, smooth = not settings.elastic, settings.torque_ripple == 0.0
        stride = 1 if rigid else 2  # coordinates of a joint: motor, then spring
        self.motors = slice(None, None, stride)
        self.bias = state.qfrc_bias[self.motors]
        if rigid:
            self.q, self.v = self.shown = state.qpos, state.qvel
        else:
            links, motors = (np.zeros(data.n), np.zeros(data.n)), (np.zeros(data.n), np.zeros(data.n))
            self.q, self.v = links
            self.shown = links if self._on_links else motors
            self.gather = partial(GATHER.code, state.qpos, state.qvel, *links, *motors)
        self.torque = state.qfrc_applied if rigid and smooth else np.zeros(data.n)
        if not (rigid and smooth):
            self.act = partial(
                DRIVE.code, self.torque, state.qpos, stride, settings.torque_ripple * data.tau_max,
                settings.torque_ripple_per_turn, np.array(mismatch.ripple_phase), state.qfrc_applied,
            )  # fmt: skip

    def place(self, shown: Array) -> None:
        """Put the arm at rest where encoders without bias show (n,) [rad]; elastic joints bear its weight."""
        state, model = self._state, self._model
        state.qpos[self.motors] = shown
        mujoco.mj_forward(model, state)
        if self.gather is None:
            return
        for _ in range(_SAGGING_ROUNDS):
            sag = -self.bias / self._stiffness
            state.qpos[1::2] = sag
            state.qpos[::2] = shown - sag if self._on_links else shown
            mujoco.mj_forward(model, state)

    def start(self, speed: Array) -> None:
        """Let motors and links move at (n,) [rad/s], with the torque of the drives on them."""
        self._state.qvel[self.motors] = speed
        if self.act is not None:
            self.act()
        mujoco.mj_forward(self._model, self._state)
        if self.gather is not None:
            self.gather()
