"""Workers of a sweep on this machine."""

from __future__ import annotations

import os
from concurrent.futures import Future
from typing import Any, Self

from benchmarks.common.crew import Crew
from benchmarks.common.processes import Crashed, Worker
from benchmarks.sweeps.engine import Table, Work
from benchmarks.sweeps.errors import WorkerError

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def cores() -> int:
    """Count the cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class LocalPool:
    """A process for each of ``workers`` runs at a time, a new interpreter, so that none inherits state from here.

    Raises:
        WorkerError: ``workers`` is less than one.
    """

    deaths: tuple[type[BaseException], ...] = (Crashed,)
    attempts: int = 3

    def __init__(self, workers: int) -> None:
        if workers < 1:
            raise WorkerError(f"workers = {workers}: give one or more")
        self.workers, self.shared = workers, workers > 1

    def __enter__(self) -> Self:
        for name in THREADS:  # the workers are the parallelism; they read this when they begin
            os.environ.setdefault(name, "1")
        self._crew = Crew(self.workers, fresh=True)
        return self

    def __exit__(self, kind: type[BaseException] | None, *exc: object) -> None:
        self._crew.__exit__(kind, *exc)

    def window(self) -> int:
        """Count the runs to keep in flight: one under way and one waiting for each worker."""
        return 2 * self.workers

    def submit(self, work: Work, table: Table, limit_s: float) -> Future[dict[str, Any]]:
        """Send one run; see `engine.Pool`."""
        return self._crew.submit(Worker.call, work, table, limit_s)
