"""The simulated arm: torques in, measurements out, and the truth beside them for the trace."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple, NoReturn

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from moc_opt.errors import PlantError
from moc_opt.numerics.arrays import Array, read_only_copy
from moc_opt.robots import RobotData
from moc_opt.sim.bindings import Bindings
from moc_opt.sim.elastic import add_springs, check_substeps
from moc_opt.sim.mismatch import Mismatch
from moc_opt.sim.mjcf import build_spec, compile_model, heavy_links
from moc_opt.sim.period import ADVANCE, AWAY, DONE, NO_TORQUE, NO_TROCAR, Indices
from moc_opt.sim.sensors import Encoders, Measurement, WrenchSensor
from moc_opt.sim.settings import PlantSettings

if mujoco.get_mju_user_warning() is None:
    # MuJoCo's own handler writes a log file into the current folder; the plant itself detects an arm that runs away,
    # and raises an error.
    mujoco.set_mju_user_warning(lambda message: None)


class Ahead(NamedTuple):
    """What compiled steps need beside the plant's memory; as for ``period.advance``."""

    slot: int
    turns: int
    """slots of the drives' queue"""
    tissue: Array
    pushed: Indices
    pushes: Array
    noise: Array
    """(k, n) of the next periods, as many as are drawn"""
    wrench_noise: Array


class Plant:
    """An arm in MuJoCo with its trocar, its sensors and its delay, advanced one control period at a time.

    The results of a run depend only on (data, settings, seed), the start and the torques, to the last bit: `reset`
    restarts the noise. Plants share no state, so each thread can have its own. The drives
    have no dynamics; they cut torques at `data.tau_max`.

    Attributes: `data`, `settings`, `mismatch`, and MuJoCo's `mj_model` and `mj_data`, to draw the scene and
        to check the plant; writing to these two breaks the promises above.
    """

    def __init__(self, data: RobotData, settings: PlantSettings | None = None, seed: int = 0) -> None:
        """Build the arm and put it at rest at `data.q_home`.

        Args:
            data: the robot, as in the controller's model.
            settings: how the plant differs from it; None is `PlantSettings.realistic()`.
            seed: of the mismatch and of the noise, 0 or more.

        Raises:
            PlantError: MuJoCo cannot take the robot, or its URDF lacks a frame.
        """
        self.data = data
        self.settings = settings = PlantSettings.realistic() if settings is None else settings
        # One stream for each purpose: switching one thing off leaves the others' numbers as they are.
        mismatch, *self._noise_seeds = np.random.SeedSequence(seed).spawn(3)
        links = heavy_links(build_spec(data, substep_s=settings.substep_s))
        self.mismatch = Mismatch.draw(data, settings, links, mismatch)
        spec = build_spec(
            data, substep_s=settings.substep_s, gravity=settings.gravity, mass_scale=self.mismatch.mass_scale,
            viscous=self.mismatch.viscous_friction, coulomb=self.mismatch.coulomb_friction,
            origin_shift=self.mismatch.origin_shift, origin_turn=self.mismatch.origin_turn,
        )  # fmt: skip
        if settings.elastic:
            add_springs(data, spec, settings)
        self.mj_model = compile_model(data.name, spec)
        self.mj_data = mujoco.MjData(self.mj_model)
        self._drive_damping = np.array(self.mj_model.dof_damping)
        self._drive_friction = np.array(self.mj_model.dof_frictionloss)
        self._shown = 2 * data.n + 6
        self._tissue = settings.trocar_stiffness_N_per_m, settings.trocar_damping_Ns_per_m
        self._at = Bindings(data, settings, self.mismatch, self.mj_model, self.mj_data)
        self.reset(data.q_home)
        if settings.elastic:
            check_substeps(self.mj_model, self.mj_data, settings)

    def reset(self, q: ArrayLike, v: ArrayLike | None = None) -> None:
        """Start anew at time 0: no pushes, and the delay full of the torque that holds the arm still at q.

        The arm is placed by its own encoders: it stands at q less their bias.

        Args:
            q: (n,) joint positions within their limits, as the encoders show them but for noise [rad].
            v: (n,) joint velocities [rad/s]; None is rest.

        Raises:
            PlantError: wrong shape, not finite, or q outside the limits; nothing has changed then.
        """
        start = self._vector("q", q)
        speed = self._vector("v", np.zeros(self.data.n) if v is None else v)
        outside = np.flatnonzero((start < self.data.q_min - 1e-9) | (start > self.data.q_max + 1e-9))
        if outside.size:
            i = int(outside[0])
            raise PlantError(
                f"q[{i}] = {start[i]:.6g} rad is outside the limits of {self.data.joint_names[i]!r}: "
                f"choose {self.data.q_min[i]:.6g} to {self.data.q_max[i]:.6g}"
            )
        shown, felt = (np.random.default_rng(seed) for seed in self._noise_seeds)
        encoders = Encoders.of(self.settings, self.mismatch.encoder_bias, shown)
        sensor = WrenchSensor.of(self.settings, felt)
        self._encoder_noise, self._wrench_noise = encoders.noise, sensor.noise
        self._at.pushes.clear()
        self.mj_model.dof_damping[:] = self._drive_damping
        self.mj_model.dof_frictionloss[:] = self._drive_friction
        self._ticks, self._inserted, self._at.tissue[:] = 0, False, 0.0
        mujoco.mj_resetData(self.mj_model, self.mj_data)
        self._at.joints.place(start - self.mismatch.encoder_bias)
        self._at.drives.start(self._at.joints.bias)
        self._at.joints.start(speed)
        self._at.tell()
        self.memory = self._at.memory(encoders)
        self._advance = partial(ADVANCE.code, self.memory)
        q, v = encoders.start(*self._at.joints.shown)
        self._measurement = Measurement(q, v, sensor.read(self._at.wrench), self._ticks)

    def step(self, tau: ArrayLike, trocar: ArrayLike | None = None, found: int | None = None) -> None:
        """Advance one control period.

        Args:
            tau: (n,) commanded joint torques [Nm]; they act `delay_ticks` periods later, cut at tau_max.
            trocar: (2, 3) rows: trocar point [m] and its velocity [m/s], which it keeps for the period; None:
                no trocar in this period.
            found: by ``period.advance``, which compiled steps called for this period already; not ``DONE``.

        Raises:
            PlantError: wrong shape or not finite (nothing has moved then), or the arm ran away.
        """
        at = self._at
        told, asked = at.told(trocar), at.drives.command(tau)
        self._insert(trocar is not None)
        reading = np.empty(self._shown)
        if found is None:
            found = self._advance(
                asked, at.drives.slot, told, at.tissue, at.pushes.bodies, at.pushes.rows,
                self._encoder_noise.row, self._wrench_noise.row, reading,
            )  # fmt: skip
        if found != DONE:
            self._refuse(found, trocar)
        self.took(1, reading)

    def _insert(self, inserted: bool) -> None:
        if self._inserted is not inserted:
            self._inserted = inserted
            self._at.tissue[:] = self._tissue if inserted else 0.0

    def ahead(self) -> Ahead:
        """Return what the next periods find, all of them with a trocar."""
        self._insert(True)
        at = self._at
        return Ahead(
            at.drives.slot, at.drives.turns, at.tissue, at.pushes.bodies, at.pushes.rows, self._encoder_noise.ahead,
            self._wrench_noise.ahead,
        )  # fmt: skip

    def took(self, periods: int, reading: Array) -> None:
        """Note periods that ``period.advance`` is through, and what the sensors show (2 n + 6,) after them."""
        if periods == 0:
            return
        self._at.drives.admitted(periods)
        self._encoder_noise.take(periods)
        self._wrench_noise.take(periods)
        self._ticks += periods
        reading.setflags(write=False)
        n = self.data.n
        self._measurement = Measurement(reading[:n], reading[n : 2 * n], reading[2 * n :], self._ticks)

    def _refuse(self, found: int, trocar: ArrayLike | None) -> NoReturn:
        if found == NO_TROCAR:
            raise self._at.refusal(trocar)
        if found == NO_TORQUE:
            raise self._at.drives.refusal()
        if found == AWAY:
            raise PlantError(f"the arm ran away before t = {self.time:.4g} s: call reset first")
        self._ticks += 1
        raise PlantError(
            f"the arm ran away before t = {self.time:.4g} s (v = {self._at.joints.v.tolist()} rad/s): lower the "
            "controller's gains or the trocar's stiffness and damping, raise substeps, or give the robot "
            "rotor inertia"
        )

    def write_truth(self, row: Array) -> None:
        """Write q, v, tip, wrist and the trocar's force of now into row (2 n + 9,): all truths in one call."""
        row[:] = self._at.truth

    def measure(self) -> Measurement:
        """Return what the sensors showed at the end of the last period; asking twice gives the same."""
        return self._measurement

    def brake(self, damping_Nm_s_per_rad: float, friction_Nm: ArrayLike = 0.0) -> None:
        """Close the brakes until reset: more damping and dry friction in every joint, under any command.

        Both act on the true motion, as a real arm's brakes do: no sensor is needed. With damping alone the arm sinks
        under a load that the torque does not carry.

        Args:
            damping_Nm_s_per_rad: of the drives, short-circuited.
            friction_Nm: of the holding brakes, one number or one a joint (n,).

        Raises:
            PlantError: the damping is not a positive number, or a friction not 0 or more.
        """
        if not 0.0 < damping_Nm_s_per_rad < np.inf:
            raise PlantError(f"damping_Nm_s_per_rad = {damping_Nm_s_per_rad!r}: give a positive number")
        friction = np.broadcast_to(np.asarray(friction_Nm, dtype=np.float64), self.data.n)
        if not ((friction >= 0.0) & np.isfinite(friction)).all():
            raise PlantError(f"friction_Nm = {friction.tolist()}: give 0 or more")
        drives = self._at.joints.motors  # brakes sit there
        self.mj_model.dof_damping[drives] = self._drive_damping[drives] + damping_Nm_s_per_rad
        self.mj_model.dof_frictionloss[drives] = self._drive_friction[drives] + friction

    def push(self, body: str, force: ArrayLike, point: ArrayLike | None = None) -> None:
        """Hold an external force on a link from the next period on, until it is cleared, replaced or reset.

        Args:
            body: the link's name.
            force: (3,) world axes [N].
            point: (3,) where it acts, in the link's own frame [m], moving along; None: centre of mass.

        Raises:
            UnknownNameError: no such link.
            PlantError: wrong shape or not finite.
        """
        self._at.pushes.hold(body, force, point)

    def clear_pushes(self, body: str | None = None) -> None:
        """Remove the force on one link, or on all."""
        self._at.pushes.clear(body)

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self._ticks * self.settings.period_s

    @property
    def q(self) -> Array:
        """(n,) true joint positions [rad]; a read-only copy, as all that follow."""
        return read_only_copy(self._at.joints.q)

    @property
    def v(self) -> Array:
        """(n,) true joint velocities [rad/s]."""
        return read_only_copy(self._at.joints.v)

    @property
    def applied_torque(self) -> Array:
        """(n,) torque of the drives in the last period, delayed and saturated, without ripple [Nm]."""
        return read_only_copy(self._at.joints.torque)

    @property
    def tip(self) -> Array:
        """(3,) true tip [m]."""
        return read_only_copy(self._at.tip)

    @property
    def wrist(self) -> Array:
        """(3,) true wrist centre [m]."""
        return read_only_copy(self._at.wrist)

    @property
    def mount_rotation(self) -> Array:
        """(3, 3) true orientation of the force/torque sensor, world from sensor."""
        return read_only_copy(self._at.mount)

    @property
    def trocar_force(self) -> Array:
        """(3,) force of the trocar on the shaft now, world axes [N]; 0 without one in the last period."""
        return read_only_copy(self._at.truth[-3:])

    def _vector(self, name: str, value: ArrayLike) -> Array:
        array = np.asarray(value, dtype=np.float64)
        if array.shape != (self.data.n,) or not np.isfinite(array).all():
            raise PlantError(f"{name} = {array.tolist()!r:.200}: give {self.data.n} finite numbers")
        return array
