"""The arm's joints and their drives.

A joint with a spring has a motor angle theta, a spring deflection delta and a link angle q (Spong 1987):

    q = theta + delta,   M(q) ddq + h = tau_J,   B ddtheta + friction + tau_J = tau,   tau_J = -K delta - D ddelta/dt

B is the rotor inertia, as reduced by torque feedback (Ott et al. 2008).
"""

from __future__ import annotations

import math
from collections import deque

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from moc_opt.arrays import Array
from moc_opt.errors import PlantError
from moc_opt.robots import RobotData
from moc_opt.sim.settings import Mismatch, PlantSettings

_SAGGING_ROUNDS = 12  # iterations for the springs' deflection under the arm's weight
_MOST_RAD_A_STEP = 1.0  # one plant step may cover at most this phase of a spring's oscillation


class Joints:
    """Joint coordinates, and torque drives without dynamics.

    Attributes:
        q, v: (n,) positions and velocities of the links [rad], [rad/s].
        theta, omega: (n,) positions and velocities of the motors [rad], [rad/s].
        shown: what the encoders measure: (q, v) or (theta, omega).
        torque: (n,) torque of the drives, without ripple [Nm].
        motors: slice of the motors in MuJoCo's degrees of freedom.
    """

    def __init__(
        self, data: RobotData, settings: PlantSettings, mismatch: Mismatch, model: mujoco.MjModel, state: mujoco.MjData
    ) -> None:
        self._model, self._state, self._high, self._low = model, state, data.tau_max.copy(), -data.tau_max
        self._elastic, self._on_links = settings.elastic, settings.encoder_side == "link"
        self._stiffness = _stiffnesses(data, settings)
        self.motors = slice(None, None, 2 if settings.elastic else 1)  # with springs: motor 1, spring 1, motor 2, ...
        self.q, self.v = self.theta, self.omega = state.qpos, state.qvel
        if settings.elastic:
            self.q, self.v, self.theta, self.omega = np.zeros((4, data.n))
        self.shown = (self.q, self.v) if self._on_links else (self.theta, self.omega)
        self._direct = not settings.elastic and settings.torque_ripple == 0.0
        self.torque = state.qfrc_applied if self._direct else np.zeros(data.n)
        self._ripple = settings.torque_ripple * data.tau_max
        self._waves, self._phase = settings.torque_ripple_per_turn, mismatch.ripple_phase
        self._delay_ticks, self._due = settings.delay_ticks, deque[Array]()

    def start(self, shown: Array, speed: Array) -> None:
        """Put the arm where error-free encoders read ``shown`` (n,) [rad], with ``speed`` (n,) [rad/s]."""
        state, model = self._state, self._model
        weight = state.qfrc_bias[self.motors]
        state.qpos[self.motors] = shown
        mujoco.mj_forward(model, state)
        for _ in range(_SAGGING_ROUNDS if self._elastic else 0):
            sag = -weight / self._stiffness
            state.qpos[1::2] = sag
            state.qpos[::2] = shown - sag if self._on_links else shown
            mujoco.mj_forward(model, state)
        np.clip(weight, self._low, self._high, out=self.torque)
        self._due = deque([self.torque.copy()] * self._delay_ticks)
        state.qvel[self.motors] = speed
        self.drive()
        mujoco.mj_forward(model, state)
        self.gather()

    def command(self, tau: ArrayLike) -> None:
        """Queue a torque (n,) [Nm], and apply the torque that is due."""
        wanted = np.asarray(tau, dtype=np.float64)
        if wanted.shape != self._high.shape:
            raise PlantError(f"tau has shape {wanted.shape}: give {self._high.shape}, one torque per joint [Nm]")
        if not math.isfinite(wanted.dot(wanted)):
            raise PlantError(
                f"tau = {wanted.tolist()} Nm is not finite: this step did not move the arm; correct the controller, "
                "or stop the arm when the solver fails"
            )
        self._due.append(np.minimum(np.maximum(wanted, self._low), self._high))
        self.torque[:] = self._due.popleft()

    def drive(self) -> None:
        """Apply torque and ripple to the motors."""
        if not self._direct:
            ripple = self._ripple * np.sin(self._waves * self._state.qpos[self.motors] + self._phase)
            self._state.qfrc_applied[self.motors] = self.torque + ripple

    def gather(self) -> None:
        """Update the positions and velocities of elastic joints."""
        if self._elastic:
            place, speed = self._state.qpos, self._state.qvel
            self.theta[:], self.omega[:] = place[::2], speed[::2]
            self.q[:], self.v[:] = place[::2] + place[1::2], speed[::2] + speed[1::2]


def add_springs(data: RobotData, spec: mujoco.MjSpec, settings: PlantSettings) -> None:
    """Put a spring in each joint."""
    for joint, value in zip(list(spec.joints), _stiffnesses(data, settings), strict=True):
        spring = joint.parent.add_joint(name=f"{joint.name}_spring", type=joint.type, axis=joint.axis, pos=joint.pos)
        spring.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        spring.stiffness[0] = value
        spring.damping[0] = settings.joint_spring_damping_Nm_s_per_rad


def _stiffnesses(data: RobotData, settings: PlantSettings) -> Array:
    given = np.atleast_1d(np.asarray(settings.joint_stiffness_Nm_per_rad, dtype=np.float64))
    if given.size not in (1, data.n):
        raise PlantError(
            f"joint_stiffness_Nm_per_rad has {given.size} entries: robot {data.name!r} has {data.n} joints, "
            f"give {data.n}, or one number for all"
        )
    return np.broadcast_to(given, data.n).copy()


def check_substeps(model: mujoco.MjModel, state: mujoco.MjData, settings: PlantSettings) -> None:
    """Raise a PlantError if the plant step is too coarse for the springs."""
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, state, inertia)
    spring = np.arange(1, model.nv, 2)
    compliance = np.linalg.inv(inertia)[np.ix_(spring, spring)]
    root = np.sqrt(model.jnt_stiffness.reshape(model.njnt, -1)[spring, 0])
    fastest = math.sqrt(float(np.linalg.eigvalsh(root[:, None] * compliance * root)[-1]))
    if fastest * settings.substep_s > _MOST_RAD_A_STEP:
        need = math.ceil(settings.period_s * fastest / _MOST_RAD_A_STEP)
        raise PlantError(
            f"substeps = {settings.substeps} makes plant steps of {1e3 * settings.substep_s:g} ms, and the joints' "
            f"springs swing at up to {fastest:.0f} rad/s: raise substeps to {need}, or lower "
            "joint_stiffness_Nm_per_rad"
        )
