"""A solver in a separate process, which is replaced if it crashes or hangs."""

from __future__ import annotations

import errno
import math
import os
import pickle
import resource
import signal
import subprocess
import sys
import weakref
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, Pipe
from time import monotonic
from typing import Any, ClassVar, Literal, NamedTuple

from pydantic import Field

from moc_opt.arrays import Array
from moc_opt.errors import MocOptError, SolverError, describe, located
from moc_opt.inputs.settings import Settings
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.base import ObservingSession, Session, Solution, Solver

_LOOK_S = 0.05  # time between checks of whether the process has ended [s]


class Unanswered(Exception):
    """A tick has no answer: the answer is late, the solver raised, or its process was lost."""

    def __init__(self, kind: Literal["late", "raised", "lost"], text: str) -> None:
        super().__init__(text)
        self.kind, self.text = kind, text


class Restart(NamedTuple):
    """The loss of a process."""

    tick: int  #: number of solves before the failed one
    reason: str


class ProcessSettings(Settings):
    """Limits of the solver's own process, if [solver] isolation = 'process'."""

    KIND: ClassVar[str] = "[solver.process]"
    answer_age_ticks: int = Field(0, ge=0)
    """largest age of an earlier answer that is used if the answer of this tick is late. 0: none is used"""
    hang_s: float = Field(1.0, gt=0.0)
    """time without an answer after which the solver's process is killed and replaced"""
    memory_MB: float = Field(4096.0, gt=0.0)
    """largest memory of the solver's process. If it needs more, it ends and is replaced"""
    most_restarts: int = Field(20, ge=0)
    """largest number of replacements of the solver's process in a run. After them, the run goes on without the
    solver"""
    start_s: float = Field(120.0, gt=0.0)
    """longest time for starting the solver's process, including compilation"""


@dataclass(frozen=True)
class Isolated:
    """A solver whose sessions run in separate processes. Raise a SolverError if it cannot be pickled."""

    inner: Solver
    process: ProcessSettings
    budget_us: float = math.inf  #: longest time that a tick waits for an answer [us]
    waits: bool = True  #: whether a tick waits while a process is replaced; False in real time
    _pickled: bytes = field(default=b"", init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if os.name != "posix":
            raise SolverError("[solver] isolation = 'process' needs Linux or macOS; set 'none'")
        try:
            object.__setattr__(self, "_pickled", pickle.dumps(self.inner))
        except Exception as error:
            raise SolverError(
                f"solver {self.name!r} cannot run in a process of its own: {describe(error)}: keep only "
                "picklable values in its settings and create the rest in start(), or set [solver] isolation = 'none'"
            ) from error

    @property
    def name(self) -> str:
        """Name of the wrapped solver."""
        return self.inner.name

    def supports(self, qp: NullSpaceQP) -> str | None:
        """Return None. ``start`` asks the wrapped solver, in the new process."""
        return None

    def start(self, qp: NullSpaceQP) -> Session:
        """Start a session. Raise a SolverError if this fails or the solver refuses the problem."""
        return IsolatedSession(self, qp)


class IsolatedSession:
    """A session. ``restarts`` lists the losses of its process."""

    def __init__(self, solver: Isolated, qp: NullSpaceQP) -> None:
        self._solver, self._tick, self.restarts = solver, 0, list[Restart]()
        self._v: Array | None = None
        self._newest: _Answer | None = None
        self._process: _Process | None = _Process(solver, qp)
        try:
            self._process.started(math.inf)
        except _Ended as ended:
            raise SolverError(f"solver {solver.name!r} in a process of its own: {ended}") from None

    def observe(self, v: Array) -> None:
        """Store the measured joint velocity v (n,) [rad/s]."""
        self._v = v

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Solve one subproblem. Raise Unanswered if the answer is late or absent."""
        self._tick += 1
        solver = self._solver
        if self._process is None:
            if len(self.restarts) > solver.process.most_restarts:
                raise Unanswered("lost", f"the solver is given up: its process was lost {len(self.restarts)} times")
            self._process = _Process(solver, qp)
        try:
            newest = self._answered(self._process, qp)
        except _Ended as ended:
            self._process.kill()
            self._process = self._newest = None
            self.restarts.append(Restart(self._tick - 1, str(ended)))
            raise Unanswered("lost", f"the solver's process was lost: {ended}") from None
        if newest is None or self._tick - newest.tick > solver.process.answer_age_ticks:
            raise Unanswered("late", f"no answer after {solver.budget_us:g} us")
        if newest.raised:
            raise Unanswered("raised", newest.value)
        return newest.value  # type: ignore[no-any-return]  # its form is checked by the controller

    def _answered(self, process: _Process, qp: NullSpaceQP) -> _Answer | None:
        """Wait for at most ``budget_us``. Return the newest answer, even of an earlier tick, or None if none came."""
        solver = self._solver
        if not process.started(math.inf if solver.waits else 0.0):
            raise Unanswered("lost", "a new process of the solver is being started")
        until = monotonic() + 1e-6 * solver.budget_us
        if process.busy:  # with the subproblem of an earlier tick
            self._newest = process.answer(until) or self._newest
        if not process.busy:
            process.ask(self._tick, qp, self._v, solver.process.hang_s)
            self._newest = process.answer(until) or self._newest
        return self._newest


class _Answer(NamedTuple):
    tick: int  # from 1; 0: reply to the request to start a session
    raised: bool
    value: Any  # the solver's answer or the exception's message


class _Ended(Exception):
    """A process can no longer be used."""


class _Process:
    """A process that answers requests. It is killed when this object is deleted."""

    # A multiprocessing.Process would run the caller's script again.

    def __init__(self, solver: Isolated, qp: NullSpaceQP) -> None:
        self._pipe, theirs = Pipe()
        program = "import sys; from moc_opt.solvers.isolated import serve; serve(int(sys.argv[1]), float(sys.argv[2]))"
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-c", program, str(theirs.fileno()), str(solver.process.memory_MB)],
                pass_fds=[theirs.fileno()], env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
                start_new_session=True,
            )  # fmt: skip
        self.kill = weakref.finalize(self, _kill, self._process, self._pipe, os.getpid())
        self._started = False
        self.ask(0, qp, None, solver.process.start_s, solver._pickled)

    def ask(self, tick: int, qp: NullSpaceQP, v: Array | None, most_s: float, solver: bytes | None = None) -> None:
        """Request an answer or, with a pickled ``solver``, the start of a session.

        If no reply comes within ``most_s`` [s], `answer` raises _Ended.
        """
        self._tick, self._most_s, self._hung_at, self.busy = tick, most_s, monotonic() + most_s, True
        with suppress(OSError):  # `answer` reports that the process has ended
            self._pipe.send((solver, qp.row, v, most_s))

    def started(self, most_s: float) -> bool:
        """Wait at most ``most_s`` [s] for the session's start. Return whether it has started."""
        if not self._started and (said := self.answer(monotonic() + most_s)) is not None:
            if said.raised:
                raise _Ended(said.value)
            self._started = True
        return self._started

    def answer(self, until: float) -> _Answer | None:
        """Return the answer, or None if none comes before ``monotonic()`` reaches ``until``."""
        while True:
            left = max(min(until, self._hung_at) - monotonic(), 0.0)
            try:
                if self._pipe.poll(min(left, _LOOK_S)):
                    answer = _Answer(self._tick, *self._pipe.recv())
                    self.busy = False
                    return answer
            except (EOFError, OSError):
                raise _Ended(self._ending()) from None
            if self._process.poll() is not None:
                raise _Ended(self._ending())
            if monotonic() >= self._hung_at:
                raise _Ended(f"it gave no answer for {self._most_s:g} s")
            if left == 0.0:
                return None

    def _ending(self) -> str:
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=0.2)
        code = self._process.returncode
        if code is None:
            return "it closed its end of the connection"
        if code == errno.ENOMEM:
            return "its memory was full: raise [solver.process] memory_MB"
        return f"it was killed by {signal.Signals(-code).name}" if code < 0 else f"it ended with status {code}"


def _kill(process: subprocess.Popen[bytes], pipe: Connection, owner: int) -> None:
    if os.getpid() != owner:  # a copy in a forked process
        return
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    pipe.close()


def serve(fd: int, memory_MB: float) -> None:
    """Answer requests from the pipe ``fd`` until it is closed."""
    most, hard = int(1e6 * memory_MB), resource.getrlimit(resource.RLIMIT_DATA)[1]
    resource.setrlimit(resource.RLIMIT_DATA, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
    pipe = Connection(fd)
    session: Any = None
    while True:
        try:
            solver, row, v, most_s = pipe.recv()
        except (EOFError, OSError):
            return
        # The timer ends this process if it hangs after its parent has ended.
        signal.setitimer(signal.ITIMER_REAL, 2.0 * most_s + 1.0)
        try:
            qp = NullSpaceQP.from_row(row)
            if solver is not None:
                session, found = _start(solver, qp), None
            else:
                if v is not None and isinstance(session, ObservingSession):
                    session.observe(v)
                found = session.solve(qp)
            answer = pickle.dumps((False, found))
        except MemoryError:
            os._exit(errno.ENOMEM)
        except BaseException as error:  # noqa: BLE001 - a plug-in may raise anything
            answer = pickle.dumps((True, str(error) if isinstance(error, MocOptError) else located(error)))
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        pipe.send_bytes(answer)


def _start(pickled: bytes, qp: NullSpaceQP) -> Session:
    try:
        solver: Solver = pickle.loads(pickled)
    except (ImportError, AttributeError) as error:
        raise SolverError(f"{describe(error)}: the solver's class must be in an importable module") from error
    if (reason := solver.supports(qp)) is not None:
        raise SolverError(f"it does not accept this subproblem: {reason}")
    return solver.start(qp)
