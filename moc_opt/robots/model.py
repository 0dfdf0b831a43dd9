"""RobotModel: all terms of the control laws at one (q, v) of an arm.

Pinocchio reads the URDF; `moc_opt.core` computes the terms.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from moc_opt import core
from moc_opt.arrays import Array, read_only
from moc_opt.errors import RobotError, shown
from moc_opt.inputs.files import plain
from moc_opt.robots import urdf
from moc_opt.robots.chain import Chain, Kinematics, build_kinematics
from moc_opt.robots.gains import CARTESIAN, derived_gains
from moc_opt.robots.loader import RobotData, load_data
from moc_opt.robots.state import RobotState, record_size

__all__ = ["RobotModel", "RobotState", "load_robot"]

_STRUCTURAL_ZERO = 1e-12  # a column this small at several random poses is zero at all of them


class RobotModel:
    """The arm with its tool.

    Attributes:
        data: what its files say, a `moc_opt.robots.RobotData`.
        n: number of joints.
        q_min, q_max: (n,) limits [rad; m where a joint slides].
        v_max: (n,) largest speeds [rad/s or m/s]; tau_max: (n,) largest torques [Nm or N].
        moves: (2,n) which joints can move the tip (first row) and the wrist (second row) at all.
        arm: the same arm as the core's data.

    Example:
        >>> robot = mo.load_robot("lwr4")
        >>> q = np.array(robot.data.q_home)
        >>> state = robot.state(q)
        >>> robot.n, state.J_tip.shape, robot.gravity(q).shape
        (7, (3, 7), (7,))
        >>> poses = np.stack([q, robot.random_regular_pose(np.random.default_rng(0))])
        >>> bool(robot.mu_along(poses)[0] == state.mu)
        True
        >>> tip, wrist = robot.tool_along(poses)
        >>> np.linalg.norm(tip - wrist, axis=1).round(6).tolist()
        [0.378, 0.378]
        >>> np.allclose(robot.tool_pose(q)[3], state.tip)
        True
        >>> robot.moves[:, -1].tolist()  # the last joint turns the tool about its own axis
        [False, False]
        >>> float(robot.kinematics().mu(q)) - state.mu < 1e-12, robot.chain.axes.shape
        (True, (7, 3))
    """

    def __init__(self, data: RobotData) -> None:
        """Build the model; a RobotError where pinocchio cannot read the URDF, or its joints are others."""
        self.data = data
        self.n = n = data.n
        self.q_min, self.q_max, self.v_max, self.tau_max = data.q_min, data.q_max, data.v_max, data.tau_max
        if n > core.MAX_JOINTS:
            raise RobotError(f"{data.name!r} has {n} joints: at most {core.MAX_JOINTS} can be controlled")
        self._pin = _build(data)
        tip, wrist = (self._pin.getFrameId(name, pin.FrameType.BODY) for name in (data.tip_frame, data.wrist_frame))
        frames = [self._pin.frames[tip], self._pin.frames[wrist]]
        self._offsets = read_only(np.array([frame.placement.translation for frame in frames]))
        self._mount = np.ascontiguousarray(frames[0].placement.rotation.T)
        self._size, self._rest = record_size(n), np.zeros(n)
        self.moves = read_only(np.ones((2, n), dtype=np.bool_))
        self.arm = core.Arm(*self.arm_arrays)
        # Which joints ever move tip and wrist: the last joint, for one, moves no tool on its own axis.
        drawn = np.random.default_rng(0).uniform(self.q_min, self.q_max, (4, n))
        columns = [np.linalg.norm(self.state(q).A.reshape(2, 3, n), axis=1) for q in drawn]
        self.moves = read_only(np.max(columns, axis=0) > _STRUCTURAL_ZERO)
        self.arm = core.Arm(*self.arm_arrays)

    @property
    def arm_arrays(self) -> tuple[Array, ...]:
        """The arm as numbers, in the order of `core.Arm`."""
        inertias = list(self._pin.inertias)[1:]
        return (
            self.chain.joints, np.array([_inertia(body) for body in inertias]),
            np.array(self.data.rotor_inertia, dtype=np.float64), self._offsets, self._mount,
            self.moves.astype(np.float64), np.array(self._pin.gravity.linear),
        )  # fmt: skip

    def __repr__(self) -> str:
        return f"RobotModel({self.data.name!r}, n={self.n}, tool {self.data.tool_length} m)"

    def __reduce__(self) -> tuple[Any, ...]:
        return RobotModel, (self.data,)  # the views into pinocchio's memory do not survive copying

    def state(self, q: ArrayLike, v: ArrayLike | None = None) -> RobotState:
        """Compute everything at q (n,) [rad] and v (n,) [rad/s] (at rest when None).

        Raises:
            RobotError: q or v has the wrong shape or is not finite.
        """
        record, v = np.empty(self._size), self._rest if v is None else v
        try:  # the core checks arrays by itself
            code = self.arm.terms(q, v, record)  # type: ignore[arg-type]
        except ValueError:
            q, v = self._numbers("q", q), self._numbers("v", v)
            code = self.arm.terms(q, v, record)
        if code != core.OK:
            name, value = ("q", q) if code == core.BAD_Q else ("v", v)
            numbers = np.asarray(value).tolist()
            raise RobotError(f"{name} = {numbers} is not finite: check the sensor or step that gave it")
        return RobotState(record, self.n)

    def mu_along(self, poses: Array) -> Array:
        """Compute manipulability (k,) [m^3] at the poses (k,n) [rad], equal to that of `state` to the last bit."""
        return self._along(poses)[2]

    def tool_along(self, poses: Array) -> tuple[Array, Array]:
        """Compute tip and wrist, (k,3) each [m], at the poses (k,n) [rad]."""
        return self._along(poses)[:2]

    def _along(self, poses: Array) -> tuple[Array, Array, Array]:
        along = self._numbers("poses", poses, 2)
        found = np.empty((len(along), 3)), np.empty((len(along), 3)), np.empty(len(along))
        self.arm.along(along, *found)
        return found

    def gravity(self, q: ArrayLike) -> Array:
        """Compute the gravity torque g (n,) [Nm], that of `state`."""
        return self.state(q).gravity.copy()

    def tool_pose(self, q: ArrayLike) -> Array:
        """Compute the tool's pose (4,3): x, y and z axis, in which the wrench sensor measures, and tip [m]; world axes.

        z runs along the shaft from wrist to tip.
        """
        pose = np.empty((4, 3))
        self.arm.tool_pose(self._numbers("q", q), pose)
        return pose

    @cached_property
    def chain(self) -> Chain:
        """Joint placements and axes as plain numbers."""
        neutral = self._pin.createData()
        pin.computeJointJacobians(self._pin, neutral, np.zeros(self.n))
        prismatic = np.linalg.norm(neutral.J[3:], axis=0) < 0.5
        rows = np.where(prismatic, neutral.J[:3], neutral.J[3:])
        axes = np.array([neutral.oMi[j + 1].rotation.T @ rows[:, j] for j in range(self.n)])
        placements = list(self._pin.jointPlacements)[1:]
        rotations, origins = (np.array([getattr(at, of) for at in placements]) for of in ("rotation", "translation"))
        return Chain(rotations, origins, axes, prismatic, self._offsets)

    def kinematics(self) -> Kinematics:
        """Return CasADi functions tip, wrist, mu, grad_mu of q, built at the first call."""
        return build_kinematics(self.data.name, self.chain)

    def random_regular_pose(self, rng: np.random.Generator, *, margin: float = 0.1, mu_min: float = 0.05) -> Array:
        """Draw a pose (n,) that keeps `margin` of each joint's range from both limits, with mu > `mu_min`.

        Raises:
            RobotError: none found in 1000 draws.
        """
        room = margin * (self.q_max - self.q_min)
        for _ in range(1000):
            q = rng.uniform(self.q_min + room, self.q_max - room)
            if self.state(q).mu > mu_min:
                return q
        raise RobotError(f"no pose with mu > {mu_min} in 1000 draws: lower mu_min or margin = {margin}")

    def _numbers(self, name: str, value: ArrayLike, dimensions: int = 1) -> Array:
        shape = f"({'k, ' if dimensions > 1 else ''}{self.n},)"
        try:
            array = np.array(value, dtype=np.float64, order="C")  # compiled code takes that for granted
        except (TypeError, ValueError) as error:
            raise RobotError(f"{name} = {shown(value)} is not numeric: give numbers {shape}") from error
        if array.ndim != dimensions or array.shape[-1] != self.n:
            raise RobotError(f"{name} has shape {array.shape}: the arm has {self.n} joints, give {shape}")
        return array


def load_robot(
    name_or_path: str | os.PathLike[str] = "lwr4", *, tool_length: float | None = None, tool_mass: float | None = None
) -> RobotModel:
    """Load a robot by name or path; tables of gains that its TOML does not have are derived from its inertia.

    Args:
        name_or_path: of an arm of the package (`moc-opt robots` lists them), or a TOML or URDF file.
        tool_length: from the last flange to the tip [m]; tool_mass: [kg]; None: as its file says.

    Raises:
        RobotError: a file is missing, incomplete or inconsistent.
        UnknownNameError: no arm of that name.
    """
    robot = RobotModel(load_data(name_or_path, tool_length=tool_length, tool_mass=tool_mass))
    if not CARTESIAN.keys() <= robot.data.gains.keys():
        robot.data = replace(robot.data, gains={**derived_gains(robot), **robot.data.gains})
    return robot


def _inertia(body: Any) -> list[float]:
    inertia = body.inertia
    return [body.mass, *(body.mass * body.lever), *(inertia[i, j] for i in range(3) for j in range(i + 1))]


def _build(data: RobotData) -> Any:
    try:
        model = pin.buildModelFromXML(data.urdf)
    except (ValueError, RuntimeError) as error:
        raise RobotError(f"urdf of {data.name!r} cannot be read by pinocchio: {error}") from error
    names = tuple(model.names)[1:]
    if names != data.joint_names or model.nq != data.n:
        raise RobotError(f"urdf of {data.name!r}: {names} and {data.joint_names} must be the same serial chain")
    return model


def carried(robot: RobotModel) -> dict[str, Any]:
    """Return the robot as values that JSON can hold, so that a run of an arm of one's own replays anywhere."""
    return {name: plain(value) for name, value in vars(robot.data).items()}


def restored(values: Mapping[str, Any]) -> RobotModel:
    """Make the robot of what `carried` gave; a RobotError where that is damaged."""
    try:
        arm = urdf.read(values["urdf"])
        urdf.normalize(arm)
        text = arm.to_text(values["name"])
        return RobotModel(RobotData(**{**values, "urdf": text, "joint_names": tuple(values["joint_names"])}))
    except (TypeError, ValueError, LookupError, AttributeError) as error:
        raise RobotError(f"the robot in the trace is damaged ({error}): save the trace anew") from error
