"""A solver in its own process: whatever happens there, the loop waits only for a bounded time.

Without isolation a session runs inside the loop: a solver that hangs, ends the process or keeps the interpreter's lock
stops the loop too. `Isolated` wraps any solver that pickle can copy. Its sessions pass each subproblem to a process
through shared memory (`moc_opt.control.exchange`), wait for the answer at most ``budget_us``, and kill and replace a
process that hung, died or grew.

In simulated time a tick waits for the answer to its own subproblem, and simulated time stands still in the wait and
while a process is replaced. So a solver that keeps its budget gives the same run as without isolation, on a fast or a
slow machine. Against a wall clock (``waits=False``) nothing stands still: a second process is kept ready, and a tick
without a process uses the fallback.
"""

from __future__ import annotations

import os
import pickle
from typing import ClassVar, NamedTuple

from pydantic import Field

from moc_opt.control.exchange import ANSWERED, MALFORMED, SOLVE, START
from moc_opt.control.supervisor import Fault, Unanswered
from moc_opt.control.worker import STARTING, Worker
from moc_opt.errors import ControlError, MocOptError, describe
from moc_opt.inputs.settings import Settings
from moc_opt.numerics.arrays import Array
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.base import Session, Solution, Solver


class ProcessSettings(Settings):
    """When a solver's process is replaced, and how old its answers may be."""

    KIND: ClassVar[str] = "[solver.process]"
    ERROR: ClassVar[type[MocOptError]] = ControlError

    answer_age_ticks: int = Field(
        0, ge=0, description="largest age of an earlier answer that may replace a late one; 0: none may"
    )
    hang_s: float = Field(
        1.0, gt=0.0, description="a process that gives no answer for this time is killed and replaced"
    )
    memory_MB: float = Field(
        4096.0, gt=0.0, description="a process that uses more memory than this is killed and replaced"
    )
    most_restarts: int = Field(
        20, ge=0, description="largest number of replacements in a run; after them the third level falls back"
    )
    start_s: float = Field(120.0, gt=0.0, description="time in which a process must start, compilation included")


class Restart(NamedTuple):
    """The replacement of a process: the number of answers requested before, and the reason."""

    tick: int
    reason: str


class Isolated:
    """A solver whose sessions run each in its own process.

    Start a session in a thread that lives as long as it does: the process ends with that thread.

    Args:
        inner: any solver that pickle can copy.
        settings: when a process is replaced.
        budget_us: how long a tick waits for its answer [us]; None: until the process counts as hung.
        waits: whether a tick waits for a process that is being replaced, as in simulated time; False: it uses the
            fallback, and a second process is kept ready.

    Raises:
        ControlError: the solver cannot be copied into another process, or this is no Linux.
    """

    def __init__(
        self, inner: Solver, settings: ProcessSettings | None = None, budget_us: float | None = None, waits: bool = True
    ) -> None:
        if not hasattr(os, "memfd_create"):
            raise ControlError(
                "[solver] isolation = 'process' needs Linux: it shares memory without a name; take 'none'"
            )
        self.inner, self.settings, self.waits = inner, settings or ProcessSettings(), waits
        self.budget_us = float("inf") if budget_us is None else budget_us
        try:
            self._pickled = pickle.dumps(inner)
        except Exception as error:
            raise ControlError(
                f"solver {inner.name!r} cannot run in a process of its own: {describe(error)}: keep in its settings "
                "only what pickle can copy and make the rest in start, or take [solver] isolation = 'none'"
            ) from error
        self._idle: list[Worker] = []

    @property
    def name(self) -> str:
        """Name of the wrapped solver."""
        return self.inner.name

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return None: ``start`` asks the solver in its process."""
        return None

    def start(self, qp: NullSpaceQP) -> Session:
        """Start a session in a process of its own.

        Raises:
            ControlError: the process does not start, or the solver does not take the problem.
        """
        return IsolatedSession(self, qp)

    def worker(self, qp: NullSpaceQP) -> Worker:
        """Return a process that was told to start a session for problems like ``qp``."""
        worker = self._idle.pop() if self._idle else None
        if worker is None or worker.n != qp.n or not worker.usable:
            worker = Worker(self._pickled, qp.n)
        worker.post(START, qp.row)
        return worker

    def give_back(self, worker: Worker) -> None:
        """Keep a process for the next session."""
        self._idle.append(worker)


class IsolatedSession:
    """One session; ``restarts`` says when its process was replaced, and why."""

    def __init__(self, solver: Isolated, qp: NullSpaceQP) -> None:
        self._solver, self._settings = solver, solver.settings
        self._tick, self.restarts = 0, list[Restart]()
        self._v: Array | None = None
        self._workers = [solver.worker(qp)]
        wrong = self._workers[0].start(self._settings.start_s)
        if wrong:
            self._workers.pop().kill()
            cure = f"; raise [solver.process] start_s = {self._settings.start_s:g}" if wrong == STARTING else ""
            raise ControlError(f"solver {solver.name!r} in a process of its own: {wrong}{cure}")
        if self._workers[0].observes:
            self.observe = self._observe  # the controller calls ``observe`` if it exists
        self._keep_a_spare(qp)

    def _observe(self, v: Array) -> None:
        self._v = v

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem from the process.

        Raises:
            Unanswered: there is no answer in time, the solver raised, or its process is lost.
        """
        self._tick += 1
        worker, settings = self._ready(qp), self._settings
        number = worker.post(SOLVE, qp.row, self._v)
        found = worker.wait(number, min(self._solver.budget_us * 1e-6, settings.hang_s))
        if found is None and worker.silent_s >= settings.hang_s:
            found = f"it gave no answer for {settings.hang_s:g} s"
        if isinstance(found, str):
            self._lose(found)
            raise Unanswered(Fault.LOST, f"the solver's process was lost: {found}")
        if found is None:
            found = worker.exchange.answer(max(number - settings.answer_age_ticks, worker.first))
        grown_MB = worker.exchange.memory * 1e-6
        if grown_MB > settings.memory_MB:
            self._lose(f"it had {grown_MB:.0f} MB of memory, and {settings.memory_MB:g} MB are allowed")
        if found is None:
            raise Unanswered(Fault.LATE, f"{Fault.LATE.value}: no answer after {self._solver.budget_us:g} us")
        if found.kind == ANSWERED:
            return found.solution
        if found.kind == MALFORMED:  # the claim is kept, as without a process: a malformed answer is no optimum
            raise Unanswered(Fault.MALFORMED, found.text, found.solution.status)
        raise Unanswered(Fault.RAISED, found.text)

    def _ready(self, qp: NullSpaceQP) -> Worker:
        """Return the process that takes this tick's subproblem, its session started."""
        while self._workers or len(self.restarts) <= self._settings.most_restarts:
            if not self._workers:
                self._workers.append(self._solver.worker(qp))
            worker = self._workers[0]
            wrong = worker.start(self._settings.start_s if self._solver.waits else 0.0)
            if not wrong:
                self._keep_a_spare(qp)
                return worker
            if wrong == STARTING and not self._solver.waits and worker.silent_s < self._settings.start_s:
                raise Unanswered(Fault.LOST, "a new process of the solver is being started")
            self._lose(wrong)
        raise Unanswered(Fault.LOST, f"given up: the solver's process was lost {len(self.restarts)} times")

    def _lose(self, reason: str) -> None:
        self._workers.pop(0).kill()
        self.restarts.append(Restart(self._tick - 1, reason))

    def _keep_a_spare(self, qp: NullSpaceQP) -> None:
        spare = len(self._workers) < 2 and len(self.restarts) < self._settings.most_restarts
        if spare and not self._solver.waits:
            self._workers.append(self._solver.worker(qp))

    def __del__(self) -> None:
        for worker in getattr(self, "_workers", []):
            self._solver.give_back(worker)
