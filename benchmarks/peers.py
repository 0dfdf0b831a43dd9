"""The work of one control tick, done by other libraries (peers).

Tip and shaft follow their references within speed limits, and the null-space motion climbs mu.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from moc_opt import core
from moc_opt.arrays import Array
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.sim.mjcf import build_spec, compile_model
from moc_opt.tasks import Reference, Trocar, make_path, shaft_distance

Inputs = tuple[Array, Array, Array, Array]
"""q, v, tip reference and trocar"""
Level = Literal["torque", "velocity"]

PERIOD_S = 0.002
TOLERANCE_MM, CLIMB_PERCENT = 0.5, 1.0  # a sound peer's largest error of tip or shaft, and least rise of mu
CLIMB = 30.0
"""wanted null-space velocity of the joints / grad mu [rad^2/(m^3 s)]"""
STIFFNESS_PER_S = 100.0
"""decay rate of tip and shaft errors under pink and mink"""


class Peer(Protocol):
    """A controller of another library, with the period ``PERIOD_S``."""

    @property
    def level(self) -> Level:
        """Whether `tick` returns torques or velocities."""

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """Return torques [Nm] or velocities [rad/s] (n,). tip_ref has rows X_d, dX_d, ddX_d, trocar has P_t, dP_t."""


def tip_gradient(robot: RobotModel) -> Callable[[Array], Array]:
    rest = np.zeros(robot.n)
    return lambda q: robot.state(np.ascontiguousarray(q), rest).grad_mu


def ahead(point: Array, rate: Array) -> Array:
    """Return the reference extrapolated by the time constant 1 / STIFFNESS_PER_S, to cancel the lag."""
    return point + rate / STIFFNESS_PER_S


def wrist_reference(tip_ref: Array, trocar: Array, span: float) -> Array:
    """Return the wrist's position [m] and velocity [m/s] (2, 3) for which the shaft passes through the trocar.

    ``span`` is the distance from wrist to tip [m].
    """
    return core.desired_wrist(tip_ref[0], tip_ref[1], trocar, span)


class TSID:
    """Task-space inverse dynamics (Del Prete et al. 2016): a QP finds accelerations."""

    level: Level = "torque"
    STIFFNESS, DAMPING = 2500.0, 100.0  # gains on errors of tip and wrist [1/s^2] and on their rates [1/s]
    CLIMB_DAMPING = 20.0  # acceleration per error of the joint velocity [1/s]

    def __init__(self, robot: RobotModel) -> None:
        with warnings.catch_warnings():  # tsid registers two types twice
            warnings.simplefilter("ignore", RuntimeWarning)
            import tsid
        model = pin.buildModelFromXML(robot.data.urdf)
        model.armature = robot.data.rotor_inertia.copy()
        self._tsid, self._robot = tsid, tsid.RobotWrapper(model, tsid.FIXED_BASE_SYSTEM, False)
        self._dynamics = tsid.InverseDynamicsFormulationAccForce("tsid", self._robot, False)
        rest = np.zeros(robot.n)
        self._dynamics.computeProblemData(0.0, robot.data.q_home, rest)
        self._tip = self._point("tip", robot.data.tip_frame, [1, 1, 1, 0, 0, 0])
        # The wrist's row along the shaft is left out: it repeats the tip's, and hard rows must be independent.
        self._wrist = self._point("wrist", robot.data.wrist_frame, [1, 1, 0, 0, 0, 0])
        self._posture = tsid.TaskJointPosture("posture", self._robot)
        self._posture.setKp(rest)
        self._posture.setKd(np.full(robot.n, self.CLIMB_DAMPING))
        self._dynamics.addMotionTask(self._posture, 1.0, 1, 0.0)
        self._bounds = tsid.TaskJointBounds("speed", self._robot, PERIOD_S)  # kept here, because tsid keeps no copy
        self._bounds.setVelocityBounds(-robot.v_max, robot.v_max)
        self._dynamics.addMotionTask(self._bounds, 1.0, 0, 0.0)
        self._solver = tsid.SolverHQuadProgFast("eiquadprog")
        self._solver.resize(self._dynamics.nVar, self._dynamics.nEq, self._dynamics.nIn)
        self._point_sample, self._joint_sample = tsid.TrajectorySample(12, 6), tsid.TrajectorySample(robot.n)
        self._value, self._rate, self._second = np.zeros(12), np.zeros(6), np.zeros(6)
        self._value[3::4] = 1.0  # the rotation is unused, but must be valid
        self._joint_sample.value(rest)
        self._joint_sample.second_derivative(rest)
        self._gradient, self._span = tip_gradient(robot), robot.state(robot.data.q_home).tool_span

    def _point(self, name: str, frame: str, mask: list[int]) -> Any:
        task = self._tsid.TaskSE3Equality(name, self._robot, frame)
        task.setKp(np.full(6, self.STIFFNESS))
        task.setKd(np.full(6, self.DAMPING))
        task.useLocalFrame(True)
        task.setMask(np.array(mask, dtype=float))
        self._dynamics.addMotionTask(task, 1.0, 0, 0.0)
        return task

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        wrist, wrist_rate = wrist_reference(tip_ref, trocar, self._span)
        self._aim(self._tip, tip_ref[0], tip_ref[1], tip_ref[2])
        self._aim(self._wrist, wrist, wrist_rate, tip_ref[2])
        self._joint_sample.derivative(CLIMB * self._gradient(q))
        self._posture.setReference(self._joint_sample)
        found = self._solver.solve(self._dynamics.computeProblemData(0.0, q, v))
        torque: Array = self._dynamics.getActuatorForces(found)
        return torque

    def _aim(self, task: Any, point: Array, rate: Array, second: Array) -> None:
        self._value[:3], self._rate[:3], self._second[:3] = point, rate, second
        sample = self._point_sample
        sample.value(self._value)
        sample.derivative(self._rate)
        sample.second_derivative(self._second)
        task.setReference(sample)


class _PinkArm:
    level: Level = "velocity"
    GAIN = min(1.0, STIFFNESS_PER_S * PERIOD_S)

    def __init__(self, robot: RobotModel) -> None:
        from pink import Configuration, solve_ik

        self._solve = solve_ik
        self.model = pin.buildModelFromXML(robot.data.urdf)
        self.data = self.model.createData()
        self.configuration = Configuration(self.model, self.data, np.array(robot.data.q_home), copy_data=False)
        self.tip, self.wrist = (
            self.model.getFrameId(name, pin.FrameType.BODY) for name in (robot.data.tip_frame, robot.data.wrist_frame)
        )
        self.span = robot.state(robot.data.q_home).tool_span

    def solved(self, tasks: Any, damping: float, **options: Any) -> Array:
        found: Array = self._solve(
            self.configuration, tasks, PERIOD_S, solver="daqp", damping=damping, safety_break=False, **options
        )
        return found


class Pink(_PinkArm):
    """Differential inverse kinematics (Caron et al.), with pink's own tasks only."""

    RISE_PER_S, RISE_COST = 0.05, 0.02  # wanted rise of mu [m^3/s], and its weight

    def __init__(self, robot: RobotModel) -> None:
        from pink.tasks import FrameTask, ManipulabilityTask

        super().__init__(robot)
        self._tip, self._wrist = (
            FrameTask(name, position_cost=1.0, orientation_cost=0.0, gain=self.GAIN)
            for name in (robot.data.tip_frame, robot.data.wrist_frame)
        )
        self._climb = ManipulabilityTask(
            robot.data.tip_frame, self.model, cost=self.RISE_COST, manipulability_rate=self.RISE_PER_S * PERIOD_S,
            mask="position",
        )  # fmt: skip
        self._turn = self.data.oMf[self.tip].rotation.copy()

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        self.configuration.update(q)
        self._tip.set_target(pin.SE3(self._turn, ahead(*tip_ref[:2])))
        self._wrist.set_target(pin.SE3(self._turn, ahead(*wrist_reference(tip_ref, trocar, self.span))))
        return self.solved((self._tip, self._wrist, self._climb), damping=1e-8)


class _Rows:
    """Five equality constraints for pink, set in each tick."""

    def __init__(self, n: int, gain: float) -> None:
        self.jacobian, self.error, self.gain = np.zeros((5, n)), np.zeros(5), gain

    def compute_error(self, configuration: Any) -> Array:
        return self.error

    def compute_jacobian(self, configuration: Any) -> Array:
        return self.jacobian


class _Climb:
    """A linear cost along the gradient of mu, for pink and mink."""

    def __init__(self, robot: RobotModel, objective: Callable[..., Any], q_of: Callable[[Any], Array]) -> None:
        self._objective, self._q_of = objective, q_of
        self._zero, self._gradient = np.zeros((robot.n, robot.n)), tip_gradient(robot)

    def compute_qp_residual(self, configuration: Any) -> None:
        """Return nothing, so that mink calls `compute_qp_objective`."""

    def compute_qp_objective(self, configuration: Any) -> Any:
        return self._objective(self._zero, -CLIMB * PERIOD_S * self._gradient(self._q_of(configuration)))


class PinkTrimmed(_PinkArm):
    """pink with five equality constraints and moc_opt's compiled gradient."""

    def __init__(self, robot: RobotModel) -> None:
        super().__init__(robot)
        self._rows = _Rows(robot.n, self.GAIN)
        self._climb = _Climb(robot, lambda H, c: (H, c), lambda configuration: configuration.q)

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        self.configuration.update(q)
        wrist = ahead(*wrist_reference(tip_ref, trocar, self.span))
        places, local, rows = self.data.oMf, pin.ReferenceFrame.LOCAL, self._rows
        tip, joint = places[self.tip], places[self.wrist]
        # In the tool's axes, z is along the shaft.
        turn = tip.rotation.T
        rows.jacobian[:3] = pin.getFrameJacobian(self.model, self.data, self.tip, local)[:3]
        rows.jacobian[3:] = pin.getFrameJacobian(self.model, self.data, self.wrist, local)[:2]
        rows.error[:3] = turn @ (tip.translation - ahead(*tip_ref[:2]))
        rows.error[3:] = (turn @ (joint.translation - wrist))[:2]
        return self.solved((self._climb,), damping=1.0, constraints=(rows,))


class Mink:
    """Differential inverse kinematics on MuJoCo (Zakka et al.)."""

    level: Level = "velocity"
    COST = 1e3  # weight of the tip and shaft tasks

    def __init__(self, robot: RobotModel) -> None:
        import mink

        model = compile_model(robot.data.name, build_spec(robot.data, substep_s=1e-3))
        self._mink, self._configuration = mink, mink.Configuration(model, np.array(robot.data.q_home))
        tip, gain = robot.data.tip_frame, min(1.0, STIFFNESS_PER_S * PERIOD_S)
        self._tip = mink.FrameTask(tip, "body", position_cost=self.COST, orientation_cost=0.0, gain=gain)
        # The tip's -z axis points at the trocar.
        self._shaft = mink.LookAtTask(tip, "body", axis=(0.0, 0.0, -1.0), cost=self.COST, gain=gain)
        climb = _Climb(robot, mink.tasks.Objective, lambda configuration: configuration.data.qpos)
        self._tasks = (self._tip, self._shaft, climb)
        speeds = dict(zip(robot.data.joint_names, robot.v_max.tolist(), strict=True))
        self._limits = (mink.ConfigurationLimit(model), mink.VelocityLimit(model, speeds))
        self._turn = self._configuration.get_transform_frame_to_world(tip, "body").rotation()

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        self._configuration.update(q)
        self._tip.set_target(self._mink.SE3.from_rotation_and_translation(self._turn, ahead(*tip_ref[:2])))
        self._shaft.set_target(trocar[0])
        found: Array = self._mink.solve_ik(
            self._configuration, self._tasks, PERIOD_S, "daqp", damping=1.0, limits=self._limits
        )
        return found


PEERS: dict[str, Callable[[RobotModel], Peer]] = {"tsid": TSID, "pink": Pink, "pink-trimmed": PinkTrimmed, "mink": Mink}
INSTALL = {"tsid": "build it from source against the installed pinocchio; the wheel lacks a library that it links to"}


def missing(name: str) -> str | None:
    package = name.partition("-")[0]
    install = INSTALL.get(package, "pip install '.[peers]' in the clone")
    return None if find_spec(package) else f"package {package!r} is not installed: {install}"


# --- the check ---


class Task(NamedTuple):
    """Start pose (n,) [rad], tip references (N, 3, 3) and trocar (N, 2, 3) of N ticks."""

    q_start: Array
    tip_refs: Array
    trocars: Array


class Verdict(NamedTuple):
    tip_error_max_mm: float
    rcm_error_max_mm: float
    mu_rise_percent: float

    @property
    def failure(self) -> str | None:
        for what, off in (("tip", self.tip_error_max_mm), ("shaft", self.rcm_error_max_mm)):
            if not off <= TOLERANCE_MM:
                return f"the {what} is off by {off:.3g} mm; at most {TOLERANCE_MM} mm are allowed"
        if not self.mu_rise_percent >= CLIMB_PERCENT:
            return f"the manipulability rose by {self.mu_rise_percent:.3g} %, at least {CLIMB_PERCENT} % are needed"
        return None


def circle(robot: RobotModel, duration_s: float = 1.0, offset_m: float = 2e-4) -> Task:
    """Return the task of a horizontal circle that starts ``offset_m`` above the tip's home."""
    state = robot.state(robot.data.q_home)
    start = state.tip + np.array([0.0, 0.0, offset_m])
    path = make_path("circle", start, normal=(0.0, 0.0, 1.0), heading=(1.0, 0.0, 0.0), radius=0.03)
    t = PERIOD_S * np.arange(round(duration_s / PERIOD_S))
    trocar = Trocar(state.tip - 0.15 * state.tool_direction)
    return Task(state.q.copy(), np.stack(Reference(path, 0.05, 0.2).at(t), axis=1), np.stack(trocar.at(t), axis=1))


def perform(peer: Peer, robot: RobotModel, task: Task) -> tuple[Array, list[Inputs]]:
    """Return the poses (N, n) after each tick, and the ticks' inputs. The arm does exactly what the peer asks for."""
    q, v = task.q_start.copy(), np.zeros(robot.n)
    poses, given = np.empty((len(task.tip_refs), robot.n)), []
    for k in range(len(poses)):
        given.append((q, v, task.tip_refs[k], task.trocars[k]))
        asked = peer.tick(*given[-1])
        if peer.level == "torque":
            state = robot.state(q, v)
            v = v + PERIOD_S * np.linalg.solve(state.M, asked - state.h)
        else:
            v = np.array(asked)
        q = q + PERIOD_S * v
        poses[k] = q
    return poses, given


def verdict(poses: Array, robot: RobotModel, task: Task) -> Verdict:
    if not np.isfinite(poses).all():
        return Verdict(np.inf, np.inf, -100.0)
    late = slice(len(poses) // 2, None)  # errors are judged in the second half
    states = [robot.state(q) for q in poses[late]]
    tips, wrists = (np.array([getattr(state, name) for state in states]) for name in ("tip", "wrist"))
    wanted = np.roll(task.tip_refs[:, 0], -1, axis=0)[late]  # a pose is reached at the start of the next tick
    off = np.linalg.norm(tips - wanted, axis=1)[:-1]
    aside = shaft_distance(tips, wrists, task.trocars[late, 0])
    before = robot.state(task.q_start).mu
    return Verdict(1e3 * float(off.max()), 1e3 * float(aside.max()), 100.0 * (states[-1].mu / before - 1.0))


def check(name: str) -> str | None:
    """Run a peer on the default arm. Return how it fails, or None.

    Call this in a separate process, because a wheel built against other library versions can crash Python.
    """
    robot = load_robot()
    task = circle(robot)
    return verdict(perform(PEERS[name](robot), robot, task)[0], robot, task).failure
