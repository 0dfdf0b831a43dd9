"""A controller that is replaced by another one while the arm moves."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from moc_opt.control import Controller, ControlSettings
from moc_opt.errors import MocOptError
from moc_opt.model.robot_model import RobotModel, RobotState
from moc_opt.numerics.arrays import Array

BLEND_S = 0.1
"""Time constant in which the difference of two controllers' torques decays after an exchange."""
_FADED_NM = 1e-6


class Choice(NamedTuple):
    """A controller, and the settings that it was built from."""

    controller: Controller
    solver: str
    settings: ControlSettings


class ExchangeableController:
    """The controller in use, as the closed loop calls it (``sim.protocols.TorqueController``).

    After an exchange the torque goes on where it was, tau = tau_new + offset with offset = tau_old - tau_new at
    first, and offset decays by exp(-t / BLEND_S). The next exchange waits for BLEND_S: exchanges at every tick would
    hold the torque where it is, and nobody would control the arm. Of those that wait the last one that can start
    counts.

    Args:
        robot: the model that the control law uses.
        first: starts at the first tick.
        period_s: control period [s].
        refused: called with a choice that cannot start and its error, once it is known which controller goes on.
    """

    def __init__(
        self, robot: RobotModel, first: Choice, period_s: float, refused: Callable[[Choice, MocOptError], None]
    ) -> None:
        self._robot, self._refused = robot, refused
        self._decay = float(np.exp(-period_s / BLEND_S))
        self._apart, self._wait = round(BLEND_S / period_s), 0  # ticks between exchanges, and until the next one may be
        self.used = first
        self._waiting = [first]  # the last one first in line
        self._offset, self._applied = np.zeros(robot.n), np.empty(0)

    @property
    def tip(self) -> Array:
        """Where the last tick saw the tip (3,) [m]."""
        return self.state.tip

    def replace(self, choice: Choice) -> None:
        """Use another controller from the next tick on, or BLEND_S after the last exchange, if it can start there."""
        self._waiting.append(choice)

    def restart(self) -> None:
        """Forget the motion so far: the next tick is the first one of a run."""
        self._waiting.insert(0, self.used)  # started afresh where none of the others can start
        self._wait = 0
        self._offset, self._applied = np.zeros(self._robot.n), np.empty(0)

    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> None:
        """Take the first state; the controller itself starts at its first tick."""
        self.state: RobotState = self._robot.state(q, v)

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Compute the torque (n,) [Nm] of the controller in use, blended with that of the one before."""
        self.state = state = self._robot.state(q, v)
        self._wait -= 1
        if self._waiting and self._wait <= 0:
            self._exchange(state, tip_ref, trocar)
        tau = self.used.controller.tick(state, tip_ref, trocar)
        if self._offset.any():
            tau = tau + self._offset
            self.used.controller.set_applied_torque(tau)
            self._offset = self._offset * self._decay
            if np.abs(self._offset).max() < _FADED_NM:
                self._offset = np.zeros(self._robot.n)
        self._applied = tau
        return tau

    def set_applied_torque(self, tau: Array) -> None:
        """See ``sim.protocols.TorqueController``."""
        self._applied = tau
        self.used.controller.set_applied_torque(tau)

    def _exchange(self, state: RobotState, tip_ref: Array, trocar: Array) -> None:
        waiting, self._waiting, refused = self._waiting, [], []
        for choice in reversed(waiting):
            controller = choice.controller
            try:
                controller.start(state, tip_ref, trocar)
                first = controller.tick(state, tip_ref, trocar)
                controller.start(state, tip_ref, trocar)
            except MocOptError as error:
                if choice is self.used:
                    raise
                refused.append((choice, error))
                continue
            if self._applied.size:  # not the first tick of a run
                self._offset, self._wait = self._applied - first, self._apart
                controller.set_applied_torque(self._applied)
            self.used = choice
            break
        for choice, reason in refused:
            self._refused(choice, reason)
