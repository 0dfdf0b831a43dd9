"""Make a test set: draw its problems, find their answers, and prove them.

An answer is certified by its residuals, never by the solver that gave it; an infeasible problem by HiGHS, which has
nothing in common with ours.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linprog

from benchmarks.subproblems.recipes import RECIPES, SIZE
from benchmarks.subproblems.testset import VERSION, CertificateError, TestSet, straightened
from moc_opt.model.robot_model import RobotModel
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.exact.solver import Exact


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


def make(name: str, robot: RobotModel, seed: int = 0) -> TestSet:
    """Make one set; its numbers depend on its name and the seed alone."""
    rng = np.random.default_rng([seed, VERSION, *name.encode()])
    source = RECIPES[name](robot, rng)
    return certify(name, [qp for qp, _ in zip(source, range(SIZE), strict=False)])
