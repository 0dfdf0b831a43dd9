"""A solver in a process of its own: whatever happens there, the control loop waits only for a bounded time.

Without isolation a session runs inside the loop: a solver that hangs, ends the process or keeps the interpreter's lock
stops the loop too. `Isolated` wraps any solver that pickle can copy. Its sessions send each subproblem to a process,
wait for the answer at most ``budget_us``, and kill and replace a process that hung, ended or ran out of memory.

In simulated time a tick waits for the answer to its own subproblem, and simulated time stands still in the wait and
while a process is replaced. So a solver that keeps its budget gives the same run as without isolation, on a fast or a
slow machine. Against a wall clock (``waits=False``) nothing stands still: a second process is kept ready, and a tick
without a process has no answer.
"""

from __future__ import annotations

import math
import os
import pickle
import select
import signal
import subprocess
import sys
import tempfile
import weakref
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, Pipe
from time import monotonic
from typing import Any, Literal, NamedTuple

from moc_opt.arrays import Array
from moc_opt.errors import MocOptError, SolverError, describe
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.base import ObservingSession, Session, Solution, Solver

MOST_BYTES = 1 << 16
"""Largest message: the pipe takes it whole, so that neither side waits for the other in the middle of one."""
_LOOK_S = 0.05  # a wait looks this often whether the process is still there: a child of it may hold the pipe open
_START = 0  # number of the request to start a session; requests to solve have the number of their tick, from 1 on


class Unanswered(Exception):
    """There is no answer: it is late, or the solver raised, or its process was lost."""

    def __init__(self, kind: Literal["late", "raised", "lost"], text: str) -> None:
        super().__init__(text)
        self.kind, self.text = kind, text


class Restart(NamedTuple):
    """The replacement of a process: the number of answers requested before, and the reason."""

    tick: int
    reason: str


@dataclass(frozen=True)
class Isolated:
    """A solver whose sessions run each in a process of its own.

    Attributes:
        inner: any solver that pickle can copy.
        budget_us: how long a tick waits for its answer [us].
        waits: whether a tick waits for a process that is being replaced, as in simulated time; False: it has no answer,
            and a second process is kept ready.
        answer_age_ticks: largest age of an earlier answer that may replace a late one; 0: none may.
        hang_s: a process that gives no answer for this time is killed and replaced [s].
        memory_MB: memory that a process may have; on Linux.
        most_restarts: after so many replacements a session gives no answers any more.
        start_s: time in which a process must start [s].

    Raises:
        SolverError: the solver cannot be copied into another process, or this is no Unix.
    """

    inner: Solver
    budget_us: float = math.inf
    waits: bool = True
    answer_age_ticks: int = 0
    hang_s: float = 1.0
    memory_MB: float = 4096.0
    most_restarts: int = 20
    start_s: float = 120.0
    _pickled: bytes = field(default=b"", init=False, repr=False, compare=False)
    _idle: list[_Worker] = field(default_factory=list, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if os.name != "posix":
            raise SolverError("[solver] isolation = 'process' needs Linux or macOS; take 'none'")
        try:
            object.__setattr__(self, "_pickled", pickle.dumps(self.inner))
        except Exception as error:
            raise SolverError(
                f"solver {self.name!r} cannot run in a process of its own: {describe(error)}: keep in its settings "
                "only what pickle can copy and make the rest in start, or take [solver] isolation = 'none'"
            ) from error

    @property
    def name(self) -> str:
        """Name of the wrapped solver."""
        return self.inner.name

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return None: ``start`` asks the solver in its process."""
        return None

    def start(self, qp: NullSpaceQP) -> Session:
        """Start a session; a SolverError where its process does not start, or the solver does not take the problem."""
        return IsolatedSession(self, qp)

    def _worker(self, qp: NullSpaceQP) -> _Worker:
        """Return a process that is starting a session: one that an earlier session has left, or a new one."""
        worker = self._idle.pop() if self._idle else None
        if worker is None or not worker.usable:
            worker = _Worker(self._pickled, self.memory_MB)
        worker.ask(_START, qp.row, None, self.start_s)
        return worker


class IsolatedSession:
    """One session; ``restarts`` says when its process was replaced, and why."""

    def __init__(self, solver: Isolated, qp: NullSpaceQP) -> None:
        self._solver, self._tick, self.restarts = solver, 0, list[Restart]()
        self._v: Array | None = None
        self._newest: _Answer | None = None
        self._workers = list[_Worker]()  # the one at work, then the one that is kept ready
        self._fill(qp)
        try:
            if not self._workers[0].started(solver.start_s):
                raise _Ended(f"it has not started in time; raise [solver.process] start_s = {solver.start_s:g}")
        except _Ended as ended:
            self._workers.pop(0).kill()
            raise SolverError(f"solver {solver.name!r} in a process of its own: {ended}") from None
        if self._workers[0].observes:
            self.observe = self._observe  # the controller calls ``observe`` if it exists

    def _observe(self, v: Array) -> None:
        self._v = v

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem from the process; Unanswered where it is late or lost, or the solver raised."""
        self._tick += 1
        worker, solver = self._ready(qp), self._solver
        until = monotonic() + 1e-6 * solver.budget_us
        try:
            if worker.busy:  # with the subproblem of an earlier tick
                self._newest = worker.answer(min(until, worker.asked_at + solver.hang_s)) or self._newest
            if not worker.busy:
                worker.ask(self._tick, qp.row, self._v, 2.0 * solver.hang_s + 1.0)
                self._newest = worker.answer(min(until, worker.asked_at + solver.hang_s)) or self._newest
            if worker.busy and monotonic() >= worker.asked_at + solver.hang_s:
                raise _Ended(f"it gave no answer for {solver.hang_s:g} s")
            newest = self._newest
            if newest is not None and newest.kind == "full":
                raise _Ended(f"its {solver.memory_MB:g} MB of memory were full: {newest.value}")
        except _Ended as ended:
            self._lose(str(ended))
            raise Unanswered("lost", f"the solver's process was lost: {ended}") from None
        if newest is None or self._tick - newest.number > solver.answer_age_ticks:
            raise Unanswered("late", f"no answer after {solver.budget_us:g} us")
        if newest.kind == "raised":
            raise Unanswered("raised", newest.value)
        answer: Solution = newest.value  # of any form, as from a session without isolation: the controller checks it
        return answer

    def _fill(self, qp: NullSpaceQP) -> None:
        """Start the processes that are lacking: one, and against a wall clock a spare one."""
        solver, workers = self._solver, self._workers
        while len(workers) < 2 - solver.waits and len(workers) + len(self.restarts) <= solver.most_restarts:
            workers.append(solver._worker(qp))

    def _ready(self, qp: NullSpaceQP) -> _Worker:
        solver = self._solver
        while True:
            self._fill(qp)
            if not self._workers:
                raise Unanswered("lost", f"given up: the solver's process was lost {len(self.restarts)} times")
            worker = self._workers[0]
            try:
                if worker.started(solver.start_s if solver.waits else 0.0):
                    return worker
                if monotonic() < worker.asked_at + solver.start_s:
                    raise Unanswered("lost", "a new process of the solver is being started")
                raise _Ended("it has not started in time")
            except _Ended as ended:
                self._lose(str(ended))

    def _lose(self, reason: str) -> None:
        self._workers.pop(0).kill()
        self._newest = None
        self.restarts.append(Restart(self._tick - 1, reason))

    def __del__(self) -> None:
        for worker in getattr(self, "_workers", []):
            if worker.usable:  # for the next session: a process takes a second to start
                self._solver._idle.append(worker)
            else:
                worker.kill()


class _Answer(NamedTuple):
    number: int  # of the request
    kind: Literal["answered", "raised", "full"]
    value: Any  # the solver's answer; whether a session that was started observes; or what was raised, in words


class _Ended(Exception):
    """A process is of no more use; the text says why."""


class _Worker:
    """The loop's handle on a process that answers one request after another; it is killed when this object goes.

    A Popen, since multiprocessing's Process runs the caller's main module once more, which may be a script without a
    guard, and since the workers of a process pool may not have children of that kind.
    """

    def __init__(self, pickled: bytes, memory_MB: float) -> None:
        self._pipe, theirs = Pipe()
        with theirs, tempfile.TemporaryFile(buffering=0) as file:  # a pipe would have to be read meanwhile
            file.write(pickle.dumps((sys.path, memory_MB)) + pickled)
            file.seek(0)
            self._process = subprocess.Popen(
                [sys.executable, "-c", _BOOT, str(theirs.fileno())], stdin=file, pass_fds=[theirs.fileno()],
                start_new_session=True,
            )  # fmt: skip
        self._number, self.asked_at, self.busy = _START, monotonic(), False
        self._started, self.observes = False, False
        self.kill = weakref.finalize(self, _kill, self._process, self._pipe, os.getpid())

    @property
    def usable(self) -> bool:
        return not self.busy and self._process.poll() is None

    def ask(self, number: int, row: Array, v: Array | None, most_s: float) -> None:
        """Send a request; the process ends by itself if it takes longer than ``most_s``, however this one ended."""
        self._number, self.asked_at, self.busy = number, monotonic(), True
        self._started = self._started and number != _START
        with suppress(OSError):  # the process has ended, which ``answer`` finds
            self._pipe.send((number, row, v, most_s))

    def started(self, most_s: float) -> bool:
        """Wait until the session has started, at most so long; raise _Ended where it cannot."""
        if not self._started:
            said = self.answer(monotonic() + most_s)
            if said is None:
                return False
            if said.kind != "answered":
                raise _Ended(said.value)
            self._started, self.observes = True, said.value
        return True

    def answer(self, until: float) -> _Answer | None:
        """Wait for the answer until then (of ``time.monotonic``); raise _Ended where the process has ended."""
        while True:
            left = max(until - monotonic(), 0.0)
            if select.select([self._pipe], [], [], min(left, _LOOK_S))[0]:
                try:
                    message = self._pipe.recv_bytes(MOST_BYTES)
                except (EOFError, OSError):
                    raise _Ended(self._ending()) from None
                self.busy = False
                return _Answer(self._number, *pickle.loads(message))
            if self._process.poll() is not None:
                raise _Ended(self._ending())
            if left == 0.0:
                return None

    def _ending(self) -> str:
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=0.2)
        code = self._process.returncode
        if code is None:
            return "it closed its end of the connection"
        return f"it was killed by {signal.Signals(-code).name}" if code < 0 else f"it ended with status {code}"


def _kill(process: subprocess.Popen[bytes], pipe: Connection, owner: int) -> None:
    """Kill a process and its children at once; not those that have begun a session of their own (setsid)."""
    if os.getpid() != owner:  # a copy of the handle in a process that was forked from ours
        return
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    pipe.close()


# --- in the process ---

_BOOT = (
    "import pickle, sys; sys.path[:], memory_MB = pickle.load(sys.stdin.buffer); "
    "from moc_opt.solvers.isolated import serve; serve(int(sys.argv[1]), memory_MB)"
)


def serve(fd: int, memory_MB: float) -> None:
    """Answer the requests that come through the pipe ``fd`` until its other end is closed.

    The pickled solver lies in the standard input; ``memory_MB`` is what the process may have.
    """
    if sys.platform == "linux":
        import resource  # late: there is none on Windows

        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        most = int(1e6 * memory_MB)
        resource.setrlimit(resource.RLIMIT_DATA, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
    pipe, pickled = Connection(fd), sys.stdin.buffer.read()
    session: Any = None
    while True:
        try:
            number, row, v, most_s = pipe.recv()
        except (EOFError, OSError):
            return
        signal.setitimer(signal.ITIMER_REAL, most_s)  # its signal ends the process, whatever hangs in it
        try:
            if number == _START:
                session = _started_session(pickled, NullSpaceQP.from_row(row))
                answer = pickle.dumps(("answered", isinstance(session, ObservingSession)))
            else:
                if v is not None:
                    session.observe(v)
                answer = pickle.dumps(("answered", session.solve(NullSpaceQP.from_row(row))))
                if len(answer) > MOST_BYTES:
                    raise ValueError(f"an answer of {len(answer)} bytes: return a Solution for this subproblem")
        except MemoryError as error:
            answer = pickle.dumps(("full", describe(error)))
        except BaseException as error:  # noqa: BLE001 - foreign code may raise anything, and this process goes on
            answer = pickle.dumps(("raised", str(error) if isinstance(error, MocOptError) else describe(error)))
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        pipe.send_bytes(answer)


def _started_session(pickled: bytes, qp: NullSpaceQP) -> Session:
    try:
        solver: Solver = pickle.loads(pickled)
    except (ImportError, AttributeError) as error:
        raise SolverError(f"{describe(error)}: its class must lie in an importable module") from error
    reason = solver.supports(qp)
    if reason is not None:
        raise SolverError(f"it does not take this subproblem: {reason}")
    return solver.start(qp)
