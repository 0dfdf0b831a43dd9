"""RobotModel: all terms of the control laws at one (q, v) of an arm, and gains for an arm that nobody has tuned.

Pinocchio reads the URDF; `moc_opt.core` computes the terms.

A gain on a joint's velocity over the inertia behind it is a rate [1/s]; the rate times the period decides whether a
sampled loop is stable (`largest_rate`). The LWR4+ is tuned: other arms get its rates, each joint in its own unit
(N m s/rad, or N s/m for a prismatic joint), and so the same distance from that limit.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from moc_opt import core
from moc_opt.arrays import Array, read_only
from moc_opt.errors import RobotError, shown
from moc_opt.robots import urdf
from moc_opt.robots.chain import Chain, Kinematics, build_kinematics
from moc_opt.robots.loader import RobotData, load_data
from moc_opt.robots.state import RobotState, record_size

__all__ = ["RobotModel", "RobotState", "load_robot"]

_DOUBLE, _CLOSE = np.dtype(np.float64), (8,)
_STRUCTURAL_ZERO = 1e-12  # a column this small at several random poses is zero at all of them

Table = dict[str, float | tuple[float, ...]]

JOINT_RATE = 12.0
"""K_N2 over the joint's inertia [1/s]: the LWR4+'s table has 10 to 22 over its joints, 12.5 on the last one."""
DAMPING_SHARE = 1.0 / 7.0  #: D_N2 over K_N2: the same table has 0.13 to 0.2.
JOINTS: Mapping[str, tuple[float, float, float]] = {
    "moc": (JOINT_RATE, DAMPING_SHARE, 125.0), "default": (JOINT_RATE, DAMPING_SHARE, 125.0),
    "tuned": (26.0, 0.087, 125.0), "robust": (17.0, 0.133, 85.0),
}  # fmt: skip
"""K_N2 over the joint's inertia [1/s], D_N2 over K_N2, and the most that both may be over the inertia of any motion
that keeps tip and wrist [1/s]. On the LWR4+ the self-motion's rate under "tuned" and "robust" is 2.16 and 1.41 times
that of "default" (median over random poses), and the largest are 94, 124 and 85/s."""
CARTESIAN_RATE = 160.0
"""Most that D_X or D_N may be over the lightest mass behind it [1/s]: a third of what three ticks of delay bear at
500 Hz. The LWR4+'s D_X has 90 over its lightest direction, its D_N 16."""
CARTESIAN: Mapping[str, tuple[float, float, float, float]] = {
    "dcac": (2000.0, 20.0, 600.0, 10.0), "moc": (3000.0, 30.0, 800.0, 10.0), "default": (3000.0, 80.0, 800.0, 60.0),
    "tuned": (3000.0, 80.0, 1670.0, 74.2), "robust": (3000.0, 50.0, 1670.0, 74.2),
}  # fmt: skip
"""K_X, D_X, K_N, D_N [N/m, N s/m]: Table I of Su et al. (2019), and those of the LWR4+'s file."""
_POSES = 16


class RobotModel:
    """The arm with its tool. `coriolis` and `gravity` share pinocchio's workspace: one thread at a time calls them.

    Attributes:
        data: what its files say, a `moc_opt.robots.RobotData`.
        n: number of joints.
        q_min, q_max: (n,) limits [rad; m where a joint slides].
        v_max: (n,) largest speeds [rad/s or m/s]; tau_max: (n,) largest torques [Nm or N].
        mount: (3,3) rows: the tool's axes x, y, z in the last joint's frame.
        moves: (2,n) which joints can move the tip (first row) and the wrist (second row) at all.
        arm: the same arm as the core's data.

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
        >>> np.allclose(robot.tool_pose(q)[3], state.tip), robot.mount.shape
        (True, (3, 3))
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
        if n > core.MAX_JOINTS:
            raise RobotError(f"{data.name!r} has {n} joints: at most {core.MAX_JOINTS} can be controlled")
        self._pin = _build(data)
        self._side_data = self._pin.createData()
        frames = [_frame(self._pin, name) for name in (data.tip_frame, data.wrist_frame)]
        self._offsets = read_only(np.array([frame.placement.translation for frame in frames]))
        self.mount = np.ascontiguousarray(frames[0].placement.rotation.T)
        if np.linalg.norm(self._offsets[0] - self._offsets[1]) < 1e-6:
            raise RobotError("tip and wrist frames coincide: lengthen the tool or move the wrist frame")
        self._shape, self._size, self._rest = (n,), record_size(n), np.zeros(n)
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
            self.chain.joints, np.array([_numbers(body) for body in inertias]),
            np.array(self.data.rotor_inertia, dtype=np.float64), self._offsets, self.mount,
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
            q, v = self._vector("q", q), self._vector("v", v)
            code = self.arm.terms(q, v, record)
        if code != core.OK:
            name, value = ("q", q) if code == core.BAD_Q else ("v", v)
            numbers = np.asarray(value).tolist()
            raise RobotError(f"{name} = {numbers} is not finite: check the sensor or step that gave it")
        return RobotState(record, self.n)

    def mu_along(self, poses: Array) -> Array:
        """Compute manipulability (k,) [m^3] at the poses (k,n) [rad], equal to that of `state` to the last bit.

        Raises:
            RobotError: another shape, or no numbers.
        """
        along = self._poses(poses)
        self.arm.mu_along(along, mu := np.empty(len(along)))
        return mu

    def tool_along(self, poses: Array) -> tuple[Array, Array]:
        """Compute tip and wrist, (k,3) each [m], at the poses (k,n) [rad].

        Raises:
            RobotError: another shape, or no numbers.
        """
        along = self._poses(poses)
        points = np.empty((2, len(along), 3))
        self.arm.points_along(along, self._offsets, points.reshape(-1, 3))
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
        self.arm.tool_pose(self._vector("q", q), pose)
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
        return self._kinematics

    @cached_property
    def _kinematics(self) -> Kinematics:
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

    def _vector(self, name: str, value: ArrayLike) -> Array:
        is_close = isinstance(value, np.ndarray) and value.dtype is _DOUBLE and value.strides == _CLOSE
        if isinstance(value, np.ndarray) and is_close and value.shape == self._shape:
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

    Tables of gains that its TOML does not have are derived from its inertia (`derived_gains`).

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
    names = tuple(model.names)[1:]
    if names != data.joint_names or model.nq != data.n:
        raise RobotError(f"urdf of {data.name!r}: {names} and {data.joint_names} must be the same serial chain")
    model.armature = data.rotor_inertia.copy()
    return model


def _frame(model: Any, name: str) -> Any:
    if not model.existFrame(name, pin.FrameType.BODY):
        raise RobotError(f"frame {name!r} is no link of the urdf: its links are {[f.name for f in model.frames]}")
    frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
    if frame.parentJoint != model.njoints - 1:
        raise RobotError(f"frame {name!r} does not ride on the last joint: fix it to the last link")
    return frame


# --- in a trace ---


def carried(robot: RobotModel) -> dict[str, Any]:
    """Return the robot as values that JSON can hold, so that a run of an arm of one's own replays anywhere."""
    values = {field.name: getattr(robot.data, field.name) for field in fields(robot.data)}
    values = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in values.items()}
    return {**values, "joint_names": list(robot.data.joint_names)}


def restored(values: Mapping[str, Any]) -> RobotModel:
    """Make the robot of what `carried` gave.

    Raises:
        RobotError: a field is missing, unknown or of another kind, or the URDF is no such arm.
    """
    try:
        root = urdf.rebuild(urdf.parse(values["urdf"]), values["name"])
        given = {**values, "urdf": urdf.to_text(root), "joint_names": tuple(values["joint_names"])}
        return RobotModel(RobotData(**given))
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        raise RobotError(f"the robot in the trace is damaged ({error}): save the trace anew") from error


# --- gains ---


def derived_gains(robot: RobotModel) -> dict[str, Table]:
    """Derive the tables "dcac", "moc", "default", "tuned" and "robust" from the arm's inertia.

    K_N2_i is a rate times M_ii at the home pose, and D_N2 a share of it (`JOINTS`), the rate smaller where the null
    space would exceed its largest. K_X and D_X (K_N, D_N) are those of the
    LWR4+, both smaller by the same share where the arm is so light that D_X (D_N) would exceed `CARTESIAN_RATE`.

    Args:
        robot: the arm; it needs no gains.
    """
    inertia = np.diag(robot.state(robot.data.q_home).M)
    inverse_masses = largest_inverse_masses(robot)
    tables: dict[str, Table] = {}
    for name, cartesian in CARTESIAN.items():
        tables[name] = {}
        for letter, inverse, (K, D) in zip("XN", inverse_masses, (cartesian[:2], cartesian[2:]), strict=True):
            share = min(1.0, CARTESIAN_RATE / (D * inverse))
            tables[name] |= {f"K_{letter}": _rounded(share * K), f"D_{letter}": _rounded(share * D)}
        if name in JOINTS:
            rate, share, most = JOINTS[name]
            rate *= min(1.0, most / largest_null_rate(robot, (1.0 + share) * rate * inertia))
            joints = tuple(_rounded(rate * float(m)) for m in inertia)
            tables[name] |= {"K_N2": joints, "D_N2": tuple(_rounded(share * gain) for gain in joints)}
    return tables


def largest_inverse_masses(robot: RobotModel) -> tuple[float, float]:
    """Return the largest eigenvalue of J M^-1 J^T [1/kg] at tip and wrist, over the poses of `surveyed`."""
    found = [
        [np.linalg.eigvalsh(J @ np.linalg.solve(state.M, J.T))[-1] for J in (state.J_tip, state.J_wrist)]
        for state in surveyed(robot)
    ]
    tip, wrist = np.max(found, axis=0).tolist()
    return tip, wrist


def largest_null_rate(robot: RobotModel, gains: Array) -> float:
    """Return the largest eigenvalue of (Z M Z^T)^-1 Z G Z^T [1/s], G = diag(gains (n,)), Z a basis of ker A, there."""
    found = 0.0
    for state in surveyed(robot):
        _, values, rows = np.linalg.svd(state.A)
        Z = rows[int(np.sum(values > 1e-6 * values[0])) :]
        if len(Z):
            rates = np.linalg.eigvals(np.linalg.solve(Z @ state.M @ Z.T, Z @ (gains[:, None] * Z.T)))
            found = max(found, float(rates.real.max()))
    return found


def surveyed(robot: RobotModel) -> Iterator[RobotState]:
    """Yield the states at the home pose and at seeded poses of the range: the worst case of a gain is over these."""
    rng = np.random.default_rng(0)
    for q in [robot.data.q_home, *rng.uniform(robot.q_min, robot.q_max, (_POSES, robot.n))]:
        yield robot.state(q)


def largest_rate(period_s: float, delay_ticks: int) -> float:
    """Return the largest rate [1/s] of a velocity gain over an inertia at which a sampled loop is stable.

    A velocity v[k+1] = v[k] - T rate v[k-d] decays while T rate < 2 sin(pi / (2 (2 d + 1))): 2, 1, 0.62, 0.45 for no,
    one, two and three ticks d of delay (Levin and May, 1976).

    Args:
        period_s: T [s].
        delay_ticks: d, from measurement to torque; a filter of the velocity counts as its own delay in ticks.
    """
    return 2.0 * math.sin(math.pi / (2.0 * (2.0 * delay_ticks + 1.0))) / period_s


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")  # a gain is a choice
