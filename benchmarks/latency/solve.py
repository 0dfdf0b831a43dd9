"""The solver alone: `exact` on any n and in batches, and every native adapter against its library by hand."""

from __future__ import annotations

import os
from collections.abc import Iterable
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.common.timing import Timed
from benchmarks.latency.bare import BARE
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.qp.problem import NullSpaceQP, compute_residuals
from moc_opt.scenario import make_solver
from moc_opt.solvers.base import Status
from moc_opt.solvers.exact.solver import Exact, solve_rows

TOOL_M = 0.38


def random_problems(n: int, count: int, rng: np.random.Generator) -> list[NullSpaceQP]:
    """Make feasible subproblems of random n-joint arms with a rigid tool, without any structure to make use of."""
    found = []
    for _ in range(count):
        spin, wrist = rng.normal(size=(3, n)), rng.normal(scale=0.4, size=(3, n))
        u = rng.normal(size=3)
        tip = wrist + np.cross(spin.T, TOOL_M * u / np.linalg.norm(u)).T
        lower, upper = -rng.uniform(0.3, 3.0, n), rng.uniform(0.3, 3.0, n)
        x = 0.5 * (lower + upper) + 0.3 * (upper - lower) * rng.uniform(-1.0, 1.0, n)
        gradient = rng.normal(scale=0.1, size=n)
        found.append(NullSpaceQP(tip, wrist, tip @ x, wrist @ x, gradient, lower=lower, upper=upper))
    return found


def kernel_us(rows: Array, seconds: float = 0.2) -> float:
    """Return the time of one solve inside compiled code [us]: no Python between two of them but a call for all rows."""
    n = (rows.shape[1] - 10) // 10
    x, y, status = np.empty((len(rows), n)), np.empty((len(rows), 6)), np.empty(len(rows), dtype=np.int64)

    def solve(times: int) -> None:
        for _ in range(times):
            solve_rows(rows, Exact.tolerance, x, y, status)

    solve(1)
    times = max(1, int(seconds / 5 / max(_wall(lambda: solve(1)), 1e-6)))
    return 1e6 * min(_wall(lambda: solve(times)) for _ in range(5)) / (times * len(rows))


def batch(rows: Array, count: int) -> dict[str, float]:
    """Time ``Exact.solve_batch`` on ``count`` records in one call, on one thread and on all cores: the better of two.

    80 doubles a record of seven joints: a million are 640 MB.
    """
    many = np.ascontiguousarray(np.resize(rows, (count, rows.shape[1])))
    solver, cores = Exact(), os.cpu_count() or 1
    solver.solve_batch(many[: min(count, 1000)])
    alone = min(_wall(lambda: solver.solve_batch(many, 1)) for _ in range(2))
    spent = min(_wall(lambda: solver.solve_batch(many, cores)) for _ in range(2))
    return {
        "batch": count, "batch_threads": cores, "batch_one_thread_s": alone, "batch_all_cores_s": spent,
        "batch_one_thread_per_s": count / alone, "batch_all_cores_per_s": count / spent,
    }  # fmt: skip


def residuals(problems: list[NullSpaceQP]) -> dict[str, float]:
    """Return the worst residuals of ``exact`` on these, judged by the one measure; and how many it solved."""
    session = Exact().start(problems[0])
    answers = [session.solve(qp) for qp in problems]
    solved = [i for i, answer in enumerate(answers) if answer.status is Status.SOLVED]
    if not solved:
        return {"solves": len(problems), "solved": 0}
    rows = np.array([problems[i].row for i in solved])
    X = np.array([answers[i].x for i in solved])
    Y = np.array([np.full(6, np.nan) if answers[i].y is None else answers[i].y for i in solved])
    found = compute_residuals(rows, X, Y)
    return {
        "solves": len(problems), "solved": len(solved), "primal_max": float(found.primal.max()),
        "natural_max": float(found.natural.max()), "relative_max": float(found.relative.max()),
        "loss_max": float(found.loss.max()),
    }  # fmt: skip


def adapters(
    names: Iterable[str], robot: RobotModel, problems: list[NullSpaceQP]
) -> tuple[dict[str, dict[str, Timed]], dict[str, str]]:
    """Map adapter to {"adapter", "by hand", "library"}; and adapter -> why it cannot be compared.

    "by hand" loads the numbers and solves, "library" is the library's part of that alone.
    """
    found: dict[str, dict[str, Timed]] = {}
    refused: dict[str, str] = {}
    for name in names:
        solver: Any = make_solver(name, robot)
        reason = solver.supports(problems[0]) or disagreement(name, solver, problems)
        if reason is not None:
            refused[name] = reason
            continue
        whole, part = BARE[name](solver, problems[0]), BARE[name](solver, problems[0])
        found[name] = {
            "adapter": Timed(solver.start(problems[0]).solve, problems),
            "by hand": Timed(whole, problems),
            "library": Timed(part.solve, problems, part.load),
        }
    return found, refused


def disagreement(name: str, solver: Any, problems: list[NullSpaceQP], tolerance: float = 1e-4) -> str | None:
    """Say why adapter and library by hand do not do the same work; None when their answers agree."""
    session, bare = solver.start(problems[0]), BARE[name](solver, problems[0])
    for i, qp in enumerate(problems[:200]):
        gap = float(np.abs(session.solve(qp).x - bare(qp)[0]).max())
        if not gap <= tolerance:
            return f"adapter and library by hand differ by {gap:.2g} rad/s at subproblem {i}"
    return None


def _wall(call: Any) -> float:
    begin = perf_counter()
    call()
    return perf_counter() - begin
