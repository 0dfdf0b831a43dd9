"""mink: differential inverse kinematics on MuJoCo, Zakka et al.; joint velocities.

FrameTask on the tip, LookAtTask along the shaft at the trocar, our compiled gradient as a task: mink has none.
"""

from __future__ import annotations

from typing import Any, Literal

import mink
import numpy as np

from benchmarks.baselines.base import CLIMB, STIFFNESS_PER_S, TipGradient
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.sim.mjcf import build_spec, compile_model

SOLVER = "daqp"
COST = 1e3  # of tip and shaft against a damping of one


class _Climb(mink.tasks.BaseTask):  # type: ignore[misc]
    """A linear cost along the gradient of the manipulability; the solver's damping bounds it."""

    def __init__(self, robot: RobotModel, period_s: float) -> None:
        self._gradient, self._step, self._zero = (TipGradient(robot), CLIMB * period_s, np.zeros((robot.n, robot.n)))

    def compute_qp_objective(self, configuration: Any) -> Any:
        """Return H (n, n) and c (n,)."""
        return mink.tasks.Objective(self._zero, -self._step * self._gradient(configuration.data.qpos))


class Mink:
    """mink's tasks, its configuration and velocity limits, daqp."""

    level: Literal["torque", "velocity"] = "velocity"

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
        """Return the joint velocities (n,) [rad/s]."""
        self._configuration.update(q)
        aim = tip_ref[0] + tip_ref[1] / STIFFNESS_PER_S
        self._tip.set_target(mink.SE3.from_rotation_and_translation(self._turn, aim))
        self._shaft.set_target(trocar[0])
        found: Array = mink.solve_ik(
            self._configuration, self._tasks, self._period, SOLVER, damping=1.0, limits=self._limits
        )
        return found
