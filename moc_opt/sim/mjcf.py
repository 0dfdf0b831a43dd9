"""The MuJoCo model of a robot, and its comparison with the controller's model."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from moc_opt.errors import PlantError, RobotError
from moc_opt.robots import RobotData
from moc_opt.sim.settings import GRAVITY, Mismatch

if TYPE_CHECKING:  # the import would load pinocchio
    from moc_opt.robots.model import RobotModel

TOOL_BODY = "tool"
MOUNT_SITE = "tool_mount_sensor"
FORCE_SENSOR, TORQUE_SENSOR = "mount_force", "mount_torque"
TOLERANCE = 1e-6
"""Largest allowed relative difference between pinocchio and MuJoCo."""
POSES = 3  #: Number of compared poses.


def build_spec(data: RobotData, *, substep_s: float, gravity: bool = True) -> mujoco.MjSpec:
    """Build the editable MuJoCo model of the arm, without shapes and friction. Joint limits are soft stops."""
    try:
        spec = mujoco.MjSpec.from_string(_bare(data.urdf))
    except (ValueError, ET.ParseError) as error:
        raise PlantError(f"robot {data.name!r}: MuJoCo cannot read its URDF ({error}): correct the URDF") from error

    spec.option.timestep = substep_s
    spec.option.gravity = GRAVITY if gravity else (0.0, 0.0, 0.0)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    # By default, MuJoCo silently resets a diverged state to zero.
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_CONTACT)

    names = tuple(joint.name for joint in spec.joints)
    if names != data.joint_names:
        raise PlantError(
            f"robot {data.name!r}: MuJoCo finds the joints {names}, the robot lists {data.joint_names}: "
            "set type='fixed' in the URDF for every joint not listed, and list the joints from base to tool"
        )
    for i, joint in enumerate(spec.joints):
        joint.range = (data.q_min[i], data.q_max[i])
        joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.armature = data.rotor_inertia[i]
        joint.damping[0] = joint.frictionloss = 0.0
        # MuJoCo's default friction is softer: with it, a loaded joint would creep a hundred times faster.
        joint.solref_friction = (2.0 * substep_s, 1.0)
        joint.solimp_friction = (0.99, 0.99, 0.001, 0.5, 2.0)

    tool = spec.body(TOOL_BODY)
    if tool is None:
        raise PlantError(f"robot {data.name!r}: its URDF has no link {TOOL_BODY!r}: `load_data` adds it")
    tool.add_site(name=MOUNT_SITE)
    kinds = {FORCE_SENSOR: mujoco.mjtSensor.mjSENS_FORCE, TORQUE_SENSOR: mujoco.mjtSensor.mjSENS_TORQUE}
    for sensor, kind in kinds.items():
        spec.add_sensor(name=sensor, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=MOUNT_SITE)
    return spec


def add_mismatch(data: RobotData, spec: mujoco.MjSpec, mismatch: Mismatch) -> None:
    """Set the plant's friction, masses and kinematics in a spec from `build_spec`."""
    for body in spec.bodies:
        if body.name in mismatch.mass_scale:
            body.mass *= mismatch.mass_scale[body.name]
            body.fullinertia = body.fullinertia * mismatch.mass_scale[body.name]
    for i, joint in enumerate(spec.joints):
        joint.damping[0], joint.frictionloss = mismatch.viscous_friction[i], mismatch.coulomb_friction[i]
        link, vector = joint.parent, mismatch.origin_turn[i]
        link.pos = link.pos + mismatch.origin_shift[i]
        if angle := float(np.linalg.norm(vector)):
            by, turned = np.zeros((2, 4))
            mujoco.mju_axisAngle2Quat(by, vector / angle, angle)
            mujoco.mju_mulQuat(turned, by, link.quat)
            link.quat = turned
    # Wrist and tip shift with the tool.
    for name in (TOOL_BODY, data.tip_frame, data.wrist_frame):
        if (body := spec.body(name)) is not None:
            body.pos = body.pos + mismatch.origin_shift[-1]


def compile_model(name: str, spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a robot's spec. Raise a PlantError if MuJoCo refuses it."""
    try:
        return spec.compile()
    except ValueError as error:
        raise PlantError(f"robot {name!r}: MuJoCo refuses its URDF ({error}): correct the <inertial>") from error


def _bare(urdf: str) -> str:
    root = ET.fromstring(urdf)
    for link in root.iter("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    for element in root.findall("mujoco"):
        root.remove(element)
    options = {"fusestatic": "false", "balanceinertia": "false", "boundmass": "0", "boundinertia": "0"}
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", options)
    return ET.tostring(root, encoding="unicode")


def check_engines(robot: RobotModel) -> None:
    """Raise a RobotError if pinocchio and MuJoCo differ in M, h, tip or wrist by over `TOLERANCE` at `POSES` states."""
    data, rng = robot.data, np.random.default_rng(0)
    model = compile_model(data.name, build_spec(data, substep_s=0.001))
    state, M = mujoco.MjData(model), np.zeros((data.n, data.n))
    theirs = {
        "M": M, "h": state.qfrc_bias, "tip": state.xpos[model.body(data.tip_frame).id],
        "wrist": state.xpos[model.body(data.wrist_frame).id],
    }  # fmt: skip
    rotor = np.diag(data.rotor_inertia)
    for q in (data.q_home, *rng.uniform(data.q_min, data.q_max, (POSES - 1, data.n))):
        state.qpos[:], state.qvel[:] = q, rng.uniform(-1.0, 1.0, data.n)
        mujoco.mj_fwdPosition(model, state)
        mujoco.mj_fwdVelocity(model, state)
        mujoco.mj_fullM(model, state, M)
        ours = robot.state(q, state.qvel)
        # `heavy` leaves out the rotors. With their inertia, the tolerance for M would hide errors of small links.
        heavy = max(np.abs(M - rotor).max(), 1e-8 * rotor.max())
        bias, reach = np.abs(theirs["h"]).max() - GRAVITY[2] * heavy, max(1e-3, np.linalg.norm(theirs["tip"]))
        sizes = {"M": (heavy, "kg m^2"), "h": (bias, "Nm"), "tip": (reach, "m"), "wrist": (reach, "m")}
        for name, (size, unit) in sizes.items():
            off = float(np.abs(getattr(ours, name) - theirs[name]).max())
            if not off <= TOLERANCE * size:
                raise RobotError(
                    f"robot {data.name!r}: pinocchio and MuJoCo differ in {name} by {off:.3g} {unit}, {off / size:.2g} "
                    f"of its size ({TOLERANCE:g} is allowed), at q = {np.round(q, 3)}: they read the URDF differently; "
                    "load the robot with moc_opt.load_robot, which rewrites the URDF; if you did so, report the file"
                )
