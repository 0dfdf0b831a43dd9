"""One control period of the plant as one kernel: from a commanded torque to the sensors' readings.

MuJoCo's two halves of a step are called at their addresses in its library: through its Python binding each call costs
as much as all of the plant's own arithmetic. An error inside MuJoCo's C code, which its binding would raise as
``FatalError``, ends the process; it has none for a compiled arm without contacts, whose memory is set aside beforehand.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import PlantError
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.numerics.compiled import INDICES, INTEGER, MATRIX, VECTOR, CompiledKernel, borrowed, call, named
from moc_opt.sim.actuation import admit
from moc_opt.sim.contact import load_bodies, shaft_force
from moc_opt.sim.elastic import drive, gather
from moc_opt.sim.sensors import sample

Indices = NDArray[np.int64]

DONE, NO_TROCAR, AWAY, NO_TORQUE, RAN_AWAY = range(5)
"""Results of a period; in the three after ``DONE`` the arm has not moved."""
_RUNAWAY_RAD_PER_S = 1e3


def addresses(model: mujoco.MjModel, state: mujoco.MjData) -> Indices:
    """Return the addresses (4,) of MuJoCo's ``mj_step1``, ``mj_step2``, the model and its state.

    Raises:
        PlantError: MuJoCo's package is not laid out as a wheel of it.
    """
    folder = Path(mujoco.__file__).parent
    files = [file for file in folder.glob("*mujoco.*") if {".so", ".dylib", ".dll"} & set(file.suffixes)]
    if len(files) != 1:
        raise PlantError(f"MuJoCo's library: {len(files)} files in {str(folder)!r}: install MuJoCo from its wheel")
    library = ctypes.CDLL(str(files[0]))
    steps = [ctypes.cast(half, ctypes.c_void_p).value for half in (library.mj_step1, library.mj_step2)]
    return np.array([*steps, model._address, state._address], dtype=np.int64)


@njit(cache=True, nogil=True)
def _sound(q: Array, v: Array) -> bool:
    for i in range(q.size):  # numba compiles no generators
        if not (np.isfinite(q[i]) and abs(v[i]) < _RUNAWAY_RAD_PER_S):
            return False
    return True


@njit(cache=True, nogil=True)
def write_truth(
    q: Array, v: Array, xpos: Array, cvel: Array, origin: Array, numbers: Indices, trocar: Array, tissue: Array,
    point: Array, elapsed: float, truth: Array,
) -> None:  # fmt: skip
    """Write q, v, tip, wrist and the trocar's force into truth (2 n + 9,); other arguments as in `PlantMemory`."""
    n, tip, wrist = q.size, numbers[1], numbers[2]
    truth[:n], truth[n : 2 * n] = q, v
    truth[2 * n : 2 * n + 3], truth[2 * n + 3 : 2 * n + 6] = xpos[tip], xpos[wrist]
    force = truth[2 * n + 6 :]
    force[:] = 0.0
    if tissue[0] > 0.0 or tissue[1] > 0.0:
        shaft_force(xpos[tip], xpos[wrist], cvel[tip], origin, trocar, elapsed, tissue[0], tissue[1], force, point)


class PlantMemory(NamedTuple):
    """What a period of a plant works on, from one reset to the next; MuJoCo's own arrays among it."""

    calls: Indices
    """(4,) as from `addresses`"""
    numbers: Indices
    """(7,) bodies of tool, tip and wrist; coordinates of a joint; whether ``torque`` is ``applied`` itself; whether the
    encoders are on the links; plant steps of a period"""
    times: Array
    """(2,) plant step and control period [s]"""
    trocar: Array
    """(2, 3) written: point [m] and velocity [m/s] of this period"""
    force: Array
    """as for ``load_bodies``, and so all up to ``wrenches``"""
    point: Array
    xpos: Array
    xmat: Array
    xipos: Array
    cvel: Array
    origin: Array
    wrenches: Array
    qpos: Array
    """MuJoCo's coordinates, and so qvel"""
    qvel: Array
    q: Array
    """(n,) positions [rad] and velocities [rad/s] of links and motors, MuJoCo's own where a joint has one coordinate;
    and so v, theta, omega"""
    v: Array
    theta: Array
    omega: Array
    torque: Array
    """(n,) of the drives [Nm]"""
    applied: Array
    """MuJoCo's own"""
    ripple: Array
    """(3, n) amplitude [Nm], waves per turn, phase [rad]"""
    limit: Array
    """as for ``admit``, and so queue"""
    queue: Array
    encoders: Array
    """as for ``sample``, and so conversion"""
    conversion: Array
    held: Array
    """(6,) what the mount exerts on the tool, force [N] and torque [Nm]"""
    truth: Array
    """written, as by ``write_truth``"""


@njit(cache=True, nogil=True)
def advance(
    at: PlantMemory, tau: Array, slot: int, told: Array, tissue: Array, pushed: Indices, pushes: Array, noise: Array,
    wrench_noise: Array, reading: Array,
) -> int:  # fmt: skip
    """Advance the arm by one control period, and read its sensors; return the result, ``DONE`` or another.

    Args:
        at: changed in place.
        tau: (n,) commanded torque [Nm]; slot: its place in the queue.
        told: (2, 3) the trocar of this period; not used if tissue (2,), stiffness [N/m] and damping [N s/m], is
            zero.
        pushed, pushes: as for ``load_bodies``.
        noise, wrench_noise: (n,) [rad], (6,) [N, Nm].
        reading: (2 n + 6,) written: positions, velocities, wrench of the tool on its mount.
    """
    at, reading = borrowed(at), borrowed(reading)
    q, v, theta, omega, numbers = at.q, at.v, at.theta, at.omega, at.numbers
    n, stride = q.size, numbers[3]
    for i in range(2):
        for j in range(3):
            if not np.isfinite(told[i, j]):
                return NO_TROCAR
    if not _sound(q, v):
        return AWAY
    if not admit(tau, at.limit, at.queue, slot, at.torque):
        return NO_TORQUE
    at.trocar[:] = told
    # mj_step's two halves the other way round: after the last one, the kinematics belong to the new state, so that
    # measurements and truths need no further call.
    for k in range(numbers[6]):
        if numbers[4] == 0:
            drive(at.torque, at.qpos, stride, at.ripple, at.applied)
        load_bodies(
            at.wrenches, at.xpos, at.xmat, at.xipos, at.cvel, at.origin, numbers[0], numbers[1], numbers[2], at.trocar,
            at.force, at.point, k * at.times[0], tissue[0], tissue[1], pushed, pushes,
        )  # fmt: skip
        call(at.calls[1], at.calls[2], at.calls[3])
        call(at.calls[0], at.calls[2], at.calls[3])
    if stride != 1:
        gather(at.qpos, at.qvel, q, v, theta, omega)
    write_truth(q, v, at.xpos, at.cvel, at.origin, numbers, at.trocar, tissue, at.point, at.times[1], at.truth)
    if not _sound(q, v):
        return RAN_AWAY
    on_links = numbers[5] != 0
    sample(
        q if on_links else theta, v if on_links else omega, noise, at.encoders, at.conversion, reading[: 2 * n]
    )  # fmt: skip
    for i in range(6):
        reading[2 * n + i] = wrench_noise[i] - at.held[i]
    return DONE


MEMORY = named(
    PlantMemory, INDICES, INDICES, VECTOR, MATRIX, VECTOR, VECTOR, *[MATRIX] * 4, VECTOR, MATRIX, *[VECTOR] * 8,
    MATRIX, VECTOR, MATRIX, MATRIX, VECTOR, VECTOR, VECTOR,
)  # fmt: skip
ADVANCE = CompiledKernel(
    advance, MEMORY, VECTOR, INTEGER, MATRIX, VECTOR, INDICES, MATRIX, VECTOR, VECTOR, VECTOR
)  # fmt: skip
"""`advance` for the plant."""
