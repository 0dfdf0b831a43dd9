"""The compiled parts of a plant step, bound once to MuJoCo's memory: attributes of MjData cost more than arithmetic."""

from __future__ import annotations

from functools import partial

import mujoco
import numpy as np
from numba import float64, int64
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import PlantError
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import INDICES, MATRIX, VECTOR, CompiledKernel
from moc_opt.robots import RobotData
from moc_opt.sim.actuation import Drives
from moc_opt.sim.contact import Pushes, load_bodies, shaft_force
from moc_opt.sim.joints import Joints
from moc_opt.sim.mismatch import Mismatch
from moc_opt.sim.mjcf import FORCE_SENSOR, MOUNT_SITE, TOOL_BODY
from moc_opt.sim.settings import PlantSettings

Array = NDArray[np.float64]

_RUNAWAY_RAD_PER_S = 1e3


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


class Bindings:
    """Views on MuJoCo's arrays, and the kernels that are called with them at every substep.

    Attributes:
        joints, drives, pushes: the arm's joints, their drives, and external forces held on links.
        tip, wrist: (3,) true points [m].
        mount, wrench: (3, 3) orientation of the wrench sensor, and (6,) its reading.
        trocar: (2, 3) of the present period, point [m] and velocity [m/s].
        write_truth, load, is_sound, first_half, second_half: kernels and MuJoCo's two halves of a step.
    """

    def __init__(
        self, data: RobotData, settings: PlantSettings, mismatch: Mismatch, model: mujoco.MjModel, state: mujoco.MjData
    ) -> None:
        """Bind them; the arrays must stay MuJoCo's.

        Raises:
            PlantError: the URDF lacks a link of the tool.
        """
        bodies = {model.body(i).name: i for i in range(1, model.nbody)}
        frames = (TOOL_BODY, data.tip_frame, data.wrist_frame)
        missing = [name for name in frames if name not in bodies]
        if missing:
            raise PlantError(
                f"robot {data.name!r}: its URDF has no links {missing}: load it with "
                "moc_opt.robots.load_data, which adds them"
            )
        numbers = tool, tip, wrist = tuple(bodies[name] for name in frames)
        joints = self.joints = Joints(data, settings, mismatch, model, state)
        self.drives = Drives(data.tau_max, settings.delay_ticks, joints.torque)
        self.tip, self.wrist = state.xpos[tip], state.xpos[wrist]
        self._told, self.trocar = np.zeros((2, 3)), np.zeros((2, 3))
        origin, point = state.subtree_com[model.body_rootid[tool]], np.zeros(3)
        self.load = partial(
            _LOAD.code, state.xfrc_applied, state.xpos, state.xmat, state.xipos, state.cvel, origin, *numbers,
            self.trocar, np.zeros(3), point,
        )  # fmt: skip
        self.write_truth = partial(
            _WRITE.code, joints.q, joints.v, state.xpos, state.cvel, origin, *numbers, self.trocar, point
        )
        self._is_finite = partial(_FINITE.code, self._told)
        self.is_sound = partial(_SOUND.code, joints.q, joints.v, _RUNAWAY_RAD_PER_S)
        self.mount = state.site_xmat[model.site(MOUNT_SITE).id].reshape(3, 3)
        self.first_half = partial(mujoco.mj_step1, model, state)
        self.second_half = partial(mujoco.mj_step2, model, state)
        # MuJoCo's sensor shows what the mount exerts on the tool; ours, as real ones do, the reaction.
        first = model.sensor(FORCE_SENSOR).adr[0]
        self.wrench = state.sensordata[first : first + 6]
        self.pushes = Pushes(bodies, model.body_ipos)

    def checked_trocar(self, trocar: ArrayLike) -> Array | None:
        """Return the trocar (2, 3) as contiguous numbers; None where it has another shape or is not finite."""
        if (trocar.shape if isinstance(trocar, np.ndarray) else np.shape(trocar)) != (2, 3):
            return None
        self._told[:] = trocar
        return self._told if self._is_finite() else None
