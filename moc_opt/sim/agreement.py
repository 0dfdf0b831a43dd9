"""Whether the controller's model and the plant's, two engines that read one URDF, have read the same arm."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import RobotError
from moc_opt.robots import RobotData
from moc_opt.sim.mjcf import build_spec, compile_model

if TYPE_CHECKING:  # it loads pinocchio
    from moc_opt.robots.model import RobotModel

TOLERANCE = 1e-6
"""Of the largest entry of M (without rotors) and of h, and of the tip's distance; rounding makes about 1e-14."""
POSES = 3
GRAVITY = 9.81
UNITS = {"M": "kg m^2", "h": "Nm", "tip": "m", "wrist": "m"}


class Terms(NamedTuple):
    """Of the arm at one position and velocity."""

    M: Array  #: (n,n) inertia, rotor inertia included [kg m^2]
    h: Array  #: (n,) Coriolis, centrifugal and gravity torque [Nm]
    tip: Array  #: (3,) [m]
    wrist: Array  #: (3,) [m]


def reference_terms(data: RobotData, q: Array, v: Array) -> list[Terms]:
    """Compute inertia, bias forces and tool points by MuJoCo, of a plant without defects, sensors or contact.

    Args:
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


def check_engines(robot: RobotModel) -> None:
    """Compare inertia M, bias h, tip and wrist of pinocchio and MuJoCo, at home and at seeded poses in motion.

    It takes about 2 ms. The plant's defects (masses, calibration, friction, elasticity) are no part of it.

    Raises:
        RobotError: they differ by more than `TOLERANCE`; the message names the quantity and the difference.
        PlantError: MuJoCo cannot take the robot.
    """
    data, rng = robot.data, np.random.default_rng(0)
    q = np.vstack([data.q_home, rng.uniform(data.q_min, data.q_max, (POSES - 1, data.n))])
    v = rng.uniform(-1.0, 1.0, q.shape) * np.minimum(data.v_max, 1.0)
    for position, speed, theirs in zip(q, v, reference_terms(data, q, v), strict=True):
        ours = robot.state(position, speed)
        # Rotor inertia is added to both and would hide small links: only its rounding is left in the scale.
        rotor = np.diag(data.rotor_inertia)
        heavy = max(np.abs(theirs.M - rotor).max(), 1e-8 * rotor.max())
        reach = max(1e-3, float(np.linalg.norm(theirs.tip)))
        sizes = {"M": heavy, "h": np.abs(theirs.h).max() + GRAVITY * heavy, "tip": reach, "wrist": reach}
        for name, size in sizes.items():
            off = float(np.abs(getattr(ours, name) - getattr(theirs, name)).max())
            if not off <= TOLERANCE * size:
                raise RobotError(
                    f"robot {data.name!r}: pinocchio and MuJoCo differ in {name} by {off:.3g} {UNITS[name]}, "
                    f"{off / size:.2g} of its size ({TOLERANCE:g} is allowed), at q = {np.round(position, 3)}: "
                    "they read its URDF differently; load it with moc_opt.load_robot, which writes it anew, and if it "
                    "was, report the file"
                )
