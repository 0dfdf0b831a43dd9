"""The MuJoCo model of a robot, made from the very URDF text that the controller's model reads."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping

import mujoco
import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import PlantError
from moc_opt.robots import RobotData
from moc_opt.sim.settings import GRAVITY

TOOL_BODY = "tool"
MOUNT_SITE = "tool_mount_sensor"
FORCE_SENSOR, TORQUE_SENSOR = "mount_force", "mount_torque"


def build_spec(
    data: RobotData, *, substep_s: float, gravity: bool = True, mass_scale: Mapping[str, float] | None = None,
    viscous: Array | None = None, coulomb: Array | None = None, origin_shift: Array | None = None,
    origin_turn: Array | None = None,
) -> mujoco.MjSpec:  # fmt: skip
    """Build the editable MuJoCo model of the arm; cameras or boards can be added before it is compiled.

    Every link stays a body of its own (MuJoCo would weld the tool to the flange, and the sensor between them
    would see nothing). Shapes are left out: nothing collides, and no mass is guessed from a mesh. Rotor
    inertia becomes `dof_armature`. Joint limits are soft stops. Friction is MuJoCo's own, which is integrated
    implicitly: an explicit smooth tanh lets an arm creep under load where a real one sticks.

    Args:
        data: the robot with its tool.
        substep_s: plant step [s].
        gravity: 9.81 m/s^2 along -z, or none.
        mass_scale: link name -> factor on its mass and inertia; the centre of mass stays. Missing links: 1.
        viscous, coulomb: (n,) friction [Nm s/rad], [Nm]; None is none.
        origin_shift, origin_turn: as of `Mismatch`; None is none.

    Raises:
        PlantError: the URDF cannot be made into a MuJoCo model, or `mass_scale` names no link of it.
    """
    try:
        spec = mujoco.MjSpec.from_string(_bare(data.urdf))
    except (ValueError, ET.ParseError) as error:
        raise PlantError(f"robot {data.name!r}: MuJoCo cannot read its URDF ({error}): correct the URDF") from error

    spec.option.timestep = substep_s
    spec.option.gravity = GRAVITY if gravity else (0.0, 0.0, 0.0)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    # A diverged state must be reported; MuJoCo would silently put the arm back to zero.
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_CONTACT)

    names = tuple(joint.name for joint in spec.joints)
    if names != data.joint_names:
        raise PlantError(
            f"robot {data.name!r}: MuJoCo finds the joints {names}, the robot lists {data.joint_names}: "
            "fix every joint that is not in the list, and list them from the base to the tool"
        )
    for i, joint in enumerate(spec.joints):
        joint.range = (data.q_min[i], data.q_max[i])
        joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.armature = data.rotor_inertia[i]
        joint.damping[0] = 0.0 if viscous is None else viscous[i]
        joint.frictionloss = 0.0 if coulomb is None else coulomb[i]
        # A stiff stick: under half its Coulomb torque a resting joint creeps by about 1e-5 rad/s. MuJoCo's
        # default is made for coarser steps and lets it slide a hundred times faster.
        joint.solref_friction = (2.0 * substep_s, 1.0)
        joint.solimp_friction = (0.99, 0.99, 0.001, 0.5, 2.0)

    _scale_masses(data.name, spec, mass_scale or {})
    _add_sensor(data.name, spec)
    if origin_shift is not None and origin_shift.any():
        _shift_origins(data, spec, origin_shift)
    if origin_turn is not None and origin_turn.any():
        _turn_frames(spec, origin_turn)
    return spec


def compile_model(name: str, spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a spec; `name` is the robot's, for the message.

    Raises:
        PlantError: MuJoCo refuses it, mostly for an inertia that no real body can have.
    """
    try:
        return spec.compile()
    except ValueError as error:
        said = str(error).strip()
        raise PlantError(f"robot {name!r}: MuJoCo refuses the model ({said}): correct the link's <inertial>") from error


def heavy_links(spec: mujoco.MjSpec) -> list[str]:
    """Return the names of the links with a mass, from the base outwards."""
    return [body.name for body in spec.bodies if body.mass > 0.0]


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


def _scale_masses(name: str, spec: mujoco.MjSpec, scale: Mapping[str, float]) -> None:
    links = heavy_links(spec)
    unknown = sorted(set(scale) - set(links))
    if unknown:
        raise PlantError(f"robot {name!r}: mass_scale names {unknown}: its links with a mass are {links}")
    for body in spec.bodies:
        factor = scale.get(body.name, 1.0)
        if factor != 1.0:
            body.mass *= factor
            body.fullinertia = body.fullinertia * factor


def _shift_origins(data: RobotData, spec: mujoco.MjSpec, shift: Array) -> None:
    for joint, of_joint in zip(spec.joints, shift[:-1], strict=True):
        joint.parent.pos = joint.parent.pos + of_joint
    # Wrist and tip are points of the shaft: they go where the tool goes.
    for name in (TOOL_BODY, data.tip_frame, data.wrist_frame):
        body = spec.body(name)
        body.pos = body.pos + shift[-1]


def _turn_frames(spec: mujoco.MjSpec, turn: Array) -> None:
    for joint, vector in zip(spec.joints, turn, strict=True):
        angle, by, turned = float(np.linalg.norm(vector)), np.zeros(4), np.zeros(4)
        mujoco.mju_axisAngle2Quat(by, vector / angle, angle)
        mujoco.mju_mulQuat(turned, by, joint.parent.quat)
        joint.parent.quat = turned


def _add_sensor(name: str, spec: mujoco.MjSpec) -> None:
    tool = spec.body(TOOL_BODY)
    if tool is None:
        raise PlantError(f"robot {name!r}: its URDF has no link {TOOL_BODY!r}: `load_data` adds it")
    tool.add_site(name=MOUNT_SITE)
    kinds = {FORCE_SENSOR: mujoco.mjtSensor.mjSENS_FORCE, TORQUE_SENSOR: mujoco.mjtSensor.mjSENS_TORQUE}
    for sensor, kind in kinds.items():
        spec.add_sensor(name=sensor, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=MOUNT_SITE)
