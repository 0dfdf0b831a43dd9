"""The test sets of the subproblem: what they hold, how they are made, how they are read.

    python -m benchmarks.testsets          makes all sets of this version again (same seed, same bytes)
    python -m benchmarks.testsets --check  says whether the files are what this program makes

Every set is an .npz without pickles: ``rows`` (k, 10 n + 10) flat NullSpaceQP records, ``x`` (k, n) the
certified answers (NaN where none exists) and ``feasible`` (k,). An answer is certified by its residuals, never by
the solver that gave it; an infeasible problem by HiGHS, which has nothing in common with ours.
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from benchmarks.output import write_atomically
from moc_opt.control.null_space import consistent_wrist_velocity, velocity_damper
from moc_opt.errors import MocOptError
from moc_opt.inputs.files import read_arrays
from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.model.shaft_kernels import desired_wrist
from moc_opt.numerics.arrays import Array
from moc_opt.qp.problem import NullSpaceQP, compute_residuals
from moc_opt.scenario import Scenario, run
from moc_opt.solvers.exact.solver import Exact

Rng = np.random.Generator

VERSION = 1
SIZE = 128  # problems a set
ARGUMENTS = (
    "J_tip", "J_wrist", "v_tip", "v_wrist", "grad_mu", "lower", "upper", "c0", "c1", "c2", "regularization", "q",
)  # fmt: skip
FOLDER = Path(__file__).parent / "testsets" / f"v{VERSION}"


class CertificateError(MocOptError, ArithmeticError):
    """A test set holds a problem whose answer cannot be certified."""


@dataclass(frozen=True)
class TestSet:
    """Problems that belong together, with their certified answers."""

    __test__ = False  # not a class of tests

    name: str
    rows: Array
    x: Array
    feasible: NDArray[np.bool_]

    def problems(self) -> list[NullSpaceQP]:
        """Return the subproblems, in order: in a sequence neighbours are 2 ms apart."""
        return [NullSpaceQP.from_row(np.array(row)) for row in self.rows]

    def judged(self) -> Array:
        """Return ``rows`` as answers are judged: with references that the rigid tool can follow.

        Where those of tip and wrist differ along the shaft, the wrist's are moved; what is certified is the answer
        to the five rows that this leaves alone.
        """
        return np.array([straightened(qp).row for qp in self.problems()])

    def to_bytes(self) -> bytes:
        """Return the .npz file."""
        buffer = io.BytesIO()
        np.savez_compressed(buffer, rows=self.rows, x=self.x, feasible=self.feasible)
        return buffer.getvalue()

    @classmethod
    def load(cls, name: str, folder: Path = FOLDER) -> TestSet:
        """Read a set by name.

        Raises:
            CertificateError: there is no such file.
        """
        path = folder / f"{name}.npz"
        if not path.exists():
            raise CertificateError(f"test set {name!r}: no file {path}; make it with: python -m benchmarks.testsets")
        arrays = read_arrays(path, f"test set {name!r}:", CertificateError)
        try:
            return cls(name, arrays["rows"], arrays["x"], arrays["feasible"])
        except KeyError as error:
            raise CertificateError(f"test set {name!r}: {path} has no array {error}; make it again") from error


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


def certify(name: str, problems: Sequence[NullSpaceQP]) -> TestSet:
    """Find the answers and prove them.

    Inconsistent references have no answer on six rows; what is certified is that of the five rows that remain
    without the wrist's row along the shaft.

    Raises:
        CertificateError: an answer that its residuals do not bear out, or a verdict that HiGHS does not share.
    """
    rows = np.array([qp.row for qp in problems])
    X = np.full((len(problems), problems[0].n), np.nan)
    feasible = np.zeros(len(problems), dtype=bool)
    for i, qp in enumerate(problems):
        five = qp.reduced()
        straight = straightened(qp)
        solution = Exact().start(straight).solve(straight)
        bounds = list(zip(qp.lower, qp.upper, strict=True))
        program = linprog(np.zeros(qp.n), A_eq=five.A, b_eq=five.b, bounds=bounds, method="highs")
        feasible[i] = solution.status.label == "solved"
        if feasible[i]:
            X[i] = solution.x
            found = straight.residuals(solution.x, solution.y)
            if not (found.verified() and found.primal < 1e-9 and found.natural < 1e-9):
                raise CertificateError(f"{name}[{i}]: the residuals of the answer are {found}")
        elif program.status != 2:
            raise CertificateError(f"{name}[{i}]: called infeasible, but HiGHS says: {program.message}")
    return TestSet(name, rows, X, feasible)


def straightened(qp: NullSpaceQP) -> NullSpaceQP:
    """Return the same subproblem with the wrist's reference along the shaft moved to the tip's."""
    five = qp.reduced()
    b = np.linalg.lstsq(five.lift, five.b, rcond=None)[0] if len(five.b) == 5 else np.array(qp.b)
    b[3:] += five_row_gap(qp, b)
    return changed(qp, v_tip=b[:3], v_wrist=b[3:], q=None)


def changed(qp: NullSpaceQP, **values: Any) -> NullSpaceQP:
    """Return the same subproblem with other values of some of its arguments."""
    return NullSpaceQP(**{name: getattr(qp, name) for name in ARGUMENTS} | values)


def five_row_gap(qp: NullSpaceQP, b: NDArray[np.floating]) -> Array:
    """Return what is missing along the shaft for the wrist to follow the tip, (3,) [m/s]."""
    u = np.linalg.svd(qp.J_tip - qp.J_wrist)[0][:, 2]
    return np.asarray(u * (u @ (b[:3] - b[3:])))


def make(name: str, robot: RobotModel, seed: int = 0) -> TestSet:
    """Make one set; its numbers depend on its name and the seed alone."""
    rng = np.random.default_rng([seed, VERSION, *name.encode()])
    source = RECIPES[name](robot, rng)
    return certify(name, [qp for qp, _ in zip(source, range(SIZE), strict=False)])


def main(arguments: Sequence[str] | None = None) -> int:
    """Make or check all sets; see `cli.run` for the exit status, which is 1 where the files differ."""
    from benchmarks import cli  # late: whoever reads a set needs no tables

    options = argparse.ArgumentParser(prog="python -m benchmarks.testsets", description=__doc__)
    options.add_argument("--check", action="store_true", help="compare with the files instead of writing")
    return cli.run(options, _make_all, arguments)


def _make_all(given: argparse.Namespace) -> int:
    robot, different = load_robot(), []
    for name in RECIPES:
        made = make(name, robot)
        found = compute_residuals(made.rows, made.x)
        print(f"{name:20s} {len(made.rows):4d} problems, {int(made.feasible.sum()):4d} feasible, "
              f"largest primal residual {np.max(found.primal[made.feasible], initial=0.0):.1e}")  # fmt: skip
        if not given.check:
            write_atomically(FOLDER / f"{name}.npz", made.to_bytes())
            continue
        kept = TestSet.load(name)
        if not np.allclose(kept.rows, made.rows, rtol=1e-9, atol=1e-12, equal_nan=True):
            different.append(name)
    if different:
        print(f"not what this program makes: {', '.join(different)}")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
