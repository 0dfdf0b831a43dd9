"""MuJoCo's model of a robot without defects, sensors or contact, for comparison with another engine."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from moc_opt.arrays import Array
from moc_opt.robots import RobotData
from moc_opt.sim.mjcf import build_spec, compile_model


class Terms(NamedTuple):
    """Of the arm at one position and velocity."""

    M: Array  #: (n,n) inertia, rotor inertia included [kg m^2]
    h: Array  #: (n,) Coriolis, centrifugal and gravity torque [Nm]
    tip: Array  #: (3,) [m]
    wrist: Array  #: (3,) [m]


def reference_terms(data: RobotData, q: Array, v: Array) -> list[Terms]:
    """Compute inertia, bias forces and tool points of the very URDF text that the plant is built from.

    Args:
        data: the robot.
        q, v: (k,n) positions [rad] and velocities [rad/s].

    Raises:
        PlantError: MuJoCo cannot take the robot.
    """
    model = compile_model(data.name, build_spec(data, substep_s=0.001))
    state, found = mujoco.MjData(model), []
    tip, wrist = (model.body(name).id for name in (data.tip_frame, data.wrist_frame))
    for position, velocity in zip(q, v, strict=True):
        state.qpos[:], state.qvel[:] = position, velocity
        mujoco.mj_fwdPosition(model, state)
        mujoco.mj_fwdVelocity(model, state)
        M = np.zeros((data.n, data.n))
        mujoco.mj_fullM(model, state, M)
        found.append(Terms(M, state.qfrc_bias.copy(), state.xpos[tip].copy(), state.xpos[wrist].copy()))
    return found
