"""Workers of a sweep on this machine: processes that end with the one that started them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import Any, Self

from benchmarks.sweeps.engine import Table, Work
from benchmarks.sweeps.errors import WorkerError

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class LocalPool:
    """A process for each of ``workers`` runs at a time; begun anew, so that none inherits state from here.

    Raises:
        WorkerError: ``workers`` is less than one.
    """

    deaths: tuple[type[BaseException], ...] = (BrokenProcessPool,)
    attempts: int = 3
    falls_together: bool = True

    def __init__(self, workers: int) -> None:
        if workers < 1:
            raise WorkerError(f"workers = {workers}: give one or more")
        self.workers, self.shared = workers, workers > 1
        self._context = multiprocessing.get_context("spawn")

    def __enter__(self) -> Self:
        for name in THREADS:  # the workers are the parallelism; they read this when they begin
            os.environ.setdefault(name, "1")
        self._start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *exc: object) -> None:
        if kind is not None:
            self._alive.close()  # ends workers whose results are not read any more
        self._executor.shutdown(wait=True, cancel_futures=True)
        self._alive.close()

    def window(self) -> int:
        """One run under way and one waiting for each worker."""
        return 2 * self.workers

    def submit(self, work: Work, table: Table, limit_s: float) -> Future[dict[str, Any]]:
        """See ``engine.Pool``."""
        return self._executor.submit(work, table, limit_s)

    def renew(self) -> None:
        """New processes for those that a death took down."""
        self._executor.shutdown(wait=True, cancel_futures=True)
        self._alive.close()
        self._start()

    def _start(self) -> None:
        ours, self._alive = self._context.Pipe(duplex=False)
        self._executor = ProcessPoolExecutor(
            self.workers, mp_context=self._context, initializer=_begin, initargs=(ours,)
        )
        self._theirs = ours  # kept open until each worker has it


def _begin(parent: Connection) -> None:
    """In a worker: leave interrupts to the parent, and end when it does, however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Connection) -> None:
    parent.poll(None)  # returns when the other end is closed, which the kernel does for a killed process
    os._exit(1)
