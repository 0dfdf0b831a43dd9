"""TSID: task-space inverse dynamics, Del Prete et al. 2016; accelerations by a QP, torques from them.

Level 0 (hard): three rows for the tip, two for the wrist across the shaft, joint speeds. Level 1: accelerations
towards the gradient of the manipulability.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.baselines.job import CLIMB, Level, tip_gradient, wrist_reference
from moc_opt.arrays import Array
from moc_opt.robots.model import RobotModel

with warnings.catch_warnings():  # it registers two of its types twice, and says so
    warnings.simplefilter("ignore", RuntimeWarning)
    import tsid

STIFFNESS, DAMPING = 2500.0, 100.0  # [1/s^2], [1/s]: critically damped at 50 rad/s
CLIMB_DAMPING = 20.0  # [1/s] of the velocity error along the gradient


class TSID:
    """InverseDynamicsFormulationAccForce with SolverHQuadProgFast."""

    level: Level = "torque"

    def __init__(self, robot: RobotModel, period_s: float) -> None:
        model = pin.buildModelFromXML(robot.data.urdf)
        model.armature = robot.data.rotor_inertia.copy()
        self._robot = tsid.RobotWrapper(model, tsid.FIXED_BASE_SYSTEM, False)
        self._dynamics = tsid.InverseDynamicsFormulationAccForce("tsid", self._robot, False)
        rest = np.zeros(robot.n)
        self._dynamics.computeProblemData(0.0, robot.data.q_home, rest)
        self._tip = self._point("tip", robot.data.tip_frame, [1, 1, 1, 0, 0, 0])
        # Across the shaft only: the row along it repeats the tip's, and hard rows must be independent.
        self._wrist = self._point("wrist", robot.data.wrist_frame, [1, 1, 0, 0, 0, 0])
        self._posture = tsid.TaskJointPosture("posture", self._robot)
        self._posture.setKp(rest)
        self._posture.setKd(np.full(robot.n, CLIMB_DAMPING))
        self._dynamics.addMotionTask(self._posture, 1.0, 1, 0.0)
        bounds = tsid.TaskJointBounds("speed", self._robot, period_s)
        bounds.setVelocityBounds(-robot.v_max, robot.v_max)
        self._dynamics.addMotionTask(bounds, 1.0, 0, 0.0)
        self._solver = tsid.SolverHQuadProgFast("eiquadprog")
        self._solver.resize(self._dynamics.nVar, self._dynamics.nEq, self._dynamics.nIn)
        self._keep = bounds  # the formulation holds a reference only
        self._point_sample, self._joint_sample = tsid.TrajectorySample(12, 6), tsid.TrajectorySample(robot.n)
        self._value, self._rate, self._second = np.zeros(12), np.zeros(6), np.zeros(6)
        self._value[3::4] = 1.0  # the rotation is masked out, but must be one
        self._joint_sample.value(rest)
        self._joint_sample.second_derivative(rest)
        self._gradient, self._span = tip_gradient(robot), robot.state(robot.data.q_home).tool_span

    def _point(self, name: str, frame: str, mask: list[int]) -> Any:
        task = tsid.TaskSE3Equality(name, self._robot, frame)
        task.setKp(np.full(6, STIFFNESS))
        task.setKd(np.full(6, DAMPING))
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
        problem = self._dynamics.computeProblemData(0.0, q, v)
        found = self._solver.solve(problem)
        torque: Array = self._dynamics.getActuatorForces(found)
        return torque

    def _aim(self, task: Any, point: Array, rate: Array, second: Array) -> None:
        self._value[:3], self._rate[:3], self._second[:3] = point, rate, second
        sample = self._point_sample
        sample.value(self._value)
        sample.derivative(self._rate)
        sample.second_derivative(self._second)
        task.setReference(sample)
