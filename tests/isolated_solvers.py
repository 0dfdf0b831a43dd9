"""Solvers that misbehave in ways that only a process of their own survives; pickle finds them in this module."""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from moc_opt.solvers.base import Solution, Status


def hang(qp):
    while True:
        pass


def ring_and_hang(qp):
    """Send the bytes that say that there is an answer, without one, for as long as the process lives."""
    bell = socket.socket(fileno=int(sys.argv[3]))
    while True:
        bell.send(b"\1")
        time.sleep(0.05)


def keep_the_lock(qp):
    """Sleep in C without giving up the interpreter's lock: no other thread of the process runs any more."""
    ctypes.PyDLL(None).sleep(1000)


def stop(qp):
    os.kill(os.getpid(), signal.SIGSTOP)


def exit_3(qp):
    os._exit(3)


def crash(qp):
    os.kill(os.getpid(), signal.SIGSEGV)


def fork_and_exit_3(qp):
    """End, and leave a child behind that keeps all that was open."""
    if os.fork() == 0:
        time.sleep(20.0)
    os._exit(3)


def close_everything(qp):
    os.closerange(3, 256)
    hang(qp)


def system_exit(qp):
    raise SystemExit("enough")


def interrupt(qp):
    raise KeyboardInterrupt


def shared_file():
    """The descriptor of the memory that this process shares with the loop, as any code in it could find it."""
    return next(int(fd.name) for fd in Path("/proc/self/fd").iterdir() if "memfd:" in os.readlink(fd))


def shrink(qp):
    """Cut the shared memory off: a look into it would then end the loop's process by SIGBUS."""
    os.ftruncate(shared_file(), 0)


def scribble(qp):
    """Fill the shared memory with ones, all numbers of the exchange among it."""
    fd = shared_file()
    os.pwrite(fd, b"\1" * min(4000, os.fstat(fd).st_size), 0)  # it cannot grow


def scribble_and_hang(qp):
    scribble(qp)
    hang(qp)


def huge(qp):
    return Solution(np.zeros(30_000_000), None, Status.SOLVED)


def unpicklable(qp):
    return Solution(lambda: None, None, Status.SOLVED)


@dataclass(frozen=True)
class Misbehaving:
    """Answers x = 0 with the velocity that it observed last as duals, but does ``act`` at problem ``at``."""

    act: object = None
    at: int = 2
    name: str = "misbehaving"

    def supports(self, qp):
        return None

    def start(self, qp):
        return _Session(self)


class _Session:
    def __init__(self, settings):
        self.settings, self.count, self.kept = settings, 0, []

    def solve(self, qp):
        self.count += 1
        if self.count == self.settings.at and self.settings.act is not None:
            found = self.settings.act(qp)
            if found is not None:
                return found
        return Solution(np.zeros(qp.n), None, Status.MAX_ITER, self.count)


@dataclass(frozen=True)
class Leaking:
    """Keeps 100 MB more with every problem."""

    name: str = "leaking"

    def supports(self, qp):
        return None

    def start(self, qp):
        session = _Session(Misbehaving())
        solve = session.solve

        def leak(qp):
            session.kept.append(np.ones(12_500_000))
            return solve(qp)

        session.solve = leak
        return session


@dataclass(frozen=True)
class Parent:
    """Starts a process of its own, writes its id to a file, and hangs."""

    file: str
    name: str = "parent"

    def supports(self, qp):
        return None

    def start(self, qp):
        return _Session(Misbehaving(self._act, 1))

    def _act(self, qp):
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1000)"])
        Path(self.file).write_text(str(child.pid))
        hang(qp)


@dataclass(frozen=True)
class Gated:
    """Answers problem k, with k as its iterations, when a file of that name lies in the folder."""

    folder: str
    name: str = "gated"

    def supports(self, qp):
        return None

    def start(self, qp):
        return _Session(Misbehaving()) if not self.folder else _Gated(Path(self.folder))


class _Gated:
    def __init__(self, folder):
        self.folder, self.observed = folder, np.full(7, np.nan)

    def observe(self, v):
        self.observed = v

    def solve(self, qp):
        number = round(qp.c0)
        while not (self.folder / str(number)).exists():
            pass
        return Solution(self.observed, qp.b.copy(), Status.SOLVED, number)


@dataclass(frozen=True)
class Refusing:
    """Takes no problem, ends its process, or raises, when it is asked to start."""

    how: str
    name: str = "refusing"

    def supports(self, qp):
        if self.how == "exit":
            os._exit(5)
        return "not this one" if self.how == "refuse" else None

    def start(self, qp):
        raise RuntimeError("no licence")


@dataclass(frozen=True)
class Locked:
    """Cannot be copied."""

    lock: object = field(default_factory=threading.Lock)
    name: str = "locked"
    supports = start = None
