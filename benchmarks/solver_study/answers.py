"""Answers and times of solvers on test sets, also of solvers that hang or crash.

Two passes: the answers, several solvers at a time and each answer with a limit of its own, and then the times, one
after the other. A set is solved warm (one session in order) and cold (a fresh session each, of a part of it).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.solver_study.settings import SolverSetting
from benchmarks.solver_study.solving import RAISED, answers, times
from moc_opt.arrays import Array
from moc_opt.qp.layout import joints_of
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.exact import Exact
from moc_opt.study import Failed, Job

Run = Callable[..., list[Any]]
"""`moc_opt.study.run` with the study's own folder, workers and progress."""

# What became of an answer, beside RAISED and the statuses of solvers.
HUNG, CRASHED, NOT_ASKED, REFUSED = "hung", "crashed", "not asked", "refused"
SETTING_UP = ", while setting up"
GIVE_UP = 2  # hangs and crashes in one set, after which the rest of it is not asked
BROKEN_SETS = 3  # sets in which a solver hung or crashed, after which it is not asked about others
HOURS = 1e5  # of a whole set: every answer has its own limit

__all__ = ["CRASHED", "HUNG", "NOT_ASKED", "RAISED", "REFUSED", "SETTING_UP", "Data", "Limits", "Part", "ask", "time"]


class Part(NamedTuple):
    """A finding: plain values and arrays by name."""

    values: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


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
    """Make a set of a sequence; its feasibility is as ``exact`` claims, whose claims the certificates confirm."""
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


Question = tuple[SolverSetting, Data]


def ask(run: Run, questions: Sequence[Question], limits: Limits, warm: bool = True) -> list[Part]:
    """Collect all answers of each solver to its set, warm or each of a new session; a hang or a crash costs one answer.

    After `GIVE_UP` of these in a set the rest of it is not asked; after `BROKEN_SETS` such sets no other one is.

    Returns:
        for each question ``reason`` why the solver does not take the problems ("": it does), ``events`` (what it raised
        and how its process ended, at which problem), and arrays ``status`` (k,), ``iterations`` (k,), ``x`` (k, n),
        ``y`` (k, 6).
    """
    found = [_Answers(setting, data) for setting, data in questions]
    asked: list[_Answers] = found
    while asked:
        jobs = [
            Job(answers, (one.setting, one.data.rows[one.place :], warm, one.data.kinematics, limits.patience_s,
                          limits.setup_s), HOURS, group=one.setting.label)
            for one in asked
        ]  # fmt: skip
        for one, result in zip(asked, run(jobs, give_up=BROKEN_SETS), strict=True):
            one.take(result)
        broken, asked = Counter[str](), []
        for one in found:
            if one.open and broken[one.setting.label] < BROKEN_SETS:
                asked.append(one)
            broken[one.setting.label] += one.broken > 0
    return [one.part for one in found]


class _Answers:
    """The answers of one solver to one set, as far as they have come."""

    def __init__(self, setting: SolverSetting, data: Data) -> None:
        self.setting, self.data, self.part = setting, data, not_asked(data)
        self.place, self.broken, self.open = 0, 0, True
        self.part.values["events"] = []

    def take(self, result: list[Any] | Failed) -> None:
        """Take what a job returned, or what it had reported when it failed."""
        failed = result if isinstance(result, Failed) else None
        came: Sequence[Any] = result.parts if isinstance(result, Failed) else result
        reason, *items = came or [None]
        arrays, events = self.part.arrays, self.part.values["events"]
        for item in items:
            said = item[-1]
            for name, value in zip(("status", "iterations", "x", "y"), item, strict=False):
                arrays[name][self.place] = value
            if said:
                events.append(f"problem {self.place}: {said}")
            self.place += 1
        if reason or (failed and failed.kind == "raised"):  # it does not take the problems, or cannot be made
            self.part.values["reason"] = reason or str(failed)
            arrays["status"][self.place :] = REFUSED
            self.open = False
        elif failed and failed.kind == "not run":
            events.append(NOT_ASKED)
            self.open = False
        elif failed:
            ready = reason is not None
            arrays["status"][self.place] = HUNG if failed.kind == "hung" else CRASHED
            events.append(f"problem {self.place}{'' if ready else SETTING_UP}: {failed.reason}")
            self.place += 1
            self.broken += 1 if ready else GIVE_UP  # no other problem will be set up either
            self.open = self.broken < GIVE_UP and self.place < len(arrays["status"])
        else:
            self.open = False


def time(run: Run, questions: Sequence[Question], limits: Limits) -> list[Part]:
    """Measure the times [us] of each solver on its set, one after the other with nothing beside.

    Returns:
        for each question ``reason`` why there are none, what the machine did while the ``warm`` times were taken and
        the ``cold`` ones (fields of a `Disturbance`), and arrays ``solve_us`` (rounds, k), ``setup_us``, ``cold_us``,
        ``update_us``. Where p99 is not to be trusted nothing is kept.
    """
    limit = 20.0 * limits.seconds + limits.patience_s + limits.setup_s
    jobs = [
        Job(times, (setting, data.rows, max(1, len(data.rows) // limits.cold), limits.rounds, limits.seconds,
                    data.kinematics), limit, alone=True, group=setting.label)
        for setting, data in questions
    ]  # fmt: skip
    found = run(jobs, keep=lambda result: result.warm_load.trusts(99.0))
    return [
        untimed(data, str(result)) if isinstance(result, Failed) else Part(
            {"reason": "", "warm": asdict(result.warm_load), "cold": asdict(result.cold_load)},
            {"solve_us": result.solve, "setup_us": result.setup, "cold_us": result.cold, "update_us": result.update},
        )
        for (_, data), result in zip(questions, found, strict=True)
    ]  # fmt: skip


def untimed(data: Data, reason: str = "not every problem was answered") -> Part:
    """Return a part without times."""
    nothing = np.empty(0)
    arrays = {"solve_us": np.empty((0, len(data.rows))), "setup_us": nothing, "cold_us": nothing, "update_us": nothing}
    return Part({"reason": f"not timed: {reason}"}, arrays)
