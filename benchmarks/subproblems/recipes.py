"""Where the problems of each test set come from: recorded runs, and random arm poses of one kind each."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.subproblems.testset import changed
from moc_opt.control.null_space import consistent_wrist_velocity, velocity_damper
from moc_opt.model.robot_model import RobotModel
from moc_opt.model.shaft_kernels import desired_wrist
from moc_opt.numerics.arrays import Array
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.scenario import Scenario, run

Rng = np.random.Generator

SIZE = 128  # problems a set


def at_pose(
    robot: RobotModel, q: Array, v_tip: Array, *, regularization: float = 1e-5, k0: float = 2.0, depth: float = 0.15
) -> NullSpaceQP:
    """Build the subproblem of an arm at q whose shaft passes the trocar ``depth`` above the tip, for a tip velocity."""
    state = robot.state(q)
    trocar = state.tip - depth * state.tool_direction
    _, v_wrist = desired_wrist(state.tip, v_tip, trocar, np.zeros(3), state.tool_span)
    lower, upper = np.empty(robot.n), np.empty(robot.n)
    velocity_damper(q, np.array([robot.q_min, robot.q_max, robot.v_max]), k0, lower, upper)
    v_wrist = consistent_wrist_velocity(v_tip, v_wrist, state.tool_direction)
    return NullSpaceQP(
        state.J_tip, state.J_wrist, v_tip, v_wrist, state.grad_mu, lower=lower, upper=upper, q=q,
        regularization=regularization,
    )  # fmt: skip


# Of the control law that was recorded, whatever the defaults become: the elbow travels as fast as its joints can.
RECORDED = {"speed_fraction": 1.0, "limit_margin_rad": 0.0, "ramp_s": 0.0}


def sequence(task: str, regularization: float) -> Callable[[RobotModel, Rng], Iterator[NullSpaceQP]]:
    """Yield a 500 Hz sequence, from the middle of the elbow's travel in a closed-loop run."""

    def make(robot: RobotModel, rng: Rng) -> Iterator[NullSpaceQP]:
        scenario = Scenario(
            task={"path": task}, control={**RECORDED, "regularization": regularization}, start={"swivel": "random"},
            seed=int(rng.integers(1000)), duration_s=1.5, judge=False, bound_samples=0,
        )  # fmt: skip
        for row in run(scenario).subproblem[400 : 400 + SIZE]:
            yield NullSpaceQP.from_row(np.array(row))

    return make


def tip_velocity(rng: Rng, speed: float) -> Array:
    """Return a random direction at a random speed up to ``speed`` [m/s]."""
    v = rng.normal(size=3)
    return np.asarray(v * speed * rng.uniform() / np.linalg.norm(v))


def random_poses(robot: RobotModel, rng: Rng) -> Iterator[NullSpaceQP]:
    """Yield problems at regular poses all over the workspace."""
    while True:
        yield at_pose(robot, robot.random_regular_pose(rng), tip_velocity(rng, 0.05))


def near_singular(robot: RobotModel, rng: Rng) -> Iterator[NullSpaceQP]:
    """Yield problems with the elbow 0.1 rad to 1e-8 rad short of straight: ker A grows from dimension two to three."""
    for bend in np.logspace(-1, -8, SIZE):
        q = robot.random_regular_pose(rng)
        q[3] = bend
        # at rest: near the singularity almost every other velocity is out of reach
        yield at_pose(robot, q, np.zeros(3))


def joint_limits(robot: RobotModel, rng: Rng) -> Iterator[NullSpaceQP]:
    """Yield problems with one to three joints within a milliradian of a limit: the box is closed on that side."""
    while True:
        q = robot.random_regular_pose(rng)
        for joint in rng.choice(robot.n - 1, size=rng.integers(1, 4), replace=False):
            gap = 10.0 ** rng.uniform(-6, -3)
            q[joint] = robot.q_min[joint] + gap if rng.uniform() < 0.5 else robot.q_max[joint] - gap
        yield at_pose(robot, q, tip_velocity(rng, 0.005))


def infeasible(robot: RobotModel, rng: Rng) -> Iterator[NullSpaceQP]:
    """Yield problems with the paper's k0 = 0.1 and fast references, near the border of feasibility on both sides."""
    while True:
        yield at_pose(robot, robot.random_regular_pose(rng), tip_velocity(rng, 0.1), k0=0.1)


def inconsistent(size: float) -> Callable[[RobotModel, Rng], Iterator[NullSpaceQP]]:
    """Yield tip and wrist references that differ along the shaft by ``size`` [m/s]."""

    def make(robot: RobotModel, rng: Rng) -> Iterator[NullSpaceQP]:
        while True:
            qp = at_pose(robot, robot.random_regular_pose(rng), tip_velocity(rng, 0.05))
            u = robot.state(qp.q if qp.q is not None else np.zeros(robot.n)).tool_direction
            yield changed(qp, v_wrist=qp.v_wrist + size * u)

    return make


def jumps(robot: RobotModel, rng: Rng) -> Iterator[NullSpaceQP]:
    """Yield neighbours from far apart, every second one with its gradient turned round, against warm starts."""
    while True:
        qp = at_pose(robot, robot.random_regular_pose(rng), tip_velocity(rng, 0.05), regularization=0.0)
        yield qp
        yield changed(qp, grad_mu=-qp.grad_mu)


RECIPES: dict[str, Callable[[RobotModel, Rng], Iterator[NullSpaceQP]]] = {
    **{task: sequence(task, 1e-5) for task in ("circle", "sinusoid", "spiral")},
    **{f"{task}-rho0": sequence(task, 0.0) for task in ("circle", "sinusoid", "spiral")},
    "random": random_poses,
    "near-singular": near_singular,
    "joint-limits": joint_limits,
    "infeasible": infeasible,
    **{f"inconsistent-1e{power}": inconsistent(10.0**power) for power in (-12, -10, -8, -6, -4)},
    "jumps": jumps,
}
