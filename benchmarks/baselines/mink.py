"""mink: differential inverse kinematics on MuJoCo, Zakka et al.; joint velocities.

FrameTask on the tip, LookAtTask along the shaft at the trocar, our compiled gradient as a task: mink has none.
"""

from __future__ import annotations

from typing import Any

import mink
import numpy as np

from benchmarks.baselines.job import CLIMB, STIFFNESS_PER_S, Level, tip_gradient
from moc_opt.arrays import Array
from moc_opt.robots.model import RobotModel
from moc_opt.sim.mjcf import build_spec, compile_model

SOLVER = "daqp"
COST = 1e3  # of tip and shaft against a damping of one


class _Climb:
    """A task for mink: a linear cost along the gradient of the manipulability, bounded by the solver's damping."""

    def __init__(self, robot: RobotModel, period_s: float) -> None:
        self._gradient, self._step, self._zero = tip_gradient(robot), CLIMB * period_s, np.zeros((robot.n, robot.n))

    def compute_qp_residual(self, configuration: Any) -> None:
        """Its cost is no least-squares problem."""

    def compute_qp_objective(self, configuration: Any) -> Any:
        return mink.tasks.Objective(self._zero, -self._step * self._gradient(configuration.data.qpos))


class Mink:
    """mink's tasks, its configuration and velocity limits, daqp."""

    level: Level = "velocity"

    def __init__(self, robot: RobotModel, period_s: float) -> None:
        model = compile_model(robot.data.name, build_spec(robot.data, substep_s=1e-3))
        self._configuration, self._period = mink.Configuration(model, np.array(robot.data.q_home)), period_s
        gain = min(1.0, STIFFNESS_PER_S * period_s)
        tip = robot.data.tip_frame
        self._tip = mink.FrameTask(tip, "body", position_cost=COST, orientation_cost=0.0, gain=gain)
        # The wrist sees the trocar from behind, the tip from below: either way the shaft lies on the line.
        self._shaft = mink.LookAtTask(tip, "body", axis=(0.0, 0.0, -1.0), cost=COST, gain=gain)
        self._tasks = (self._tip, self._shaft, _Climb(robot, period_s))
        speeds = dict(zip(robot.data.joint_names, robot.v_max.tolist(), strict=True))
        self._limits = (mink.ConfigurationLimit(model), mink.VelocityLimit(model, speeds))
        self._turn = self._configuration.get_transform_frame_to_world(tip, "body").rotation()

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        self._configuration.update(q)
        aim = tip_ref[0] + tip_ref[1] / STIFFNESS_PER_S
        self._tip.set_target(mink.SE3.from_rotation_and_translation(self._turn, aim))
        self._shaft.set_target(trocar[0])
        found: Array = mink.solve_ik(
            self._configuration, self._tasks, self._period, SOLVER, damping=1.0, limits=self._limits
        )
        return found
