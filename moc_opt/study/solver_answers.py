"""Collect solvers' answers to sets of problems, check and count them, and measure times.

An answer's residuals (`moc_opt.qp.residuals`) decide whether it is optimal, whatever the solver reports.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from moc_opt.arrays import Array
from moc_opt.control.supervisor import received
from moc_opt.errors import located
from moc_opt.inputs.settings import Settings
from moc_opt.qp.problem import NullSpaceQP, compute_residuals, fields, joints_of
from moc_opt.robots.model import load_robot
from moc_opt.scenario import make_solver
from moc_opt.solvers.base import Session, Solution, Solver, Status, no_answer
from moc_opt.study import timing
from moc_opt.study.engine import Failed, Job, alarm, report
from moc_opt.study.solver_settings import SolverSetting
from moc_opt.study.testsets import TestSet
from moc_opt.study.timing import each_us, percentiles, total

Runner = Callable[..., list[Any]]  # `engine.run` with some arguments bound

HUNG, CRASHED, RAISED, NOT_ASKED, REFUSED = "hung", "crashed", "raised", "not asked", "refused"
"""Statuses of an answer in addition to those of `Status`."""
BROKEN_SETS = 3  # after hangs or crashes in this many sets, a solver's later sets are skipped
WHOLE_SET_S = 1e5  # time limit of a whole set [s]; `answer` limits the single solves
WARM_UP = 16  # untimed solves at the start
CONTRADICTION = 1e-13  # six rows A x = b contradict each other if b is farther than this from a consistent b [m/s]
RIGHTLY = 0.99  # least `share_right` for comparing a solver's times, and for the verdicts "take" and "sound"
RESIDUALS = ("primal", "natural", "natural_best", "relative", "loss")


class Limits(Settings):
    """How much is measured, and how long a solve and a setup may take."""

    KIND: ClassVar[str] = "[testsets]"
    rounds: int = Field(8, ge=1, description="warm passes through a set; fewer if they take more than `seconds`")
    seconds: float = Field(0.05, gt=0.0)
    cold: int = Field(16, ge=1, description="problems of a set that are solved cold, each in a new session")
    patience_s: float = Field(0.5, gt=0.0, description="processor time after which a solve counts as hung")
    setup_s: float = Field(15.0, gt=0.0, description="processor time after which setting up counts as hung")


Question = tuple[SolverSetting, TestSet]


class Answer(NamedTuple):
    """A solver's answer, with x (n,) and y (6,). ``trouble`` describes an exception or a defect; "" if none."""

    status: str
    iterations: int
    x: Array
    y: Array
    trouble: str = ""


class Answers:
    """One solver's answers to one set of problems, with their residuals.

    ``refused`` says why the solver refuses the problems. ``events`` lists exceptions, hangs and crashes.
    """

    def __init__(self, setting: SolverSetting, problems: TestSet, result: list[Any] | Failed) -> None:
        self.setting, self.problems, self.refused = setting, problems, ""
        failed = result if isinstance(result, Failed) else None
        reason, *given = (result.parts if isinstance(result, Failed) else result) or [None]
        self.events = [f"problem {k}: {one.trouble}" for k, one in enumerate(given) if one.trouble]
        blank = Answer(NOT_ASKED, 0, np.full(joints_of(problems.rows.shape[1]), np.nan), np.full(6, np.nan))
        if reason or (failed and failed.kind == "raised"):  # the solver refuses the problems, or cannot be built
            self.refused, blank = reason or str(failed), blank._replace(status=REFUSED)
        elif failed and failed.kind != "not run":
            what = ", while setting up" if reason is None else ""
            self.events.append(f"problem {len(given)}{what}: {failed.reason}")
            given.append(blank._replace(status=HUNG if failed.kind == "hung" else CRASHED))
        self.every: list[Answer] = [*given, *[blank] * (len(problems.rows) - len(given))]
        self.status = np.array([one.status for one in self.every])
        self.x = np.array([one.x for one in self.every])
        self.residuals = compute_residuals(problems.judged, self.x, np.array([one.y for one in self.every]))
        self.verified = np.asarray(self.residuals.verified() & problems.feasible)

    @property
    def complete(self) -> bool:
        """Whether the solver answered or raised on every problem."""
        return not np.isin(self.status, (HUNG, CRASHED, NOT_ASKED, REFUSED)).any()

    def counts(self) -> dict[str, int]:
        """Count the answers by outcome (see docs/solvers.md).

        If six rows contradict each other, but five of them are feasible, the answer "infeasible" to the six rows counts
        as `refused_inconsistent`.
        """
        status, feasible = self.status, self.problems.feasible
        claimed, infeasible = status == "solved", status == "infeasible"
        moved = np.abs(fields(self.problems.judged).b - fields(self.problems.rows).b).max(axis=-1)
        inconsistent = (moved > CONTRADICTION) & feasible & self.setting.six_rows
        optimal, recognised, declined = claimed & self.verified, infeasible & ~feasible, inconsistent & infeasible
        unasked = np.isin(status, (NOT_ASKED, REFUSED))
        broken = {name: int((status == name).sum()) for name in (HUNG, CRASHED, RAISED)}
        gone = np.isin(status, (HUNG, CRASHED)) | unasked
        found = {
            "right": optimal | recognised, "feasible": feasible, "optima_asked": feasible & ~declined,
            "infeasible_asked": ~feasible, "inconsistent_asked": inconsistent, "claimed_solved": claimed,
            "verified_solved": optimal, "silently_wrong": claimed & ~self.verified,
            "infeasible_right": recognised, "refused_inconsistent": declined,
            "infeasible_wrong": infeasible & feasible & ~declined,
            "failed": ~claimed & ~recognised & ~declined & ~gone, "not_asked": unasked,
        }  # fmt: skip
        return {"solves": len(status), **{name: int(flags.sum()) for name, flags in found.items()}, **broken}

    def summary(self, times: Times | None = None) -> dict[str, Any]:
        """Return the entries for summary.json."""
        found: dict[str, Any] = dict(self.counts())
        answered = self.problems.feasible & np.isfinite(self.x).all(axis=1)
        for name in RESIDUALS:
            values = np.asarray(getattr(self.residuals, name))[answered]
            found[f"{name}_max"] = float(values.max()) if values.size else None
        if self.refused:
            found["reason"] = self.refused
        if self.events:
            found["trouble"] = f"{self.problems.name}, {self.events[0]}"
        return found | (times.figures() if times is not None else {})

    def rows(self, part: str) -> list[dict[str, Any]]:
        """Return one row per problem, for rows.parquet."""
        columns = {name: getattr(self.residuals, name).tolist() for name in RESIDUALS}
        columns |= {"feasible": self.problems.feasible.tolist(), "verified": self.verified.tolist()}
        about = {"part": part, "solver": self.setting.solver, "setting": self.setting.name, "set": self.problems.name}
        return [
            {**about, "index": i, "status": one.status, "iterations": one.iterations,
             **{name: column[i] for name, column in columns.items()}}
            for i, one in enumerate(self.every)
        ]  # fmt: skip


def share_right(counts: Mapping[str, Any]) -> float:
    """Return the share of right answers among the problems not refused as inconsistent."""
    asked = counts.get("solves", 0) - counts.get("refused_inconsistent", 0)
    return float(counts["right"] / asked) if asked else 0.0


def totals(answers: Sequence[Answers], times: Sequence[Times]) -> dict[str, Any]:
    """Return one solver's total counts, and its largest residuals and times over the sets."""
    rows, figures = [one.summary() for one in answers], [one.figures() for one in times]
    found: dict[str, Any] = {name: sum(row[name] for row in rows) for name in answers[0].counts()}
    for name in (f"{residual}_max" for residual in RESIDUALS):
        found[name] = max((row[name] for row in rows if row[name] is not None), default=None)
    for name in dict.fromkeys(name for entry in figures for name in entry if name.endswith("_us")):
        found[f"{name}_worst_set"] = max(entry[name] for entry in figures if name in entry)
    if figures:
        found |= total(figures)
    return found | next(({"trouble": row["trouble"]} for row in rows if "trouble" in row), {})


# --- asking ---


def ask(run: Runner, questions: Sequence[Question], limits: Limits, *, warm: bool = True) -> list[Answers]:
    """Collect the answers to each question. If ``warm``, a session solves a whole set; if not, one problem."""
    jobs = [
        Job(answer, (setting, problems.rows, warm, limits.patience_s, limits.setup_s), WHOLE_SET_S, group=setting.label)
        for setting, problems in questions
    ]
    results = run(jobs, give_up=BROKEN_SETS)
    return [Answers(*question, result) for question, result in zip(questions, results, strict=True)]


def answer(setting: SolverSetting, rows: Array, warm: bool, patience_s: float, setup_s: float) -> list[Any]:
    """Return the reason for a refusal ("" if none), then an `Answer` per problem.

    ``setup_s`` limits the processor time of the setup, and ``patience_s`` that of each answer.
    """
    found: list[Any] = []
    alarm(setup_s)
    for item in _answers(setting, rows, warm):
        alarm(patience_s)
        report(item)
        found.append(item)
    return found


def _answers(setting: SolverSetting, rows: Array, warm: bool) -> Iterator[Any]:
    solver, problems = _made(setting), _problems(rows)
    session, reason = _session(solver, problems[0])
    yield reason
    if session is None:
        return
    for qp in problems:
        said = ""
        if session is None or not warm:
            session, said = _session(solver, qp)
        solution, said = (no_answer(qp.n, Status.NUMERICAL), said) if session is None else _asked(session, qp)
        if said:  # the next problem goes to a new session
            session = None
            yield Answer(RAISED, 0, np.full(qp.n, np.nan), np.full(6, np.nan), said)
            continue
        y = np.full(6, np.nan) if solution.y is None else solution.y
        yield Answer(solution.status.label, solution.iterations, np.array(solution.x), np.array(y))


_robot = cache(load_robot)


def _made(setting: SolverSetting) -> Solver:
    return make_solver(setting.solver, _robot(), **setting.options)


def _problems(rows: Array) -> list[NullSpaceQP]:
    found = [NullSpaceQP.from_row(np.array(row)) for row in rows]
    for qp in found:
        _ = qp.q, qp.reduced()  # cached before times are taken
    return found


def _session(solver: Solver, qp: NullSpaceQP) -> tuple[Session | None, str]:
    """Return (session, ""), or (None, the reason or fault)."""
    try:
        reason = solver.supports(qp)
        if reason is None:
            session = solver.start(qp)
            return (session, "") if session is not None else (None, "start returned None: return a Session")
        return None, reason if isinstance(reason, str) and reason else f"supports returned {reason!r:.100}"
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a user's solver may raise anything
        return None, located(error)


def _asked(session: Session, qp: NullSpaceQP) -> tuple[Solution, str]:
    """Return the answer, and a description of a fault ("" if none)."""
    try:
        return received(session.solve(qp), qp.n)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - as above
        return no_answer(qp.n, Status.NUMERICAL), located(error)


# --- times ---


class Times(NamedTuple):
    """Times of one solver on one set [us]."""

    solve: Array  #: (rounds, k) warm solves in one session
    setup: Array  #: starts of sessions
    cold: Array  #: first solves of sessions
    update: Array  #: calls of `LibrarySession.update`; empty if the session has none
    load: Mapping[str, float]  #: the machine's load (`timing.COUNTED`)

    def figures(self) -> dict[str, Any]:
        """Return the entries for summary.json."""
        found: dict[str, Any] = {"timed_solves": int(self.solve.size), **self.load}
        for name in ("solve", "cold", "setup", "update"):
            found |= percentiles(getattr(self, name).ravel(), name)
        return found


def time(run: Runner, answers: Sequence[Answers], limits: Limits) -> list[Times | None]:
    """Time each solver on its problems. An entry is None if a problem was not answered, or if the timing failed."""
    limit = 20.0 * limits.seconds + limits.patience_s + limits.setup_s
    whole = [one for one in answers if one.complete]
    jobs = [
        Job(measure, (one.setting, one.problems.rows, max(1, len(one.problems.rows) // limits.cold), limits.rounds,
                      limits.seconds), limit, alone=True, group=one.setting.label)
        for one in whole
    ]  # fmt: skip
    found = dict(zip(map(id, whole), run(jobs, keep=lambda times: timing.quiet(times.load)), strict=True))
    return [None if isinstance(times := found.get(id(one)), Failed) else times for one in answers]


def measure(setting: SolverSetting, rows: Array, every: int, rounds: int, seconds: float) -> Times:
    """Time one session on all problems, and a new session on every ``every``-th problem.

    The session passes through all problems ``rounds`` times. After ``seconds`` of solving, no further pass begins.
    """
    solver, problems = _made(setting), _problems(rows)
    session = solver.start(problems[0])
    each_us(session.solve, problems[:WARM_UP])
    warm, seen = list[Array](), list[dict[str, float]]()
    while len(warm) < rounds and 1e-6 * sum(one.sum() for one in warm) <= seconds:
        warm.append(each_us(session.solve, problems, seen=seen))
    few, sessions = problems[::every], list[Any]()
    solver.start(few[0]).solve(few[0])
    setup = each_us(solver.start, few, sessions, seen)
    pairs = list(zip(sessions, few, strict=True))
    cold = each_us(lambda pair: pair[0].solve(pair[1]), pairs, seen=seen)
    update = getattr(sessions[0], "update", None)
    updates = np.empty(0) if update is None else each_us(update, few, seen=seen)
    return Times(np.array(warm), setup, cold, updates, total(seen))
