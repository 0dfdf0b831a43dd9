"""Answers and times of solvers on test sets, also of solvers that hang or crash.

Two passes, both in a worker: the answers, handed over one by one so that a hang or a crash costs one answer and not
the set, and then the times. A set is solved warm (one session in order) and cold (a fresh session each, of a part of
it).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.processes import Crashed, Hung, Raised, Worker, WorkerError
from benchmarks.common.store import Part, Store
from benchmarks.solver_study.settings import SolverSetting
from benchmarks.solver_study.solving import RAISED, answers, cold_times, warm_times
from moc_opt.numerics.arrays import Array
from moc_opt.qp.layout import joints_of
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.exact.solver import Exact

# What became of an answer, beside RAISED and the statuses of solvers.
HUNG, CRASHED, NOT_ASKED, REFUSED = "hung", "crashed", "not asked", "refused"
SETTING_UP = ", while setting up"
GIVE_UP = 2  # hangs and crashes in one set, after which the rest of it is not asked

__all__ = ["CRASHED", "HUNG", "NOT_ASKED", "RAISED", "REFUSED", "SETTING_UP", "Data", "Limits", "asked", "timed"]


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
        return joints_of(self.rows.shape[1])

    def thinned(self, every: int) -> Data:
        """Keep every ``every``-th problem."""
        part = slice(None, None, every)
        return replace(self, rows=self.rows[part], judged=self.judged[part], feasible=self.feasible[part])


def recorded(name: str, problems: Sequence[NullSpaceQP], kinematics: Any = None) -> Data:
    """Make a set of a sequence; its feasibility is as ``exact`` claims, which is right on all certified sets."""
    rows = np.array([qp.row for qp in problems])
    session = Exact().start(problems[0])
    feasible = np.array([session.solve(qp).status.label == "solved" for qp in problems])
    return Data(name, rows, rows, feasible, kinematics)


def not_asked(data: Data) -> Part:
    """Return a part without answers."""
    count = len(data.rows)
    arrays: dict[str, NDArray[Any]] = {
        "status": np.full(count, NOT_ASKED, dtype="<U12"), "iterations": np.zeros(count, int),
        "x": np.full((count, data.n), np.nan), "y": np.full((count, 6), np.nan),
    }  # fmt: skip
    return Part({"reason": "", "events": [NOT_ASKED]}, arrays)


def ask(worker: Worker, setting: SolverSetting, data: Data, limits: Limits, warm: bool) -> Part:
    """Collect all answers of one solver to one set; a hang or a crash costs one answer.

    Returns:
        ``reason`` why the solver does not take the problems ("": it does), ``events`` (what it raised and how its
        process ended, at which problem), and arrays ``status`` (k,), ``iterations`` (k,), ``x`` (k, n), ``y`` (k, 6).
    """
    arrays = not_asked(data).arrays
    status = arrays["status"]
    events: list[str] = []
    place, broken = 0, 0

    def refused(first: int, reason: str) -> Part:
        status[first:] = REFUSED
        return Part({"reason": reason, "events": events}, arrays)

    while place < len(status) and broken < GIVE_UP:
        ready = False
        try:
            stream = worker.stream(
                answers, setting, data.rows[place:], warm, data.kinematics, patience_s=limits.patience_s,
                first_s=limits.setup_s,
            )  # fmt: skip
            for item in stream:
                if isinstance(item, str):
                    if item:
                        return refused(0, item)
                    ready = True
                    continue
                status[place], arrays["iterations"][place], arrays["x"][place], arrays["y"][place], said = item
                if said:
                    events.append(f"problem {place}: {said}")
                place += 1
        except Raised as error:  # before the first problem: the solver cannot be made
            return refused(place, str(error))
        except (Hung, Crashed) as error:
            status[place] = HUNG if isinstance(error, Hung) else CRASHED
            events.append(f"problem {place}{'' if ready else SETTING_UP}: {error}")
            place += 1
            broken = broken + 1 if ready else GIVE_UP  # no other problem will be set up either
    return Part({"reason": "", "events": events}, arrays)


def time(worker: Worker, setting: SolverSetting, data: Data, limits: Limits, answered: bool) -> Part:
    """Measure the times [us] of one solver on one set; empty where an answer of it never came.

    Returns:
        ``reason`` why there are none, and arrays ``solve_us`` (rounds, k), ``setup_us``, ``cold_us``, ``update_us``.
    """
    arrays = {
        "solve_us": np.empty((0, len(data.rows))), "setup_us": np.empty(0), "cold_us": np.empty(0),
        "update_us": np.empty(0),
    }  # fmt: skip
    if not answered:
        return Part({"reason": "not timed: not every problem was answered"}, arrays)
    every = max(1, len(data.rows) // limits.cold)
    wait = 20.0 * limits.seconds + limits.patience_s
    warm = (warm_times, setting, data.rows, limits.rounds, limits.seconds, data.kinematics)
    try:
        rounds = list(worker.stream(*warm, patience_s=wait))
        (setup, cold, update), *_ = list(
            worker.stream(cold_times, setting, data.rows[::every], data.kinematics, patience_s=wait)
        )
    except WorkerError as error:
        return Part({"reason": str(error)}, arrays)
    return Part({"reason": ""}, {"solve_us": np.array(rounds), "setup_us": setup, "cold_us": cold, "update_us": update})


def asked(store: Store, worker: Worker, setting: SolverSetting, data: Data, limits: Limits, warm: bool = True) -> Part:
    """Ask as `ask` does, or take the answers of an earlier run."""
    key = store.key(
        part="answers", solver=setting.solver, options=setting.options, rows=data.rows, warm=warm,
        patience=limits.patience_s, arm=data.kinematics is not None,
    )  # fmt: skip
    return store.get(key) or store.put(key, ask(worker, setting, data, limits, warm))


def timed(store: Store, worker: Worker, setting: SolverSetting, data: Data, limits: Limits, answered: bool) -> Part:
    """Measure as `time` does, or take the times of an earlier run."""
    key = store.key(
        part="times", solver=setting.solver, options=setting.options, rows=data.rows, rounds=limits.rounds,
        seconds=limits.seconds, cold=limits.cold, answered=answered, arm=data.kinematics is not None,
    )  # fmt: skip
    return store.get(key) or store.put(key, time(worker, setting, data, limits, answered))
