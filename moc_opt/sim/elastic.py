"""Elastic joints: a motor, a spring, a link; and the torque that reaches the motor, ripple included.

A joint with a spring has two coordinates in MuJoCo, two hinges about one axis: the motor's angle theta with the rotor's
inertia B, friction and stops, and the spring's deflection delta. The link's angle is q = theta + delta, and

    M(q) ddq + h = tau_J,   B ddtheta + friction + tau_J = tau,   tau_J = -K delta - D ddelta/dt

which is Spong's model (1987). The rotor inertia of the robot's file is the one that the arm's own torque feedback
has reduced (Ott et al. 2008): tau is the input of that loop, so no second loop is simulated.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from moc_opt.errors import PlantError
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit
from moc_opt.robots import RobotData
from moc_opt.sim.settings import PlantSettings

_MOST_RAD_A_STEP = 1.0
"""Phase of the fastest oscillation in one plant step: explicit springs of MuJoCo are stable below 2."""


def add_springs(data: RobotData, spec: mujoco.MjSpec, settings: PlantSettings) -> None:
    """Put a spring behind every joint of a spec that `build_spec` made.

    Raises:
        PlantError: the number of stiffnesses is not that of the joints.
    """
    stiffness = stiffnesses(data, settings)
    for joint, value in zip(list(spec.joints), stiffness, strict=True):
        spring = joint.parent.add_joint(name=f"{joint.name}_spring", type=joint.type, axis=joint.axis, pos=joint.pos)
        spring.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        spring.stiffness[0] = value
        spring.damping[0] = settings.joint_spring_damping_Nm_s_per_rad


def stiffnesses(data: RobotData, settings: PlantSettings) -> Array:
    """Return the joints' stiffnesses (n,) [Nm/rad]; all 0 where they are rigid.

    Raises:
        PlantError: their number is not that of the joints.
    """
    given = np.atleast_1d(np.asarray(settings.joint_stiffness_Nm_per_rad, dtype=np.float64))
    if given.size not in (1, data.n):
        raise PlantError(
            f"joint_stiffness_Nm_per_rad has {given.size} entries: robot {data.name!r} has {data.n} joints, "
            f"give {data.n}, or one number for all"
        )
    return np.broadcast_to(given, data.n).copy()


def check_substeps(model: mujoco.MjModel, state: mujoco.MjData, settings: PlantSettings) -> None:
    """Check that the plant step is fine enough for the springs, at the present pose.

    Raises:
        PlantError: it is too coarse; the message says how many substeps are needed.
    """
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, state, inertia)
    spring = np.arange(1, model.nv, 2)
    compliance = np.linalg.inv(inertia)[np.ix_(spring, spring)]
    root = np.sqrt(model.jnt_stiffness[spring, 0] if model.jnt_stiffness.ndim == 2 else model.jnt_stiffness[spring])
    fastest = math.sqrt(float(np.linalg.eigvalsh(root[:, None] * compliance * root)[-1]))
    if fastest * settings.substep_s > _MOST_RAD_A_STEP:
        need = math.ceil(settings.period_s * fastest / _MOST_RAD_A_STEP)
        raise PlantError(
            f"substeps = {settings.substeps} makes plant steps of {1e3 * settings.substep_s:g} ms, and the joints' "
            f"springs swing at up to {fastest:.0f} rad/s: raise substeps to {need}, or lower "
            "joint_stiffness_Nm_per_rad"
        )


@njit(cache=True, nogil=True)
def drive(tau: Array, angle: Array, stride: int, ripple: Array, out: Array) -> None:
    """Put the drives' torque (n,) and its ripple [Nm] on the motors; a joint has ``stride`` coordinates.

    ``ripple`` (3, n): rows amplitude [Nm], waves per radian, phase [rad].
    """
    for i in range(tau.size):
        j = stride * i
        out[j] = tau[i] + ripple[0, i] * math.sin(ripple[1, i] * angle[j] + ripple[2, i])


@njit(cache=True, nogil=True)
def gather(pairs: Array, rates: Array, q: Array, v: Array, theta: Array, omega: Array) -> None:
    """Take positions [rad] and velocities [rad/s] (n,) of links and motors from MuJoCo's pairs."""
    for i in range(q.size):
        theta[i], omega[i] = pairs[2 * i], rates[2 * i]
        q[i], v[i] = pairs[2 * i] + pairs[2 * i + 1], rates[2 * i] + rates[2 * i + 1]
