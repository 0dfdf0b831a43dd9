"""Where the problems of each test set come from: recorded runs, and random arm poses of one kind each."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.subproblems.testset import TestSet, changed
from moc_opt.arrays import Array
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.robots.chain import desired_wrist
from moc_opt.robots.model import RobotModel

Rng = np.random.Generator

SIZE = 128  # problems a set
SEQUENCES = ("circle", "sinusoid", "spiral", "circle-rho0", "sinusoid-rho0", "spiral-rho0")


def at_pose(
    robot: RobotModel, q: Array, v_tip: Array, *, regularization: float = 1e-5, k0: float = 2.0, depth: float = 0.15
) -> NullSpaceQP:
    """Build the subproblem of an arm at q whose shaft passes the trocar ``depth`` above the tip, for a tip velocity."""
    state = robot.state(q)
    trocar = state.tip - depth * state.tool_direction
    _, v_wrist = desired_wrist(state.tip, v_tip, trocar, np.zeros(3), state.tool_span)
    lower, upper = (np.clip(-k0 * (q - limit), -robot.v_max, robot.v_max) for limit in (robot.q_min, robot.q_max))
    v_wrist = along_the_shaft(v_tip, v_wrist, state.tool_direction)
    return NullSpaceQP(
        state.J_tip, state.J_wrist, v_tip, v_wrist, state.grad_mu, lower=lower, upper=upper, q=q,
        regularization=regularization,
    )  # fmt: skip


def along_the_shaft(v_tip: Array, v_wrist: Array, u: Array) -> Array:
    """Return v_W with u^T (v_T - v_W) = 0: a rigid tool cannot change its length."""
    return np.asarray(v_wrist + u * (u @ (v_tip - v_wrist)))


def recorded(name: str) -> Callable[[RobotModel, Rng], Iterator[NullSpaceQP]]:
    """Yield a 500 Hz sequence from the middle of the elbow's travel in a closed-loop run: as it is in the set's file.

    The control law has changed since these runs, so that a run of today gives another sequence.
    """

    def replay(robot: RobotModel, rng: Rng) -> Iterator[NullSpaceQP]:
        yield from TestSet.load(name).problems()

    return replay


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
        yield changed(qp, grad_mu=-qp.grad_mu, pull=-qp.pull)


RECIPES: dict[str, Callable[[RobotModel, Rng], Iterator[NullSpaceQP]]] = {
    **{name: recorded(name) for name in SEQUENCES},
    "random": random_poses,
    "near-singular": near_singular,
    "joint-limits": joint_limits,
    "infeasible": infeasible,
    **{f"inconsistent-1e{power}": inconsistent(10.0**power) for power in (-12, -10, -8, -6, -4)},
    "jumps": jumps,
}
