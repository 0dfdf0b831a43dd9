"""A solver's process: it unpickles the solver, starts a session, and answers whatever request is the newest.

Started by `moc_opt.control.worker`, never by hand.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import socket

import numpy as np

from moc_opt.control.exchange import (
    ANSWERED,
    MALFORMED,
    OBSERVES,
    RAISED,
    REFUSED,
    START,
    Exchange,
    Request,
    size,
)
from moc_opt.control.session import start_session
from moc_opt.control.solution_check import received
from moc_opt.errors import MocOptError, describe
from moc_opt.qp.layout import joints_of
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.base import ObservingSession, Session, Solution, Status, no_answer

_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def main(fd: int, bell: int, n: int, parent: int) -> None:
    """Answer until the other end of the bell is closed.

    Args:
        fd: of the shared file: the memory for n joints, then the pickled solver.
        bell: of a socket: a byte in says that there is a request, a byte out that there is an answer.
        parent: process that asks; this one is killed with it, even in the middle of a solve.
    """
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before that
        return
    exchange, rings = Exchange(fd, n), socket.socket(fileno=bell)
    pages = os.open("/proc/self/statm", os.O_RDONLY)
    pickled = os.pread(fd, os.fstat(fd).st_size, size(n))
    session: Session | None = None
    done = 0
    while rings.recv(4096):
        while (request := exchange.request(after=done)) is not None:
            done = request.number
            kind, solution, text = ANSWERED, no_answer(n, Status.UNSUPPORTED), ""
            try:
                if request.command == START:
                    session = start_session(pickle.loads(pickled), NullSpaceQP.from_row(request.row))
                    text = OBSERVES if isinstance(session, ObservingSession) else ""
                elif session is not None:
                    kind, solution, text = _solve(session, request)
            except BaseException as error:  # noqa: BLE001 - foreign code may raise anything, and this process goes on
                refused = request.command == START and isinstance(error, MocOptError)
                kind, text = (REFUSED, str(error)) if refused else (RAISED, describe(error))
            exchange.give(done, kind, solution, text)
            rings.send(b"\1")
            exchange.memory = int(os.pread(pages, 64, 0).split()[1]) * os.sysconf("SC_PAGE_SIZE")


def _solve(session: Session, request: Request) -> tuple[int, Solution, str]:
    if request.v is not None:
        session.observe(request.v)  # type: ignore[attr-defined]
    given = session.solve(NullSpaceQP.from_row(request.row))
    solution, wrong = received(given, joints_of(np.size(request.row)))
    return (MALFORMED if wrong else ANSWERED), solution, wrong
