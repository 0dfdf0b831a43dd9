"""Rebuild the certified test sets of the subproblem, or compare the files with rebuilt sets.

python -m benchmarks.testsets [--check]

Six sets are sequences, recorded in closed loop. Their problems are taken from the files, because today's control law
would give others. --check compares new problems with those in the files, and the files' answers with newly certified
answers.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from itertools import islice

import numpy as np

from benchmarks.certify import certify
from moc_opt.arrays import Array
from moc_opt.inputs.files import write_whole
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.robots.chain import desired_wrist
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.study.testsets import FOLDER, INCONSISTENT, NAMES, SEQUENCES, TestSet, changed

CLOSE = 1e-9  # allowed difference of answers [rad/s]
Rng = np.random.Generator
SIZE = 128  # problems per set
VERSION = 1  # part of the random generator's seed


def at_pose(
    robot: RobotModel, q: Array, v_tip: Array, *, regularization: float = 1e-5, k0: float = 2.0, depth: float = 0.15
) -> NullSpaceQP:
    """Build the subproblem with the trocar on the shaft, ``depth`` [m] above the tip."""
    state = robot.state(q)
    trocar = state.tip - depth * state.tool_direction
    _, v_wrist = desired_wrist(state.tip, v_tip, trocar, np.zeros(3), state.tool_span)
    lower, upper = (np.clip(-k0 * (q - limit), -robot.v_max, robot.v_max) for limit in (robot.q_min, robot.q_max))
    u = state.tool_direction
    v_wrist = v_wrist + u * (u @ (v_tip - v_wrist))  # the tool is rigid
    return NullSpaceQP(
        state.J_tip, state.J_wrist, v_tip, v_wrist, state.grad_mu, lower=lower, upper=upper, q=q,
        regularization=regularization,
    )  # fmt: skip


def tip_velocity(rng: Rng, speed: float) -> Array:
    """Return a random velocity (3,) [m/s], not faster than ``speed``."""
    v = rng.normal(size=3)
    return np.asarray(v * speed * rng.uniform() / np.linalg.norm(v))


def random_poses(robot: RobotModel, rng: Rng) -> Iterator[NullSpaceQP]:
    while True:
        yield at_pose(robot, robot.random_regular_pose(rng), tip_velocity(rng, 0.05))


def near_singular(robot: RobotModel, rng: Rng) -> Iterator[NullSpaceQP]:
    """Yield problems with an almost straight elbow."""
    for bend in np.logspace(-1, -8, SIZE):
        q = robot.random_regular_pose(rng)
        q[3] = bend
        # Near a singularity, almost all nonzero tip velocities are infeasible.
        yield at_pose(robot, q, np.zeros(3))


def joint_limits(robot: RobotModel, rng: Rng) -> Iterator[NullSpaceQP]:
    """Yield problems with one to three joints within 1 mrad of a limit."""
    while True:
        q = robot.random_regular_pose(rng)
        for joint in rng.choice(robot.n - 1, size=rng.integers(1, 4), replace=False):
            gap = 10.0 ** rng.uniform(-6, -3)
            q[joint] = robot.q_min[joint] + gap if rng.uniform() < 0.5 else robot.q_max[joint] - gap
        yield at_pose(robot, q, tip_velocity(rng, 0.005))


def infeasible(robot: RobotModel, rng: Rng) -> Iterator[NullSpaceQP]:
    """Yield problems, some of them infeasible."""
    while True:
        yield at_pose(robot, robot.random_regular_pose(rng), tip_velocity(rng, 0.1), k0=0.1)


def inconsistent(size: float) -> Callable[[RobotModel, Rng], Iterator[NullSpaceQP]]:
    """Return a maker of problems in which v_wrist exceeds v_tip by ``size`` [m/s] along the shaft."""

    def make(robot: RobotModel, rng: Rng) -> Iterator[NullSpaceQP]:
        while True:
            qp = at_pose(robot, robot.random_regular_pose(rng), tip_velocity(rng, 0.05))
            u = robot.state(qp.q if qp.q is not None else np.zeros(robot.n)).tool_direction
            yield changed(qp, v_wrist=qp.v_wrist + size * u)

    return make


def jumps(robot: RobotModel, rng: Rng) -> Iterator[NullSpaceQP]:
    """Yield pairs of problems that differ only in the sign of the gradient."""
    while True:
        qp = at_pose(robot, robot.random_regular_pose(rng), tip_velocity(rng, 0.05), regularization=0.0)
        yield qp
        yield changed(qp, grad_mu=-qp.grad_mu, pull=-qp.pull)


RECIPES: dict[str, Callable[[RobotModel, Rng], Iterator[NullSpaceQP]]] = {
    "random": random_poses,
    "near-singular": near_singular,
    "joint-limits": joint_limits,
    "infeasible": infeasible,
    **{name: inconsistent(float(name.removeprefix("inconsistent-"))) for name in INCONSISTENT},
    "jumps": jumps,
}


def make(name: str, robot: RobotModel, seed: int = 0) -> TestSet:
    if name in SEQUENCES:
        return certify(name, TestSet.load(name).problems())
    rng = np.random.default_rng([seed, VERSION, *name.encode()])
    return certify(name, list(islice(RECIPES[name](robot, rng), SIZE)))


def main(arguments: Sequence[str] | None = None) -> int:
    options = argparse.ArgumentParser(prog="python -m benchmarks.testsets", description=__doc__)
    options.add_argument("--check", action="store_true", help="compare with the files instead of writing")
    return make_all(options.parse_args(arguments).check)


def make_all(check: bool) -> int:
    robot, different = load_robot(), []
    for name in NAMES:
        made = make(name, robot)
        print(f"{name:20s} {len(made.rows):4d} problems, {int(made.feasible.sum()):4d} feasible", end="")
        if not check:
            print()
            write_whole(FOLDER / f"{name}.npz", made.to_bytes())
            continue
        kept = TestSet.load(name)
        again = certify(name, kept.problems())
        apart = float(np.nanmax(np.abs(again.x - kept.x), initial=0.0))
        print(f", answers in the file within {apart:.1e} rad/s of the certified ones")
        same = np.allclose(kept.rows, made.rows, rtol=1e-9, atol=1e-12, equal_nan=True)
        if not (same and np.array_equal(again.feasible, kept.feasible) and apart <= CLOSE):
            different.append(name)
    if different:
        print(f"these files differ from the sets that this program makes: {', '.join(different)}")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
