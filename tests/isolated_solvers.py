"""Misbehaving solvers, in a module of their own so that worker processes import them quickly."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from moc_opt.solvers.base import Solution, Status


@dataclass(frozen=True)
class Misbehaving:
    """A solver that answers x = 0. From call number `at` on, it does `act`."""

    act: str = ""
    at: int = 2
    folder: str = ""
    name: str = "misbehaving"

    def supports(self, qp):
        return "not this one" if self.act == "refuse" else None

    def start(self, qp):
        if self.act == "fail at the start":
            raise RuntimeError("no licence")
        return GatedSession(Path(self.folder)) if self.act == "gated" else MisbehavingSession(self)


class MisbehavingSession:
    def __init__(self, settings):
        self.settings, self.count = settings, 0

    def solve(self, qp):
        self.count += 1
        if self.count >= self.settings.at and self.settings.act:
            ACTS[self.settings.act](self)
        return Solution(np.zeros(qp.n), None, Status.MAX_ITER, self.count)


class GatedSession:
    """A session that answers a problem with c0 = k as soon as a file named k exists."""

    def __init__(self, folder):
        self.folder, self.observed = folder, np.full(7, np.nan)

    def observe(self, v):
        self.observed = v

    def solve(self, qp):
        number = round(qp.c0)
        while not (self.folder / str(number)).exists():
            time.sleep(1e-3)
        return Solution(self.observed, qp.b.copy(), Status.SOLVED, number)


def hang(session):
    while True:
        pass


def fork_and_exit(session):
    """Exit, and leave a child that keeps all files open."""
    if os.fork() == 0:
        time.sleep(20.0)
    os._exit(3)


def child_and_hang(session):
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1000)"])
    Path(session.settings.folder, "pid").write_text(str(child.pid))
    hang(session)


ACTS = {
    "hang": hang, "exit": lambda session: os._exit(3), "fork and exit": fork_and_exit, "child and hang": child_and_hang,
    "crash": lambda session: os.kill(os.getpid(), signal.SIGSEGV),
    "close everything": lambda session: (os.closerange(3, 256), hang(session)),
    "eat": lambda session: np.empty(200_000_000),  # 1.6 GB
    "raise": lambda session: 1 / 0, "quit": lambda session: sys.exit("enough"),
}  # fmt: skip
