"""pink: differential inverse kinematics with pinocchio and a QP, Caron et al.; joint velocities."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from pink import Configuration, solve_ik
from pink.tasks import FrameTask, ManipulabilityTask

from benchmarks.baselines.job import CLIMB, STIFFNESS_PER_S, Level, tip_gradient, wrist_reference
from moc_opt.arrays import Array
from moc_opt.robots.model import RobotModel

SOLVER = "daqp"
RISE_PER_S = 0.05  # of the manipulability [m^3/s]
RISE_COST = 0.02


class _Arm:
    """The model and one configuration, updated in place."""

    def __init__(self, robot: RobotModel) -> None:
        self.model = pin.buildModelFromXML(robot.data.urdf)
        data = self.model.createData()
        self.configuration = Configuration(self.model, data, np.array(robot.data.q_home), copy_data=False)
        self.data = data
        self.tip = self.model.getFrameId(robot.data.tip_frame, pin.FrameType.BODY)
        self.wrist = self.model.getFrameId(robot.data.wrist_frame, pin.FrameType.BODY)
        self.span = robot.state(robot.data.q_home).tool_span


class Pink:
    """The library's own tasks: FrameTask on tip and wrist, ManipulabilityTask."""

    level: Level = "velocity"

    def __init__(self, robot: RobotModel, period_s: float) -> None:
        self._arm, self._period = _Arm(robot), period_s
        gain = min(1.0, STIFFNESS_PER_S * period_s)
        self._tip = FrameTask(robot.data.tip_frame, position_cost=1.0, orientation_cost=0.0, gain=gain)
        self._wrist = FrameTask(robot.data.wrist_frame, position_cost=1.0, orientation_cost=0.0, gain=gain)
        climb = ManipulabilityTask(
            robot.data.tip_frame, self._arm.model, cost=RISE_COST, manipulability_rate=RISE_PER_S * period_s,
            mask="position",
        )  # fmt: skip
        self._tasks = (self._tip, self._wrist, climb)
        self._turn = self._arm.data.oMf[self._arm.tip].rotation.copy()

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        arm = self._arm
        arm.configuration.update(q)
        # Each target is where the reference will be when the gain has done its share.
        wrist, wrist_rate = wrist_reference(tip_ref, trocar, arm.span)
        self._tip.set_target(pin.SE3(self._turn, tip_ref[0] + tip_ref[1] / STIFFNESS_PER_S))
        self._wrist.set_target(pin.SE3(self._turn, wrist + wrist_rate / STIFFNESS_PER_S))
        found: Array = solve_ik(
            arm.configuration, self._tasks, self._period, solver=SOLVER, damping=1e-8, safety_break=False
        )
        return found


class _Rows:
    """A constraint for pink: hard rows that are filled from outside."""

    def __init__(self, jacobian: Array, error: Array, gain: float) -> None:
        self._jacobian, self._error, self.gain = jacobian, error, gain

    def compute_error(self, configuration: Any) -> Array:
        return self._error

    def compute_jacobian(self, configuration: Any) -> Array:
        return self._jacobian


class _Climb:
    """A task for pink: a linear cost along the gradient of the manipulability, bounded by the solver's damping."""

    def __init__(self, n: int, period_s: float) -> None:
        self._zero, self._step, self.gradient = np.zeros((n, n)), CLIMB * period_s, np.zeros(n)

    def compute_qp_objective(self, configuration: Any) -> tuple[Array, Array]:
        return self._zero, -self._step * self.gradient


class PinkTrimmed:
    """Tip and shaft as five hard equality rows, and our compiled gradient in place of ManipulabilityTask."""

    level: Level = "velocity"

    def __init__(self, robot: RobotModel, period_s: float) -> None:
        self._arm, self._period = _Arm(robot), period_s
        gain = min(1.0, STIFFNESS_PER_S * period_s)
        self._jacobian, self._error = np.zeros((5, robot.n)), np.zeros(5)
        self._rows = (_Rows(self._jacobian, self._error, gain),)
        self._climb, self._gradient = _Climb(robot.n, period_s), tip_gradient(robot)
        self._tasks = (self._climb,)

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        arm = self._arm
        arm.configuration.update(q)
        wrist, wrist_rate = wrist_reference(tip_ref, trocar, arm.span)
        places, local = arm.data.oMf, pin.ReferenceFrame.LOCAL
        tip, joint = places[arm.tip], places[arm.wrist]
        # In the tool's own axes, its z along the shaft: of the wrist's rows only those across it.
        turn = tip.rotation.T
        self._jacobian[:3] = pin.getFrameJacobian(arm.model, arm.data, arm.tip, local)[:3]
        self._jacobian[3:] = pin.getFrameJacobian(arm.model, arm.data, arm.wrist, local)[:2]
        self._error[:3] = turn @ (tip.translation - tip_ref[0] - tip_ref[1] / STIFFNESS_PER_S)
        self._error[3:] = (turn @ (joint.translation - wrist - wrist_rate / STIFFNESS_PER_S))[:2]
        self._climb.gradient = self._gradient(q)
        found: Array = solve_ik(
            arm.configuration, self._tasks, self._period, solver=SOLVER, damping=1.0, constraints=self._rows,
            safety_break=False,
        )  # fmt: skip
        return found
