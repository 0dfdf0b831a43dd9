"""RobotModel: all terms of the control laws at one (q, v) of an arm, computed once.

Pinocchio gives inertia and bias forces; the kernels beside it give the kinematics, and what belongs to the tool.
"""

from __future__ import annotations

import os
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numba import float64, types
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import RobotError, shown
from moc_opt.model import kinematics_kernels as kernels
from moc_opt.model import place_kernels
from moc_opt.model.gains import CARTESIAN, derived_gains
from moc_opt.model.robot_state import RobotState
from moc_opt.model.symbolic import Chain, Kinematics, build_kinematics
from moc_opt.numerics.arrays import Array, read_only
from moc_opt.numerics.compiled import FLAGS, MATRIX, VECTOR, CompiledKernel
from moc_opt.robots import RobotData, load_data

__all__ = ["RobotModel", "RobotState", "load_robot"]

_FILL_STATE = CompiledKernel(kernels.fill_state, *[VECTOR] * 3, *[MATRIX] * 4, VECTOR, MATRIX, FLAGS, MATRIX, VECTOR)
_MU_ALONG = CompiledKernel(kernels.mu_along, *[MATRIX] * 3, FLAGS, VECTOR)
_POINTS_ALONG = CompiledKernel(place_kernels.points_along, MATRIX, MATRIX, MATRIX, types.Array(float64, 3, "C"))
_TOOL_POSE = CompiledKernel(place_kernels.tool_pose, MATRIX, VECTOR, MATRIX, VECTOR, MATRIX)
_DOUBLE, _CLOSE = np.dtype(np.float64), (8,)
_bias_forces, _inertia = pin.nonLinearEffects, pin.crba
_STRUCTURAL_ZERO = 1e-12  # a column this small at several random poses is zero at all of them


class RobotModel:
    """The arm with its tool. One model serves one thread: all its calls share pinocchio's workspace.

    Attributes:
        data: what its files say, a `moc_opt.robots.description.RobotData`.
        n: number of joints.
        q_min, q_max: (n,) limits [rad; m where a joint slides].
        v_max: (n,) largest speeds [rad/s or m/s]; tau_max: (n,) largest torques [Nm or N].

    Example:
        >>> robot = mo.load_robot("lwr4")
        >>> q = np.array(robot.data.q_home)
        >>> state = robot.state(q)
        >>> robot.n, state.J_tip.shape, robot.coriolis(q, np.zeros(7)).shape, robot.gravity(q).shape
        (7, (3, 7), (7, 7), (7,))
        >>> poses = np.stack([q, robot.random_regular_pose(np.random.default_rng(0))])
        >>> bool(robot.mu_along(poses)[0] == state.mu)
        True
        >>> tip, wrist = robot.tool_along(poses)
        >>> np.linalg.norm(tip - wrist, axis=1).round(6).tolist()
        [0.378, 0.378]
        >>> np.allclose(robot.tool_pose(q)[3], state.tip), robot.mount.shape, len(robot.tool_place)
        (True, (3, 3), 3)
        >>> robot.moves[:, -1].tolist()  # the last joint turns the tool about its own axis
        [False, False]
        >>> float(robot.kinematics().mu(q)) - state.mu < 1e-12, robot.chain.axes.shape
        (True, (7, 3))
    """

    def __init__(self, data: RobotData) -> None:
        """Build the pinocchio model of `data`.

        Raises:
            RobotError: pinocchio cannot read the URDF, or its joints or frames are not those of the data.
        """
        self.data = data
        self.n = n = data.n
        self.q_min, self.q_max, self.v_max, self.tau_max = data.q_min, data.q_max, data.v_max, data.tau_max
        self._pin = _build(data)
        self._fill_state, self._tool_pose = _FILL_STATE.code, _TOOL_POSE.code
        self._pin_data = self._pin.createData()
        self._side_data = self._pin.createData()
        frames = [_frame(self._pin, name) for name in (data.tip_frame, data.wrist_frame)]
        self._offsets = read_only(np.array([frame.placement.translation for frame in frames]))
        self._mount, self._tip_offset = np.ascontiguousarray(frames[0].placement.rotation.T), self._offsets[0]
        if np.linalg.norm(self._offsets[0] - self._offsets[1]) < 1e-6:
            raise RobotError("tip and wrist frames coincide: lengthen the tool or move the wrist frame")
        # Views into pinocchio's memory that later calls update in place; transposed: Eigen stores columns.
        self._inertia, self._bias = self._pin_data.M.T, self._pin_data.nle
        self._joints, self._places, self._axes = self.chain.joints, np.empty((n, 12)), np.empty((n, 6))
        self._bodies = np.array([_numbers(body) for body in list(self._pin.inertias)[1:]])
        self._field = np.array(self._pin.gravity.linear)
        self._shape, self._size, self._rest = (n,), kernels.record_size(n), np.zeros(n)
        self._moves = read_only(np.ones((2, n), dtype=np.bool_))
        # Which joints ever move tip and wrist: the last joint, for one, moves no tool on its own axis.
        drawn = np.random.default_rng(0).uniform(self.q_min, self.q_max, (4, n))
        columns = [np.linalg.norm(self.state(q).A.reshape(2, 3, n), axis=1) for q in drawn]
        self._moves = read_only(np.max(columns, axis=0) > _STRUCTURAL_ZERO)
        self._kinematics: Kinematics | None = None

    def __repr__(self) -> str:
        return f"RobotModel({self.data.name!r}, n={self.n}, tool {self.data.tool_length} m)"

    def __reduce__(self) -> tuple[Any, ...]:
        return RobotModel, (self.data,)  # the views into pinocchio's memory do not survive copying

    def state(self, q: ArrayLike, v: ArrayLike | None = None) -> RobotState:
        """Compute everything at q (n,) [rad] and v (n,) [rad/s] (at rest when None).

        Raises:
            RobotError: q or v has the wrong shape or is not finite.
        """
        position = self._vector("q", q)
        velocity = self._rest if v is None else self._vector("v", v)
        model, data, record = self._pin, self._pin_data, np.empty(self._size)
        _bias_forces(model, data, position, velocity)
        _inertia(model, data, position)
        code = self._fill_state(
            record, position, velocity, self._axes, self._joints, self._places, self._bodies, self._field,
            self._offsets, self._moves, self._inertia, self._bias,
        )  # fmt: skip
        if code != kernels.OK:
            name, value = ("q", position) if code == kernels.BAD_Q else ("v", velocity)
            raise RobotError(f"{name} = {value.tolist()} is not finite: check the sensor or step that gave it")
        return RobotState(record, self.n)

    def mu_along(self, poses: Array) -> Array:
        """Compute manipulability (k,) [m^3] at the poses (k,n) [rad], equal to that of `state` to the last bit.

        Raises:
            RobotError: another shape, or no numbers.
        """
        along = self._poses(poses)
        mu = np.empty(len(along))
        _MU_ALONG.code(along, self._joints, self._offsets, self._moves, mu)
        return mu

    def tool_along(self, poses: Array) -> tuple[Array, Array]:
        """Compute tip and wrist, (k,3) each [m], at the poses (k,n) [rad].

        Raises:
            RobotError: another shape, or no numbers.
        """
        along = self._poses(poses)
        points = np.empty((2, len(along), 3))
        _POINTS_ALONG.code(self._joints, along, self._offsets, points)
        return points[0], points[1]

    def _poses(self, given: object) -> Array:
        try:
            poses = np.array(given, dtype=np.float64, order="C")  # compiled code takes that for granted
        except (TypeError, ValueError) as error:
            raise RobotError(f"poses = {shown(given)}: give an array of numbers (k, {self.n})") from error
        if poses.ndim != 2 or poses.shape[1] != self.n:
            raise RobotError(f"poses has shape {poses.shape}: give (k, {self.n}), one pose a row")
        return poses

    def coriolis(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Compute the Coriolis matrix C (n,n) with h = C v + g and dM/dt - 2 C skew-symmetric."""
        return np.array(
            pin.computeCoriolisMatrix(self._pin, self._side_data, self._vector("q", q), self._vector("v", v))
        )

    def gravity(self, q: ArrayLike) -> Array:
        """Compute the gravity torque g (n,) [Nm]."""
        return np.array(pin.computeGeneralizedGravity(self._pin, self._side_data, self._vector("q", q)))

    def tool_pose(self, q: ArrayLike) -> Array:
        """Compute the tool's pose (4,3): its x, y and z axes and its tip [m], in world axes.

        z runs along the shaft from wrist to tip; these are the axes of the wrench sensor at the tool's mount.
        """
        pose = np.empty((4, 3))
        self._tool_pose(self._joints, self._vector("q", q), self._mount, self._tip_offset, pose)
        return pose

    @property
    def tool_place(self) -> place_kernels.ToolPlace:
        """The place of the tool on the arm, from which `tool_pose` is computed."""
        return place_kernels.ToolPlace(self._joints, self._mount, self._tip_offset)

    @property
    def mount(self) -> Array:
        """(3,3) rows: the tool's axes x, y, z in the last joint's frame."""
        return self._mount

    @property
    def moves(self) -> NDArray[np.bool_]:
        """(2,n) which joints can move the tip (first row) and the wrist (second row) at all."""
        return self._moves

    @cached_property
    def chain(self) -> Chain:
        """Joint placements and axes as plain numbers."""
        neutral = self._pin.createData()
        pin.computeJointJacobians(self._pin, neutral, np.zeros(self.n))
        turned = [neutral.oMi[j + 1].rotation.T @ neutral.J[3:, j] for j in range(self.n)]
        prismatic = np.array([np.linalg.norm(axis) < 0.5 for axis in turned])
        axes = [neutral.oMi[j + 1].rotation.T @ neutral.J[:3, j] if prismatic[j] else turned[j] for j in range(self.n)]
        placements = [self._pin.jointPlacements[j + 1] for j in range(self.n)]
        return Chain(
            rotations=np.array([placement.rotation for placement in placements]),
            origins=np.array([placement.translation for placement in placements]), axes=np.array(axes),
            prismatic=prismatic, offsets=self._offsets,
        )  # fmt: skip

    def kinematics(self) -> Kinematics:
        """Return CasADi functions tip, wrist, mu, grad_mu of q, built at the first call."""
        if self._kinematics is None:
            self._kinematics = build_kinematics(self.data.name, self.chain)
        return self._kinematics

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

    def _vector(self, name: str, value: ArrayLike) -> Array:
        if (
            type(value) is np.ndarray
            and value.shape == self._shape
            and value.dtype is _DOUBLE
            and value.strides == _CLOSE
        ):
            return value
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise RobotError(f"{name} = {value!r} is not numeric: give {self.n} numbers") from error
        if array.shape != self._shape:
            raise RobotError(f"{name} has shape {array.shape}: the arm has {self.n} joints, give ({self.n},)")
        return array


def load_robot(
    name_or_path: str | os.PathLike[str] = "lwr4", *, tool_length: float | None = None, tool_mass: float | None = None
) -> RobotModel:
    """Load a robot by name or path; see `moc_opt.robots.load_data` for the arguments and errors.

    Tables of gains that its TOML does not have are derived from its inertia (`moc_opt.model.gains`).

    Args:
        name_or_path: of an arm of the package (`moc-opt robots` lists them), or a TOML or URDF file.
        tool_length: from the last flange to the tip [m]; tool_mass: [kg]; None: as its file says.

    Raises:
        RobotError: a file is missing, incomplete or inconsistent.
        UnknownNameError: no arm of that name.

    Example:
        >>> mo.load_robot("lwr4", tool_length=0.25)
        RobotModel('lwr4', n=7, tool 0.25 m)
    """
    robot = RobotModel(load_data(name_or_path, tool_length=tool_length, tool_mass=tool_mass))
    if not CARTESIAN.keys() <= robot.data.gains.keys():
        robot.data = replace(robot.data, gains={**derived_gains(robot), **robot.data.gains})
    return robot


def _numbers(body: Any) -> list[float]:
    inertia = body.inertia
    return [body.mass, *(body.mass * body.lever), *(inertia[i, j] for i in range(3) for j in range(i + 1))]


def _build(data: RobotData) -> Any:
    try:
        model = pin.buildModelFromXML(data.urdf)
    except (ValueError, RuntimeError) as error:
        raise RobotError(f"urdf of {data.name!r} cannot be read by pinocchio: {error}") from error
    if tuple(model.names)[1:] != data.joint_names or model.nq != data.n:
        raise RobotError(
            f"urdf of {data.name!r} has the joints {list(model.names)[1:]}, the data {data.joint_names}: "
            "they must be the same serial chain"
        )
    model.armature = data.rotor_inertia.copy()
    return model


def _frame(model: Any, name: str) -> Any:
    """Return the body frame of that name; the last joint must move it."""
    if not model.existFrame(name, pin.FrameType.BODY):
        raise RobotError(f"frame {name!r} is no link of the urdf: its links are {[f.name for f in model.frames]}")
    frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
    if frame.parentJoint != model.njoints - 1:
        raise RobotError(f"frame {name!r} does not ride on the last joint: fix it to the last link")
    return frame
