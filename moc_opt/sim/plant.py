"""The simulated arm: torques in, measurements out, and the truth beside them for the trace."""

from __future__ import annotations

from functools import partial

import mujoco
import numpy as np
from numba import float64, int64, njit
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import PlantError
from moc_opt.numerics.compiled import INDICES, MATRIX, VECTOR, CompiledKernel
from moc_opt.robots import RobotData
from moc_opt.sim.actuation import Drives
from moc_opt.sim.contact import Pushes, load_bodies, shaft_force
from moc_opt.sim.elastic import add_springs, check_substeps
from moc_opt.sim.joints import Joints
from moc_opt.sim.mismatch import Mismatch
from moc_opt.sim.mjcf import FORCE_SENSOR, MOUNT_SITE, TOOL_BODY, build_spec, compile_model, heavy_links
from moc_opt.sim.sensors import Encoders, Measurement, WrenchSensor
from moc_opt.sim.settings import PlantSettings

Array = NDArray[np.float64]

_RUNAWAY_RAD_PER_S = 1e3

if mujoco.get_mju_user_warning() is None:
    # MuJoCo's own writes a log file into whatever folder is the current one; the plant sees for itself that an arm
    # runs away, and raises.
    mujoco.set_mju_user_warning(lambda message: None)


@njit(cache=True)
def _finite(trocar: Array) -> bool:
    for i in range(2):  # numba compiles no generators
        for j in range(3):
            if not np.isfinite(trocar[i, j]):
                return False
    return True


@njit(cache=True)
def _sound(q: Array, v: Array, runaway: float) -> bool:
    for i in range(q.size):  # numba compiles no generators
        if not (np.isfinite(q[i]) and abs(v[i]) < runaway):
            return False
    return True


@njit(cache=True)
def _write_truth(
    q: Array,
    v: Array,
    xpos: Array,
    cvel: Array,
    origin: Array,
    tool: int,
    tip: int,
    wrist: int,
    trocar: Array,
    point: Array,
    elapsed: float,
    stiffness: float,
    damping: float,
    row: Array,
) -> None:
    n = q.size
    row[:n], row[n : 2 * n] = q, v
    row[2 * n : 2 * n + 3], row[2 * n + 3 : 2 * n + 6] = xpos[tip], xpos[wrist]
    force = row[2 * n + 6 :]
    force[:] = 0.0
    if stiffness > 0.0 or damping > 0.0:
        shaft_force(
            xpos[tip], xpos[wrist], cvel[tool], origin, trocar, elapsed, stiffness, damping, force, point
        )


# The kernels of one period, without a look at the types of their arguments: all are made in this file.
_FINITE = CompiledKernel(_finite, MATRIX)
_SOUND = CompiledKernel(_sound, VECTOR, VECTOR, float64)
_WRITE = CompiledKernel(
    _write_truth, VECTOR, VECTOR, MATRIX, MATRIX, VECTOR, int64, int64, int64, MATRIX, VECTOR,
    float64, float64, float64, VECTOR,
)  # fmt: skip
_LOAD = CompiledKernel(
    load_bodies, *[MATRIX] * 5, VECTOR, int64, int64, int64, MATRIX, VECTOR, VECTOR,
    float64, float64, float64, INDICES, MATRIX,
)  # fmt: skip


class Plant:
    """An arm in MuJoCo with its trocar, its sensors and its delay, advanced one control period at a time.

    What a run gives depends on (data, settings, seed), the start and the torques alone, to the bit: `reset`
    takes the noise back to its beginning. Plants share nothing, so each thread can have its own. The drives
    have no dynamics; they cut torques at `data.tau_max`.

    Attributes: `data`, `settings`, `mismatch`, and MuJoCo's `mj_model` and `mj_data`, to draw the scene and
        to check the plant; writing to these two breaks the promises above.
    """

    def __init__(self, data: RobotData, settings: PlantSettings | None = None, seed: int = 0) -> None:
        """Build the arm and put it at rest at `data.q_home`.

        Args:
            data: the robot, as the controller knows it.
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
            data,
            substep_s=settings.substep_s,
            gravity=settings.gravity,
            mass_scale=self.mismatch.mass_scale,
            viscous=self.mismatch.viscous_friction,
            coulomb=self.mismatch.coulomb_friction,
            origin_shift=self.mismatch.origin_shift,
            origin_turn=self.mismatch.origin_turn,
        )
        if settings.elastic:
            add_springs(data, spec, settings)
        self.mj_model = compile_model(data.name, spec)
        self.mj_data = mujoco.MjData(self.mj_model)
        self._drive_damping = np.array(self.mj_model.dof_damping)
        self._drive_friction = np.array(self.mj_model.dof_frictionloss)
        self._substeps = tuple(i * settings.substep_s for i in range(settings.substeps))
        self._tissue = settings.trocar_stiffness_N_per_m, settings.trocar_damping_Ns_per_m
        self._bind()
        self.reset(data.q_home)
        if settings.elastic:
            check_substeps(self.mj_model, self.mj_data, settings)

    def _bind(self) -> None:
        """Views on MuJoCo's memory, taken once: an attribute of MjData costs more than arithmetic on it.

        The kernels are bound to them here too: all of it is contiguous float64.
        """
        model, state = self.mj_model, self.mj_data
        bodies = {model.body(i).name: i for i in range(1, model.nbody)}
        frames = (TOOL_BODY, self.data.tip_frame, self.data.wrist_frame)
        missing = [name for name in frames if name not in bodies]
        if missing:
            raise PlantError(
                f"robot {self.data.name!r}: its URDF has no links {missing}: load it with "
                "moc_opt.robots.load_data, which adds them"
            )
        numbers = self._tool, self._tip, self._wrist = tuple(bodies[name] for name in frames)
        joints = self._joints = Joints(self.data, self.settings, self.mismatch, model, state)
        self._q, self._v, self._shown = joints.q, joints.v, joints.shown
        self._act, self._gather = joints.act, joints.gather
        self._drives = Drives(self.data.tau_max, self.settings.delay_ticks, joints.torque)
        self._xpos, self._told, self._trocar = state.xpos, np.zeros((2, 3)), np.zeros((2, 3))
        origin, point = state.subtree_com[model.body_rootid[self._tool]], np.zeros(3)
        self._load = partial(
            _LOAD.code, state.xfrc_applied, state.xpos, state.xmat, state.xipos, state.cvel, origin, *numbers,
            self._trocar, np.zeros(3), point,
        )  # fmt: skip
        self._is_finite = partial(_FINITE.code, self._told)
        self._write = partial(
            _WRITE.code, self._q, self._v, state.xpos, state.cvel, origin, *numbers, self._trocar, point
        )
        self._is_sound = partial(_SOUND.code, self._q, self._v, _RUNAWAY_RAD_PER_S)
        self._mount = state.site_xmat[model.site(MOUNT_SITE).id].reshape(3, 3)
        self._first_half = partial(mujoco.mj_step1, model, state)
        self._second_half = partial(mujoco.mj_step2, model, state)
        # MuJoCo's sensor shows what the mount exerts on the tool; ours, as real ones do, the reaction.
        first = model.sensor(FORCE_SENSOR).adr[0]
        self._wrench = state.sensordata[first : first + 6]
        self._pushes = Pushes(bodies, model.body_ipos)

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
        encoders, force = (np.random.default_rng(seed) for seed in self._noise_seeds)
        self._encoders = Encoders.of(self.settings, self.mismatch.encoder_bias, encoders)
        self._wrench_sensor = WrenchSensor.of(self.settings, force)
        self._pushes.clear()
        self.mj_model.dof_damping[:] = self._drive_damping
        self.mj_model.dof_frictionloss[:] = self._drive_friction
        self._ticks, self._stiffness, self._damping = 0, 0.0, 0.0
        mujoco.mj_resetData(self.mj_model, self.mj_data)
        self._joints.place(start - self.mismatch.encoder_bias)
        self._drives.start(self._joints.bias)
        self._joints.start(speed)
        q, v = self._encoders.start(*self._shown)
        self._measurement = Measurement(q, v, self._wrench_sensor.read(self._wrench), self._ticks)

    def step(self, tau: ArrayLike, trocar: ArrayLike | None = None) -> None:
        """Advance one control period.

        Args:
            tau: (n,) commanded joint torques [Nm]; they act `delay_ticks` periods later, cut at tau_max.
            trocar: (2, 3) rows: trocar point [m] and its velocity [m/s], which it keeps for the period; None:
                no trocar in this period.

        Raises:
            PlantError: wrong shape or not finite (nothing has moved then), or the arm ran away.
        """
        if trocar is not None and not self._listen(trocar):
            raise PlantError(
                f"trocar = {np.asarray(trocar).tolist()!r:.200}: give (2, 3) finite numbers, point [m] over "
                "velocity [m/s], or None for no trocar; the arm has not moved"
            )
        if not self._is_sound():
            raise PlantError(f"the arm ran away before t = {self.time:.4g} s: call reset first")
        self._drives.command(tau)
        self._stiffness, self._damping = (0.0, 0.0) if trocar is None else self._tissue
        if trocar is not None:
            self._trocar[:] = self._told
        # mj_step's two halves the other way round: after the last one, the kinematics belong to the new
        # state, so that measurements and truths need no further call.
        pushes, act = self._pushes, self._act
        for elapsed in self._substeps:
            if act is not None:
                act()
            self._load(elapsed, self._stiffness, self._damping, pushes.bodies, pushes.rows)
            self._second_half()
            self._first_half()
        self._ticks += 1
        if self._gather is not None:
            self._gather()
        if not self._is_sound():
            raise PlantError(
                f"the arm ran away before t = {self.time:.4g} s (v = {self._v.tolist()} rad/s): lower the "
                "controller's gains or the trocar's stiffness and damping, raise substeps, or give the robot "
                "rotor inertia"
            )
        q, v = self._encoders.read(*self._shown)
        self._measurement = Measurement(q, v, self._wrench_sensor.read(self._wrench), self._ticks)

    def _listen(self, trocar: ArrayLike) -> bool:
        """Take in what the caller says of the trocar; False where that is nonsense."""
        if (trocar.shape if isinstance(trocar, np.ndarray) else np.shape(trocar)) != (2, 3):
            return False
        self._told[:] = trocar
        return bool(self._is_finite())

    def write_truth(self, row: Array) -> None:
        """Write q, v, tip, wrist and the trocar's force of now into row (2 n + 9,): all truths in one call."""
        self._write(self.settings.period_s, self._stiffness, self._damping, row)

    def measure(self) -> Measurement:
        """What the sensors showed at the end of the last period; asking twice gives the same."""
        return self._measurement

    def brake(self, damping_Nm_s_per_rad: float, friction_Nm: ArrayLike = 0.0) -> None:
        """Close the brakes: more damping and dry friction in every joint, whatever is commanded, until reset.

        Both act on the true motion, as a real arm's brakes do: no sensor is needed. Damping alone holds nothing: under
        a load that the torque does not carry the arm sinks.

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
        drives = self._joints.motors  # brakes sit there
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
        self._pushes.hold(body, force, point)

    def clear_pushes(self, body: str | None = None) -> None:
        """Let go of one link, or of all."""
        self._pushes.clear(body)

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self._ticks * self.settings.period_s

    @property
    def q(self) -> Array:
        """(n,) true joint positions [rad]; a read-only copy, as all that follow."""
        return _readonly(self._q)

    @property
    def v(self) -> Array:
        """(n,) true joint velocities [rad/s]."""
        return _readonly(self._v)

    @property
    def applied_torque(self) -> Array:
        """(n,) torque of the drives in the last period, delayed and saturated, without ripple [Nm]."""
        return _readonly(self._joints.torque)

    @property
    def tip(self) -> Array:
        """(3,) true tip [m]."""
        return _readonly(self._xpos[self._tip])

    @property
    def wrist(self) -> Array:
        """(3,) true wrist centre [m]."""
        return _readonly(self._xpos[self._wrist])

    @property
    def mount_rotation(self) -> Array:
        """(3, 3) true orientation of the force/torque sensor, world from sensor."""
        return _readonly(self._mount)

    @property
    def trocar_force(self) -> Array:
        """(3,) force of the trocar on the shaft now, world axes [N]; 0 without one in the last period."""
        row = np.empty(2 * self.data.n + 9)
        self.write_truth(row)
        return _readonly(row[-3:])

    def _vector(self, name: str, value: ArrayLike) -> Array:
        array = np.asarray(value, dtype=np.float64)
        if array.shape != (self.data.n,) or not np.isfinite(array).all():
            raise PlantError(f"{name} = {array.tolist()!r:.200}: give {self.data.n} finite numbers")
        return array


def _readonly(array: Array) -> Array:
    copy = array.copy()
    copy.flags.writeable = False
    return copy
