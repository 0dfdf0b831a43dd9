"""The control loop's handle on the process of an isolated solver: send requests, wait for answers, kill."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import subprocess
import sys
import weakref
from time import monotonic_ns

from moc_opt.control.exchange import ANSWERED, OBSERVES, REFUSED, START, Answer, Exchange, shared_file
from moc_opt.inputs.files import to_json
from moc_opt.numerics.arrays import Array

STARTING = "it has not started in time"

_NS = 1_000_000_000
_LOOK_NS = 50_000_000
"""So often a wait looks whether the process is still there."""
# The caller's main module is not run again, as multiprocessing does: it may be a script without a guard.
_BOOT = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from moc_opt.control.worker_main import main; main(*map(int, sys.argv[2:]))"
)


class Worker:
    """A process that answers requests; it is killed when this object goes.

    Args:
        pickled: the solver.
    """

    def __init__(self, pickled: bytes, n: int) -> None:
        self.n, self.posted, self.first, self._since = n, 0, 1, monotonic_ns()
        self._answered, self._started, self.observes = 0, False, False
        fd = shared_file(pickled, n)
        self.exchange = Exchange(fd, n)
        self._bell, theirs = socket.socketpair()
        self._bell.setblocking(False)
        self._bells = select.poll()
        self._bells.register(self._bell, select.POLLIN)
        ends = (fd, theirs.fileno())
        self._process = subprocess.Popen(
            [sys.executable, "-c", _BOOT, to_json(sys.path, indent=None), *map(str, (*ends, n, os.getpid()))],
            stdin=subprocess.DEVNULL, pass_fds=ends, start_new_session=True,
        )  # fmt: skip
        os.close(fd)
        theirs.close()
        self._end = weakref.finalize(self, _kill, self._process, self._bell, os.getpid())

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def usable(self) -> bool:
        """Whether the process lives and has answered everything."""
        return self.exchange.answered >= self.posted and self._process.poll() is None

    @property
    def silent_s(self) -> float:
        """Time since its last answer, or since the first request after it [s]."""
        return (monotonic_ns() - self._since) / _NS

    def post(self, command: int, row: Array, v: Array | None = None) -> int:
        """Ask; return the number of the request."""
        self._answered = self.exchange.answered
        if self._answered >= self.posted:
            self._since = monotonic_ns()
        self.posted += 1
        if command == START:
            self.first, self._started = self.posted + 1, False
        self.exchange.post(self.posted, command, row, v)
        with contextlib.suppress(OSError):  # it has ended, which ``wait`` finds, or many bytes lie there already
            self._bell.send(b"\1")
        return self.posted

    def start(self, most_s: float) -> str:
        """Wait until the session has started; return what is wrong: ``STARTING`` after ``most_s``, "" for nothing."""
        if self._started:
            return ""
        found = self.wait(self.posted, most_s)
        if not isinstance(found, Answer):
            return found or STARTING
        if found.kind == ANSWERED:
            self._started, self.observes = True, found.text == OBSERVES
            return ""
        return found.text if found.kind == REFUSED else f"{found.text}: its class must lie in an importable module"

    def wait(self, number: int, most_s: float) -> Answer | str | None:
        """Return the answer to request ``number`` or a later one; how the process ended; None after ``most_s``."""
        until = monotonic_ns() + int(most_s * _NS)
        while True:
            if self.exchange.answered > self.posted:
                return "it wrote over the memory that it shares with the loop"
            found = self.exchange.answer(number)
            if found is not None:
                return found
            left = max(until - monotonic_ns(), 0)
            if not self._hear(min(left, _LOOK_NS)):
                return self.exchange.answer(number) or self._ending()
            # A child that it left behind may hold its end of the bell open.
            if self.exchange.answered < number and self._process.poll() is not None:
                return self.exchange.answer(number) or self._ending()
            if left == 0:
                return self.exchange.answer(number)

    def _hear(self, most_ns: int) -> bool:
        """Wait for a byte, and take all that lie there; False where the other end is closed."""
        if most_ns < 1_500_000:  # poll counts in milliseconds
            os.sched_yield()
            most_ns = 0
        if not self._bells.poll(most_ns // 1_000_000):
            return True
        try:
            heard = self._bell.recv(4096)
        except OSError:
            return False
        # A byte alone proves no new answer: it may belong to the last one, which was read before its byte came.
        if self.exchange.answered > self._answered:
            self._answered, self._since = self.exchange.answered, monotonic_ns()
        return bool(heard)

    def _ending(self) -> str:
        try:
            code = self._process.wait(timeout=0.2)
        except subprocess.TimeoutExpired:
            return "it closed its end of the connection"
        return f"it was killed by {signal.Signals(-code).name}" if code < 0 else f"it ended with status {code}"

    def kill(self) -> None:
        """Kill the process and its children at once; not those that have begun a session of their own (setsid)."""
        self._end()


def _kill(process: subprocess.Popen[bytes], bell: socket.socket, owner: int) -> None:
    if os.getpid() != owner:  # a copy of this object in a process that was forked from ours
        return
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    bell.close()
