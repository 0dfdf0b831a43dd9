"""Several calls at a time, each in a process of its own: workers behind threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from queue import SimpleQueue
from typing import Any, Self, TypeVar

from benchmarks.common.processes import Worker

Item = TypeVar("Item")
Result = TypeVar("Result")


class Crew:
    """Several workers, each behind a thread of this process; use it as a context manager.

    Args:
        size: number of workers.
        fresh: see `Worker`.
    """

    def __init__(self, size: int, *, fresh: bool = False) -> None:
        self._workers = [Worker(fresh=fresh) for _ in range(size)]
        self._idle: SimpleQueue[Worker] = SimpleQueue()
        for worker in self._workers:
            self._idle.put(worker)
        self._threads = ThreadPoolExecutor(size)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *exc: object) -> None:
        if kind is not None:
            self._threads.shutdown(wait=False, cancel_futures=True)
            for worker in self._workers:
                worker.kill()
        self._threads.shutdown()
        for worker in self._workers:
            worker.stop()

    def submit(self, work: Callable[..., Result], *arguments: Any) -> Future[Result]:
        """Call ``work(worker, *arguments)`` in a thread, once a worker is free."""

        def call() -> Result:
            worker = self._idle.get()
            try:
                return work(worker, *arguments)
            finally:
                self._idle.put(worker)

        return self._threads.submit(call)


def spread(items: Sequence[Item], work: Callable[[Worker, Item], Result], processes: int) -> list[Result]:
    """Return ``work(worker, item)`` for every item, in order; each of ``processes`` threads has a worker of its own."""
    with Crew(max(1, min(processes, len(items)))) as crew:
        return [future.result() for future in [crew.submit(work, item) for item in items]]


def run_parallel(
    work: Callable[[Item], Result], items: Sequence[Item], processes: int, done: Callable[[], Any]
) -> list[Result]:
    """Return ``work(item)`` for every item, in order: for runs whose times are not what is measured.

    Args:
        work: a function of a module; items and results must pickle.
        processes: 1 works in this process.

    Raises:
        Crashed: a process died.
    """
    if processes < 2 or len(items) < 2:
        results = []
        for item in items:
            results.append(work(item))
            done()
        return results
    with Crew(min(processes, len(items)), fresh=True) as crew:
        futures = [crew.submit(Worker.call, work, item) for item in items]
        for future in as_completed(futures):
            future.result()
            done()
        return [future.result() for future in futures]
