"""`RobotModel` computes the terms of the control laws at (q, v), as a `RobotState`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, cached_property
from itertools import accumulate
from typing import Any, NoReturn

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

LEAST_JOINTS = 4  # with fewer, tip and shaft cannot be controlled
_STRUCTURAL_ZERO = 1e-12  # a column of a Jacobian with a smaller norm counts as zero
_TIP, _WRIST = slice(0, 3), slice(3, 6)


@cache
def layout(n: int) -> dict[str, slice]:
    """Return the slice of each part of `RobotState.record`, in the core's order."""
    parts = {
        "q": n, "v": n, "tip": 3, "wrist": 3, "u": 3, "A": 6 * n, "drift": 6, "grad_mu": n, "grad_mu_shaft": n,
        "M": n * n, "h": n, "energy_slope": n, "gravity": n, "scalars": 3,
    }  # fmt: skip
    ends = list(accumulate(parts.values()))
    return {name: slice(end - size, end) for (name, size), end in zip(parts.items(), ends, strict=True)}


def _part(name: str, doc: str, *, rows: slice | None = None, shape: tuple[int, ...] | None = None) -> Array:
    def view(state: RobotState) -> Array:
        part = state.record[layout(state.n)[name]]
        if shape is not None:
            part = part.reshape([size or state.n for size in shape])
        return part if rows is None else part[rows]

    return property(view, doc=doc)  # type: ignore[return-value]


def _scalar(index: int, doc: str) -> float:
    def number(state: RobotState) -> float:
        return float(state.record[layout(state.n)["scalars"].start + index])

    return property(number, doc=doc)  # type: ignore[return-value]


class RobotState:
    """Jacobians, dynamics and manipulability of an arm at one (q, v): read-only views of one flat array, `record`.

    Example:
        >>> robot = mo.load_robot("lwr4")
        >>> state = robot.state(robot.data.q_home, np.full(7, 0.1))
        >>> state.tip.shape, state.A.shape, state.M.shape, round(state.mu, 3)
        ((3,), (6, 7), (7, 7), 0.268)
        >>> np.allclose(state.tip - state.wrist, state.tool_span * state.tool_direction)
        True
        >>> np.allclose(state.A, np.vstack([state.J_tip, state.J_wrist]))
        True
    """

    record: Array
    n: int

    def __init__(self, record: Array, n: int) -> None:
        record.setflags(write=False)
        own = self.__dict__  # bypasses our slower __setattr__
        own["record"], own["n"] = record, n

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"RobotState is frozen: {name} cannot be set")

    def __reduce__(self) -> tuple[Any, ...]:
        return RobotState, (self.record.copy(), self.n)

    def __repr__(self) -> str:
        return f"RobotState(n={self.n}, q={np.round(self.q, 4).tolist()}, mu={self.mu:.4g})"

    q = _part("q", "Joint positions (n,) [rad].")
    v = _part("v", "Joint velocities (n,) [rad/s].")
    tip = _part("tip", "Tool tip X (3,) [m].")
    wrist = _part("wrist", "Wrist centre N (3,) [m].")
    tool_direction = _part("u", "u = (X - N)/L (3,), the unit vector along the shaft.")
    tool_span = _scalar(1, "L = |X - N| [m], constant.")
    A = _part("A", "[J_tip; J_wrist] (6,n), of rank 5 at most: |X - N| is constant.", shape=(6, 0))
    J_tip = _part("A", "Translational Jacobian of the tip (3,n), world axes [m/rad].", rows=_TIP, shape=(6, 0))
    J_wrist = _part("A", "Translational Jacobian of the wrist (3,n), world axes [m/rad].", rows=_WRIST, shape=(6, 0))
    drift_tip = _part("drift", "dJ_tip/dt v (3,) [m/s^2].", rows=_TIP)
    drift_wrist = _part("drift", "dJ_wrist/dt v (3,) [m/s^2].", rows=_WRIST)
    mu = _scalar(0, "Manipulability sqrt(det(J_tip J_tip^T)) [m^3].")
    grad_mu = _part("grad_mu", "dmu/dq (n,) [m^3/rad]; zero at a singularity, where mu has a kink.")
    mu_shaft = _scalar(2, (
        "Manipulability of the shaft while the tip rests [m^2]: product of the two largest singular values of "
        "J_wrist (I - pinv(J_tip) J_tip)."
    ))  # fmt: skip
    grad_mu_shaft = _part("grad_mu_shaft", "dmu_shaft/dq (n,) [m^2/rad]; zero where mu_shaft is 0 and has a kink.")
    M = _part("M", "Joint-space inertia (n,n), rotor inertia included [kg m^2].", shape=(0, 0))
    h = _part("h", "Coriolis and centrifugal torque C v plus gravity torque g (n,) [Nm].")
    energy_slope = _part("energy_slope", (
        "dT/dq (n,) [Nm] of the kinetic energy T = v^T M v / 2. It equals C^T v if C is built from Christoffel symbols."
    ))  # fmt: skip
    gravity = _part("gravity", "g (n,) [Nm], the torque that carries the arm's weight.")


class RobotModel:
    """The arm with its tool.

    Attributes:
        data: the robot's files, as `moc_opt.robots.RobotData`.
        n: number of joints.
        q_min, q_max: (n,) limits [rad or m].
        v_max: (n,) speed limits [rad/s or m/s].
        tau_max: (n,) torque limits [Nm or N].
        moves: (2,n) whether each joint can move the tip (first row), and the wrist (second row).
        arm: the compiled core's `Arm`.

    Example:
        >>> robot = mo.load_robot("lwr4")
        >>> q = np.array(robot.data.q_home)
        >>> state = robot.state(q)
        >>> poses = np.stack([q, robot.random_regular_pose(np.random.default_rng(0))])
        >>> bool(robot.mu_along(poses)[0] == state.mu), robot.tool_along(poses)[0].shape
        (True, (2, 3))
        >>> robot.n, robot.gravity(q).shape, np.allclose(robot.tool_pose(q)[3], state.tip)
        (7, (7,), True)
        >>> robot.moves[:, -1].tolist()  # the last joint turns the tool about its own axis
        [False, False]
        >>> float(robot.kinematics().mu(q)) - state.mu < 1e-12, robot.chain.axes.shape
        (True, (7, 3))
    """

    def __init__(self, data: RobotData) -> None:
        """Build the model. Raise a RobotError if the number of joints or the URDF is not usable."""
        self.data = data
        self.n = n = data.n
        self.q_min, self.q_max, self.v_max, self.tau_max = data.q_min, data.q_max, data.v_max, data.tau_max
        if not LEAST_JOINTS <= n <= core.MAX_JOINTS:
            raise RobotError(f"{data.name!r} has {n} joints: {LEAST_JOINTS} to {core.MAX_JOINTS} can be controlled")
        self._pin = _build(data)
        tip, wrist = (self._pin.getFrameId(name, pin.FrameType.BODY) for name in (data.tip_frame, data.wrist_frame))
        frames = [self._pin.frames[tip], self._pin.frames[wrist]]
        self._offsets = read_only(np.array([frame.placement.translation for frame in frames]))
        self._mount = np.ascontiguousarray(frames[0].placement.rotation.T)
        self._rest = np.zeros(n)
        self.moves = read_only(np.ones((2, n), dtype=np.bool_))
        self.arm = core.Arm(*self.arm_arrays)
        drawn = np.random.default_rng(0).uniform(self.q_min, self.q_max, (4, n))
        columns = [np.linalg.norm(self.state(q).A.reshape(2, 3, n), axis=1) for q in drawn]
        self.moves = read_only(np.max(columns, axis=0) > _STRUCTURAL_ZERO)
        self.arm = core.Arm(*self.arm_arrays)

    @property
    def arm_arrays(self) -> tuple[Array, ...]:
        """The arm as the arguments of `core.Arm`."""
        lower = np.tril_indices(3)
        bodies = [[body.mass, *(body.mass * body.lever), *body.inertia[lower]] for body in list(self._pin.inertias)[1:]]
        joints = np.column_stack([self.chain.joints, bodies, self.data.rotor_inertia])
        return joints, self._offsets, self._mount, self.moves.astype(np.float64), np.array(self._pin.gravity.linear)

    def __repr__(self) -> str:
        return f"RobotModel({self.data.name!r}, n={self.n}, tool {self.data.tool_length} m)"

    def __reduce__(self) -> tuple[Any, ...]:
        return RobotModel, (self.data,)  # views into pinocchio's memory do not survive copying

    def state(self, q: ArrayLike, v: ArrayLike | None = None) -> RobotState:
        """Compute all terms at q (n,) [rad] and v (n,) [rad/s], by default 0. Raise a RobotError for a wrong q or v."""
        v = self._rest if v is None else v
        try:  # the core refuses wrong arrays; the messages are made below
            return RobotState(self.arm.terms(q, v), self.n)  # type: ignore[arg-type]
        except ValueError:
            q, v = self._numbers("q", q), self._numbers("v", v)
        for name, value in (("q", q), ("v", v)):
            if not np.isfinite(value).all():
                numbers = value.tolist()
                raise RobotError(f"{name} = {numbers} is not finite: check the sensor or code that it comes from")
        return RobotState(self.arm.terms(q, v), self.n)

    def mu_along(self, poses: Array) -> Array:
        """Compute the manipulability (k,) [m^3] at the poses (k,n) [rad]."""
        return self.arm.along(self._numbers("poses", poses, 2))[2]

    def tool_along(self, poses: Array) -> tuple[Array, Array]:
        """Compute tip and wrist, (k,3) each [m], at the poses (k,n) [rad]."""
        return self.arm.along(self._numbers("poses", poses, 2))[:2]

    def gravity(self, q: ArrayLike) -> Array:
        """Compute the gravity torque g (n,) [Nm]."""
        return self.state(q).gravity.copy()

    def tool_pose(self, q: ArrayLike) -> Array:
        """Compute the tool's pose (4,3): its axes x, y and z (from wrist to tip) in world axes, then the tip [m]."""
        return self.arm.tool_pose(self._numbers("q", q))

    @cached_property
    def chain(self) -> Chain:
        """The joints' placements and axes."""
        neutral = self._pin.createData()
        pin.computeJointJacobians(self._pin, neutral, np.zeros(self.n))
        prismatic = np.linalg.norm(neutral.J[3:], axis=0) < 0.5
        rows = np.where(prismatic, neutral.J[:3], neutral.J[3:])
        axes = np.array([neutral.oMi[j + 1].rotation.T @ rows[:, j] for j in range(self.n)])
        placements = list(self._pin.jointPlacements)[1:]
        rotations, origins = (np.array([getattr(at, of) for at in placements]) for of in ("rotation", "translation"))
        return Chain(rotations, origins, axes, prismatic, self._offsets)

    def kinematics(self) -> Kinematics:
        """Return CasADi functions of q, built at the first call."""
        return build_kinematics(self.data.name, self.chain)

    def random_regular_pose(self, rng: np.random.Generator, *, margin: float = 0.1, mu_min: float = 0.05) -> Array:
        """Draw a pose (n,) with mu > `mu_min` [m^3]. Each joint keeps `margin` times its range from both limits."""
        room = margin * (self.q_max - self.q_min)
        for _ in range(1000):
            q = rng.uniform(self.q_min + room, self.q_max - room)
            if self.state(q).mu > mu_min:
                return q
        raise RobotError(f"no pose with mu > {mu_min} in 1000 draws: lower mu_min or margin = {margin}")

    def _numbers(self, name: str, value: ArrayLike, dimensions: int = 1) -> Array:
        shape = f"({'k, ' if dimensions > 1 else ''}{self.n},)"
        try:
            array = np.array(value, dtype=np.float64, order="C")  # the core needs the order "C"
        except (TypeError, ValueError, OverflowError) as error:
            raise RobotError(f"{name} = {shown(value)} is not numeric: give numbers {shape}") from error
        if array.ndim != dimensions or array.shape[-1] != self.n:
            raise RobotError(f"{name} has shape {array.shape}: the arm has {self.n} joints, give {shape}")
        return array


def link_frames(robot: RobotModel, poses: Array) -> tuple[Array, Array]:
    """Return origins (k,n,3) [m] and rotations (k,n,3,3) of the joints' frames at poses (k,n)."""
    model, data = robot._pin, robot._pin.createData()
    joints = [data.oMi[j] for j in range(1, robot.n + 1)]  # references, which stay valid
    frames = np.empty((len(poses), robot.n, 4, 4))
    for k, pose in enumerate(np.asarray(poses, dtype=np.float64)):
        pin.forwardKinematics(model, data, pose)
        frames[k] = [joint.homogeneous for joint in joints]
    return frames[..., :3, 3], frames[..., :3, :3]


def load_robot(
    name_or_path: str | os.PathLike[str] = "lwr4", *, tool_length: float | None = None, tool_mass: float | None = None
) -> RobotModel:
    """Load a robot by name or path. Gains that its TOML lacks are derived from the arm's inertia.

    Args:
        name_or_path: an arm of the package, or a TOML or URDF file. A RobotError is raised for a wrong name or file.
        tool_length: length of the tool from mount to tip [m], by default as in the file.
        tool_mass: mass of the tool [kg], by default as in the file.
    """
    robot = RobotModel(load_data(name_or_path, tool_length=tool_length, tool_mass=tool_mass))
    if not CARTESIAN.keys() <= robot.data.gains.keys():
        robot.data = replace(robot.data, gains={**derived_gains(robot), **robot.data.gains})
    return robot


def _build(data: RobotData) -> Any:
    try:
        model = pin.buildModelFromXML(data.urdf)
    except (ValueError, RuntimeError) as error:
        raise RobotError(f"urdf of {data.name!r} cannot be read by pinocchio: {error}") from error
    names = tuple(model.names)[1:]
    if names != data.joint_names or model.nq != data.n:
        raise RobotError(f"urdf of {data.name!r}: pinocchio finds joints {names}, the robot lists {data.joint_names}")
    return model


def carried(robot: RobotModel) -> dict[str, Any]:
    """Return the robot's data as JSON values."""
    return {name: plain(value) for name, value in vars(robot.data).items()}


def restored(values: Mapping[str, Any]) -> RobotModel:
    """Rebuild a robot from the values of `carried`. Raise a RobotError if they are damaged."""
    try:
        arm = urdf.read(values["urdf"])
        urdf.normalize(arm)
        text = arm.to_text(values["name"])
        return RobotModel(RobotData(**{**values, "urdf": text, "joint_names": tuple(values["joint_names"])}))
    except (TypeError, ValueError, LookupError, AttributeError) as error:
        raise RobotError(f"the robot in the trace is damaged ({error}): save the trace anew") from error
