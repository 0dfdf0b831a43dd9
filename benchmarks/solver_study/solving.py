"""Inside the worker: ask a solver, and time it with nothing between two solves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from benchmarks.solver_study.settings import SolverSetting
from moc_opt.arrays import Array
from moc_opt.control.solution_check import received
from moc_opt.errors import describe
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.robots.model import load_robot
from moc_opt.scenario import make_solver
from moc_opt.solvers.base import Session, Solution, Solver, Status, no_answer
from moc_opt.solvers.registry import accepts
from moc_opt.study.engine import alarm, report
from moc_opt.study.timing import Disturbance, each_us

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


def answers(
    setting: SolverSetting, rows: Array, warm: bool, arm: Callable[[], Any] | None, patience_s: float, setup_s: float
) -> list[Any]:
    """Return the reason why the solver does not take these problems, or "", then (status, iterations, x, y, said) each.

    Each is reported as it comes, and each may take ``patience_s``; setting up, which may build programs, ``setup_s``.
    """
    found: list[Any] = []
    alarm(setup_s)
    for item in _answers(setting, rows, warm, arm):
        alarm(patience_s)
        report(item)
        found.append(item)
    return found


def _answers(setting: SolverSetting, rows: Array, warm: bool, arm: Callable[[], Any] | None) -> Iterator[Any]:
    solver, problems = _made(setting, arm), _problems(rows)
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
        yield solution.status.label, solution.iterations, np.array(solution.x), np.array(y), ""


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


class Times(NamedTuple):
    """Times of one solver on one set [us], and what the machine did meanwhile."""

    solve: Array  # (rounds, k) warm
    setup: Array
    cold: Array  # the first solve of a session
    update: Array  # of the solver's problem; empty where a session cannot take one without solving it
    warm_load: Disturbance
    cold_load: Disturbance


def times(
    setting: SolverSetting, rows: Array, every: int, rounds: int, seconds: float, arm: Callable[[], Any] | None = None
) -> Times:
    """Time one session going through all problems, round by round, and fresh ones for every ``every``-th problem."""
    solver, problems = _made(setting, arm), _problems(rows)
    session = solver.start(problems[0])
    each_us(session.solve, problems[:WARM_UP])  # caches: not counted
    warm, seen = list[Array](), list[Disturbance]()
    while len(warm) < rounds and 1e-6 * sum(one.sum() for one in warm) <= seconds:
        warm.append(each_us(session.solve, problems, seen=seen))
    few, then = problems[::every], list[Disturbance]()
    solver.start(few[0]).solve(few[0])
    sessions: list[Any] = []
    setup = each_us(solver.start, few, sessions, seen=then)
    pairs = list(zip(sessions, few, strict=True))
    cold = each_us(lambda pair: pair[0].solve(pair[1]), pairs, seen=then)
    update = getattr(sessions[0], "update", None)
    updates = np.empty(0) if update is None else each_us(update, few, seen=then)
    return Times(np.array(warm), setup, cold, updates, sum(seen, Disturbance()), sum(then, Disturbance()))


def expand(problems: list[NullSpaceQP]) -> None:
    """Compute what the adapters read (P, p, the five rows) before the clock starts."""
    for qp in problems:
        _ = qp.P, qp.p, qp.q
        qp.reduced()
