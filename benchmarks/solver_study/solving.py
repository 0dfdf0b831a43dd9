"""Inside the worker: ask a solver, and time it with nothing between two solves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np

from benchmarks.common.timing import each_us
from benchmarks.solver_study.open_loop import expand
from benchmarks.solver_study.settings import SolverSetting
from moc_opt.control.solution_check import received
from moc_opt.errors import describe
from moc_opt.model.robot_model import load_robot
from moc_opt.numerics.arrays import Array
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.scenario import make_solver
from moc_opt.solvers.base import Session, Solution, Solver, Status, no_answer
from moc_opt.solvers.registry import accepts

RAISED = "raised"  # what became of an answer, beside the statuses of solvers
WARM_UP = 16  # solves that are not counted


_robot = cache(load_robot)  # read once by each worker, which makes hundreds of solvers


def _made(setting: SolverSetting, arm: Callable[[], Any] | None) -> Solver:
    wanted = arm is not None and accepts(setting.solver, "kinematics")
    extra = {"kinematics": arm()} if arm is not None and wanted else {}  # seconds, for many joints
    return make_solver(setting.solver, _robot(), **{**setting.options, **extra})


def _problems(rows: Array) -> list[NullSpaceQP]:
    found = [NullSpaceQP.from_row(np.array(row)) for row in rows]
    expand(found)
    return found


def answers(setting: SolverSetting, rows: Array, warm: bool, arm: Callable[[], Any] | None = None) -> Iterator[Any]:
    """Yield the reason why the solver does not take these problems, or "", then (status, iterations, x, y) each."""
    solver, problems = _made(setting, arm), _problems(rows)
    # Before the first word: setting up may compile, and the patience for that is longer than for a solve.
    session, reason = _session(solver, problems[0])
    yield reason
    if session is None:
        return
    for qp in problems:
        said = ""
        if session is None or not warm:
            session, said = _session(solver, qp)
        solution, said = (no_answer(qp.n, Status.NUMERICAL), said) if session is None else _asked(session, qp)
        if said:  # it is counted, and the next problem is asked of a new session
            session = None
            yield RAISED, 0, np.full(qp.n, np.nan), np.full(6, np.nan), said
            continue
        y = np.full(6, np.nan) if solution.y is None else solution.y
        yield solution.status.label, solution.iterations, solution.x, y, ""


def _session(solver: Solver, qp: NullSpaceQP) -> tuple[Session | None, str]:
    """Return a session, or None and the reason why there is none: the solver's own, or what it raised."""
    try:
        reason = solver.supports(qp)
        if reason is None:
            session = solver.start(qp)
            return (session, "") if session is not None else (None, "start returned None: return a Session")
        return None, reason if isinstance(reason, str) and reason else f"supports returned {reason!r:.100}"
    except (Exception, SystemExit) as error:  # noqa: BLE001 - foreign code may raise anything
        return None, describe(error)


def _asked(session: Session, qp: NullSpaceQP) -> tuple[Solution, str]:
    """Return the answer, and what was raised or is wrong with its form."""
    try:
        return received(session.solve(qp), qp.n)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - as above
        return no_answer(qp.n, Status.NUMERICAL), describe(error)


def warm_times(
    setting: SolverSetting, rows: Array, rounds: int, seconds: float, arm: Callable[[], Any] | None = None
) -> Iterator[Array]:
    """Yield the times [us] of one session going through all problems, round by round."""
    solver, problems = _made(setting, arm), _problems(rows)
    session = solver.start(problems[0])
    each_us(session.solve, problems[:WARM_UP])  # caches and compilers: not counted
    spent = 0.0
    for _ in range(rounds):
        if spent > seconds:
            return
        times = each_us(session.solve, problems)
        spent += 1e-6 * times.sum()
        yield times


def cold_times(
    setting: SolverSetting, rows: Array, arm: Callable[[], Any] | None = None
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield once: the times [us] of setting sessions up, of the first solve of each, and of updating one of them.

    The last are empty where the session cannot take a problem without solving it.
    """
    solver, problems = _made(setting, arm), _problems(rows)
    solver.start(problems[0]).solve(problems[0])
    sessions: list[Any] = []
    setup = each_us(solver.start, problems, sessions)
    pairs = list(zip(sessions, problems, strict=True))
    cold = each_us(lambda pair: pair[0].solve(pair[1]), pairs)
    update = getattr(sessions[0], "update", None)
    yield setup, cold, np.empty(0) if update is None else each_us(update, problems)
