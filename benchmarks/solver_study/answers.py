"""Solvers on the test sets: what they claim, what their answers are worth, how long they take, and who never returns.

Two passes a cell, both in a worker: the answers, handed over one by one so that a hang or a crash costs one answer
and not the cell, and then the times, measured inside the worker without anything between two solves. A set is solved
warm (one session in order) and cold (a fresh session each, of a part of it).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.solver_study import open_loop
from benchmarks.solver_study.settings import Entry
from benchmarks.solver_study.store import Part, Store
from benchmarks.solver_study.worker import Crashed, Hung, Raised, Worker, WorkerError
from benchmarks.timing import each_us
from moc_opt.control.solution_check import received
from moc_opt.errors import describe
from moc_opt.model.robot_model import load_robot
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.scenario import make_solver
from moc_opt.solvers.base import Session, Solution, Solver, Status, no_answer
from moc_opt.solvers.registry import accepts

Array = NDArray[np.float64]

# What became of an answer, beside the statuses of solvers.
HUNG, CRASHED, RAISED, NOT_ASKED, REFUSED = "hung", "crashed", "raised", "not asked", "refused"
SETTING_UP = ", while setting up"
WARM_UP = 16  # solves that are not counted
GIVE_UP = 2  # hangs and crashes in one set, after which the rest of it is not asked


@dataclass(frozen=True)
class Limits:
    """How much is measured, and how long a solve may take."""

    patience_s: float = 2.0
    rounds: int = 8
    seconds: float = 0.5
    cold: int = 32
    setup_s: float = 40.0  # for setting up: programs are built, kernels compiled


@dataclass(frozen=True)
class Data:
    """One test set as the study needs it."""

    name: str
    rows: Array  # what solvers are given
    judged: Array  # what their answers are judged by
    feasible: NDArray[np.bool_]
    kinematics: Any = None  # of the arm, for solvers that want them; None: the default robot's

    @property
    def n(self) -> int:
        """Joints."""
        return (self.rows.shape[1] - 10) // 10

    def thinned(self, every: int) -> Data:
        """Each every-th problem."""
        return Data(
            self.name,
            self.rows[::every],
            self.judged[::every],
            self.feasible[::every],
            self.kinematics,
        )


# --- in the worker ---


def _made(entry: Entry, arm: Callable[[], Any] | None) -> Solver:
    wanted = arm is not None and accepts(entry.solver, "kinematics")
    extra = {"kinematics": arm()} if arm is not None and wanted else {}  # seconds, for many joints
    return make_solver(entry.solver, load_robot(), **{**entry.options, **extra})


def _problems(rows: Array) -> list[NullSpaceQP]:
    found = [NullSpaceQP.from_row(np.array(row)) for row in rows]
    open_loop.expand(found)
    return found


def answers(entry: Entry, rows: Array, warm: bool, arm: Callable[[], Any] | None = None) -> Iterator[Any]:
    """Yield the reason why the solver does not take these problems, or "", then (status, iterations, x, y) each."""
    solver, problems = _made(entry, arm), _problems(rows)
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
    """A session, or None and the reason why there is none: the solver's own, or what it raised."""
    try:
        reason = solver.supports(qp)
        if reason is None:
            session = solver.start(qp)
            return (session, "") if session is not None else (None, "start returned None: return a Session")
        return None, reason if isinstance(reason, str) and reason else f"supports returned {reason!r:.100}"
    except (Exception, SystemExit) as error:  # noqa: BLE001 - foreign code may raise anything
        return None, describe(error)


def _asked(session: Session, qp: NullSpaceQP) -> tuple[Solution, str]:
    """The answer, and what was raised or is wrong with its form."""
    try:
        return received(session.solve(qp), qp.n)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - as above
        return no_answer(qp.n, Status.NUMERICAL), describe(error)


def warm_times(
    entry: Entry, rows: Array, rounds: int, seconds: float, arm: Callable[[], Any] | None = None
) -> Iterator[Array]:
    """Yield the times [us] of one session going through all problems, round by round."""
    solver, problems = _made(entry, arm), _problems(rows)
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
    entry: Entry, rows: Array, arm: Callable[[], Any] | None = None
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield once: the times [us] of setting sessions up, of the first solve of each, and of updating one of them.

    The last are empty where the session cannot take a problem without solving it.
    """
    solver, problems = _made(entry, arm), _problems(rows)
    solver.start(problems[0]).solve(problems[0])
    sessions: list[Any] = []
    setup = each_us(solver.start, problems, sessions)
    pairs = list(zip(sessions, problems, strict=True))
    cold = each_us(lambda pair: pair[0].solve(pair[1]), pairs)
    update = getattr(sessions[0], "update", None)
    yield setup, cold, np.empty(0) if update is None else each_us(update, problems)


# --- around it ---


def ask(worker: Worker, entry: Entry, data: Data, limits: Limits, warm: bool) -> Part:
    """All answers of one solver to one set, whatever it takes to get them."""
    count, n = len(data.rows), data.n
    status = np.full(count, NOT_ASKED, dtype="<U12")
    iterations, x, y = np.zeros(count, int), np.full((count, n), np.nan), np.full((count, 6), np.nan)
    events: list[str] = []
    place, broken = 0, 0
    while place < count and broken < GIVE_UP:
        ready = False
        try:
            stream = worker.stream(
                answers, entry, data.rows[place:], warm, data.kinematics, patience_s=limits.patience_s,
                first_s=limits.setup_s,
            )  # fmt: skip
            for item in stream:
                if isinstance(item, str):
                    if item:
                        status[:] = REFUSED
                        return Part({"reason": item, "events": []}, _arrays(status, iterations, x, y))
                    ready = True
                    continue
                status[place], iterations[place], x[place], y[place], said = item
                if said:
                    events.append(f"problem {place}: {said}")
                place += 1
        except Raised as error:  # before the first problem: the solver cannot be made
            status[place:] = REFUSED
            return Part({"reason": str(error), "events": events}, _arrays(status, iterations, x, y))
        except (Hung, Crashed) as error:
            status[place] = HUNG if isinstance(error, Hung) else CRASHED
            events.append(f"problem {place}{'' if ready else SETTING_UP}: {error}")
            place += 1
            broken = broken + 1 if ready else GIVE_UP  # no other problem will be set up either
    return Part({"reason": "", "events": events}, _arrays(status, iterations, x, y))


def time(worker: Worker, entry: Entry, data: Data, limits: Limits, answered: bool) -> Part:
    """Times of one solver on one set; empty where an answer of it never came."""
    nothing = np.empty(0)
    arrays = {
        "solve_us": np.empty((0, len(data.rows))), "setup_us": nothing, "cold_us": nothing, "update_us": nothing,
    }  # fmt: skip
    if not answered:
        return Part({"reason": "not timed: not every problem was answered"}, arrays)
    every = max(1, len(data.rows) // limits.cold)
    wait = 20.0 * limits.seconds + limits.patience_s
    try:
        rounds = list(
            worker.stream(
                warm_times, entry, data.rows, limits.rounds, limits.seconds, data.kinematics, patience_s=wait
            )
        )
        (setup, cold, update), *_ = list(
            worker.stream(cold_times, entry, data.rows[::every], data.kinematics, patience_s=wait)
        )
    except WorkerError as error:
        return Part({"reason": str(error)}, arrays)
    return Part({"reason": ""}, {"solve_us": np.array(rounds), "setup_us": setup, "cold_us": cold, "update_us": update})


def _arrays(status: Any, iterations: Any, x: Array, y: Array) -> dict[str, NDArray[Any]]:
    return {"status": status, "iterations": iterations, "x": x, "y": y}


def asked(
    store: Store,
    worker: Worker,
    entry: Entry,
    data: Data,
    limits: Limits,
    warm: bool = True,
) -> Part:
    """`ask`, or what an earlier run was answered."""
    key = store.key(
        part="answers", solver=entry.solver, options=entry.options, rows=data.rows, warm=warm,
        patience=limits.patience_s, arm=data.kinematics is not None,
    )  # fmt: skip
    return store.get(key) or store.put(key, ask(worker, entry, data, limits, warm))


def not_asked(data: Data) -> Part:
    count = len(data.rows)
    nothing = np.full((count, data.n), np.nan), np.full((count, 6), np.nan)
    arrays = _arrays(np.full(count, NOT_ASKED, dtype="<U12"), np.zeros(count, int), *nothing)
    return Part({"reason": "", "events": [NOT_ASKED]}, arrays)


def timed(store: Store, worker: Worker, entry: Entry, data: Data, limits: Limits, answered: bool) -> Part:
    """`time`, or what an earlier run measured."""
    key = store.key(
        part="times", solver=entry.solver, options=entry.options, rows=data.rows, rounds=limits.rounds,
        seconds=limits.seconds, cold=limits.cold, answered=answered, arm=data.kinematics is not None,
    )  # fmt: skip
    return store.get(key) or store.put(key, time(worker, entry, data, limits, answered))
