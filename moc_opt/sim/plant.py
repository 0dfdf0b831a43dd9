"""The simulated arm and its compliant trocar.

The trocar's force on the tool is (I - u u^T) (stiffness (P_t - c) + damping (dP_t - w)). Here P_t is the trocar, u the
direction of the shaft, c the shaft's point nearest to P_t, and w the tool's velocity at c.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from moc_opt import core
from moc_opt.arrays import Array, read_only
from moc_opt.errors import PlantError, UnknownNameError
from moc_opt.robots import RobotData
from moc_opt.sim.joints import Joints, add_springs, check_substeps
from moc_opt.sim.mjcf import FORCE_SENSOR, TOOL_BODY, add_mismatch, build_spec, compile_model
from moc_opt.sim.sensors import Encoders, Measurement, Noise
from moc_opt.sim.settings import Mismatch, PlantSettings

if mujoco.get_mju_user_warning() is None:
    # MuJoCo's default handler writes a log file into the current folder.
    mujoco.set_mju_user_warning(lambda message: None)


_RUNAWAY_RAD_PER_S = 1e3  #: Above this norm of the joint velocities, the simulation has diverged.


@dataclass(frozen=True)
class Stop:
    """How the arm is stopped."""

    damping: float = 15.0  #: Damping by the drives [Nm s/rad].
    seconds: float = 0.5  #: Shortest duration of the stop.


DEFAULT_STOP = Stop()


def _finite(name: str, value: ArrayLike, shape: tuple[int, ...], note: str = "") -> Array:
    array = np.asarray(value, np.float64)
    if array.shape != shape or not math.isfinite((flat := array.ravel()).dot(flat)):  # faster than isfinite().all()
        raise PlantError(f"{name} = {array.tolist()!r:.200}: give finite numbers of shape {shape}{note}")
    return array


def _truth(of: Callable[[Any], Array], about: str) -> Any:
    return property(lambda plant: read_only(of(plant).copy()), doc=about)


class Plant:
    """An arm in MuJoCo with trocar, sensors and delay, advanced one control period at a time.

    The arm begins at `data.q_home`. Equal arguments and torques give equal results to the last bit. `mj_model` and
    `mj_data` are for drawing and checks only.

    Args:
        data: the robot's data, as used for the controller's model.
        settings: how the plant differs from that model; None: `PlantSettings()`.
        seed: seed of mismatch and noise, 0 or more.

    Raises:
        PlantError: MuJoCo cannot load the robot, its URDF lacks a frame, or the joints' stiffness is unusable.
    """

    def __init__(self, data: RobotData, settings: PlantSettings | None = None, seed: int = 0) -> None:
        self.data = data
        self.settings = settings = PlantSettings() if settings is None else settings
        # Separate random streams keep the errors independent.
        mismatch, *self._noise_seeds = np.random.SeedSequence(seed).spawn(3)
        spec = build_spec(data, substep_s=settings.substep_s, gravity=settings.gravity)
        heavy = [body.name for body in spec.bodies if body.mass > 0.0]
        self.mismatch = Mismatch.draw(data, settings, heavy, mismatch)
        add_mismatch(data, spec, self.mismatch)
        if settings.elastic:
            add_springs(data, spec, settings)
        self.mj_model = model = compile_model(data.name, spec)
        self.mj_data = mujoco.MjData(model)
        self._drive_damping, self._drive_friction = np.array(model.dof_damping), np.array(model.dof_frictionloss)
        self._joints = Joints(data, settings, self.mismatch, model, self.mj_data)
        self._bind()
        self.reset(data.q_home)
        if settings.elastic:
            check_substeps(model, self.mj_data, settings)

    def _bind(self) -> None:
        data, model, state, settings = self.data, self.mj_model, self.mj_data, self.settings
        bodies = {model.body(i).name: i for i in range(1, model.nbody)}
        frames = (TOOL_BODY, data.tip_frame, data.wrist_frame)
        missing = [name for name in frames if name not in bodies]
        if missing:
            raise PlantError(f"robot {data.name!r}: its URDF has no links {missing}: `load_data` adds them")
        tool, tip, wrist = (bodies[name] for name in frames)
        origin = state.subtree_com[model.body_rootid[tool]]
        self._tip, self._wrist = state.xpos[tip], state.xpos[wrist]
        self._shaft = self._tip, self._wrist, state.cvel[tip], origin, state.xipos[tool]
        self._tool_wrench, self._felt = state.xfrc_applied[tool], np.zeros(6)
        first = model.sensor(FORCE_SENSOR).adr[0]
        self._held = state.sensordata[first : first + 6]
        self._bodies, self._pushes = bodies, dict[int, tuple[Array, Array]]()  # force [N], point [m]
        self._tissue = settings.trocar_stiffness_N_per_m, settings.trocar_damping_Ns_per_m
        self._trocar = np.zeros((2, 3))
        self._substeps_s = [k * settings.substep_s for k in range(settings.substeps)]

    def reset(self, q: ArrayLike, v: ArrayLike | None = None) -> None:
        """Restart at time 0 without pushes. The drives carry the arm's weight until the first command acts.

        Args:
            q: (n,) joint positions that encoders without noise would show [rad].
            v: (n,) joint velocities [rad/s]; None: the arm is at rest.

        Raises:
            PlantError: wrong shape, not finite, or q outside the limits.
        """
        start = _finite("q", q, (self.data.n,))
        speed = np.zeros(self.data.n) if v is None else _finite("v", v, (self.data.n,))
        outside = np.flatnonzero((start < self.data.q_min - 1e-9) | (start > self.data.q_max + 1e-9))
        if outside.size:
            i = int(outside[0])
            raise PlantError(
                f"q[{i}] = {start[i]:.6g} rad is outside the limits of {self.data.joint_names[i]!r}: "
                f"choose {self.data.q_min[i]:.6g} to {self.data.q_max[i]:.6g}"
            )
        shown, felt = (np.random.default_rng(seed) for seed in self._noise_seeds)
        self._encoders = Encoders(self.settings, self.mismatch.encoder_bias, shown)
        levels = np.repeat([self.settings.force_noise_N, self.settings.torque_noise_Nm], 3)
        self._wrench_noise = Noise(felt, levels)
        self._pushes.clear()
        self.mj_model.dof_damping[:] = self._drive_damping
        self.mj_model.dof_frictionloss[:] = self._drive_friction
        self._ticks, self._touch = 0, (0.0, 0.0)
        mujoco.mj_resetData(self.mj_model, self.mj_data)
        self._joints.start(start - self.mismatch.encoder_bias, speed)
        self._load(0.0)
        self._feel()
        self._sense(*self._encoders.start(*self._joints.shown))
        self._ran_away = not self._joints.v.dot(self._joints.v) < _RUNAWAY_RAD_PER_S**2

    def step(self, tau: ArrayLike, trocar: ArrayLike | None = None) -> None:
        """Advance one control period.

        Args:
            tau: (n,) commanded joint torques [Nm]. They act `delay_ticks` periods later, clipped to +-tau_max.
            trocar: (2, 3) rows P_t [m], dP_t [m/s]; None: no trocar.

        Raises:
            PlantError: an argument has a wrong shape or is not finite, or the arm ran away.
        """
        rows = ", point [m] and velocity [m/s], or None for no trocar; this step did not move the arm"
        place = None if trocar is None else _finite("trocar", trocar, (2, 3), rows)
        if self._ran_away:
            raise PlantError(f"the arm ran away before t = {self.time:.4g} s: call reset first")
        joints, model, state = self._joints, self.mj_model, self.mj_data
        joints.command(tau)
        self._touch = (0.0, 0.0) if place is None else self._tissue
        if place is not None:
            self._trocar[:] = place
        # In this order, the kinematics after the loop belong to the new state.
        for elapsed_s in self._substeps_s:
            joints.drive()
            self._load(elapsed_s)
            mujoco.mj_step2(model, state)
            mujoco.mj_step1(model, state)
        joints.gather()
        self._ticks += 1
        if not joints.v.dot(joints.v) < _RUNAWAY_RAD_PER_S**2:  # also true for NaN
            self._ran_away = True
            raise PlantError(
                f"the arm ran away before t = {self.time:.4g} s (v = {joints.v.tolist()} rad/s): lower the "
                "controller's gains or the trocar's stiffness and damping, raise substeps, or give the robot "
                "rotor inertia"
            )
        self._sense(*self._encoders.read(*joints.shown))

    def _sense(self, q: Array, v: Array) -> None:
        # MuJoCo measures the opposite wrench, of the mount on the tool.
        self._measurement = Measurement(q, v, read_only(self._wrench_noise.take() - self._held), self._ticks)

    def _load(self, elapsed_s: float) -> None:
        state = self.mj_data
        for body in self._pushes:
            state.xfrc_applied[body] = 0.0
        core.shaft_wrench(*self._shaft, self._trocar, elapsed_s, *self._touch, self._tool_wrench)
        for body, (force, point) in self._pushes.items():
            lever = state.xpos[body] + state.xmat[body].reshape(3, 3) @ point - state.xipos[body]
            state.xfrc_applied[body] += np.concatenate([force, np.cross(lever, force)])

    def _feel(self) -> Array:
        core.shaft_wrench(*self._shaft, self._trocar, self.settings.period_s, *self._touch, self._felt)
        return self._felt[:3]

    def write_truth(self, row: Array) -> None:
        """Write q, v, tip, wrist and trocar force into row (2 n + 9,)."""
        np.concatenate((self._joints.q, self._joints.v, self._tip, self._wrist, self._feel()), out=row)

    def measure(self) -> Measurement:
        """Return the measurement at the end of the last period."""
        return self._measurement

    def brake(self, damping_Nm_s_per_rad: float, friction_Nm: ArrayLike = 0.0) -> None:
        """Set the braking that is added to every joint's own damping and friction, until `reset`.

        Args:
            damping_Nm_s_per_rad: damping by the drives.
            friction_Nm: dry friction of the brakes, one number or one per joint (n,). With 0, a loaded arm sinks.

        Raises:
            PlantError: a friction is negative or not finite.
        """
        friction = np.broadcast_to(np.asarray(friction_Nm, dtype=np.float64), self.data.n)
        if not ((friction >= 0.0) & np.isfinite(friction)).all():
            raise PlantError(f"friction_Nm = {friction.tolist()}: give 0 or more")
        drives = self._joints.motors
        self.mj_model.dof_damping[drives] = self._drive_damping[drives] + damping_Nm_s_per_rad
        self.mj_model.dof_frictionloss[drives] = self._drive_friction[drives] + friction

    def push(self, body: str, force: ArrayLike, point: ArrayLike | None = None) -> None:
        """Apply a constant force to a link from the next period on. It replaces an earlier push on this link.

        Args:
            body: the link's name.
            force: (3,) force in world axes [N].
            point: (3,) point at which the force acts, in the link's frame [m]; None: centre of mass.

        Raises:
            UnknownNameError: no such link.
            PlantError: wrong shape or not finite.
        """
        number = self._number(body)
        where = self.mj_model.body_ipos[number].copy() if point is None else _finite("push point", point, (3,)).copy()
        self._pushes[number] = _finite("push force", force, (3,)).copy(), where

    def clear_pushes(self, body: str | None = None) -> None:
        """Remove the force on one link or on all links."""
        for number in list(self._pushes) if body is None else [self._number(body)]:
            self._pushes.pop(number, None)
            self.mj_data.xfrc_applied[number] = 0.0

    def _number(self, link: str) -> int:
        if link not in self._bodies:
            raise UnknownNameError("link", link, self._bodies)
        return self._bodies[link]

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self._ticks * self.settings.period_s

    q = _truth(lambda plant: plant._joints.q, "(n,) joint positions [rad].")
    v = _truth(lambda plant: plant._joints.v, "(n,) joint velocities [rad/s].")
    applied_torque = _truth(
        lambda plant: plant._joints.torque, "(n,) last torque of the drives, clipped to +-tau_max, without ripple [Nm]."
    )
    tip = _truth(lambda plant: plant._tip, "(3,) tip [m].")
    wrist = _truth(lambda plant: plant._wrist, "(3,) wrist centre [m].")
    trocar_force = _truth(lambda plant: plant._feel(), "(3,) force of the trocar on the shaft, world axes [N].")
