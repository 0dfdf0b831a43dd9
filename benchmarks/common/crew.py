"""Several calls at a time, each in a process of its own: workers behind threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from queue import SimpleQueue
from typing import Any, Self, TypeVar

from benchmarks.common.kept import Kept
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
    work: Callable[[Item], Result], items: Sequence[Item], processes: int, done: Callable[[], Any],
    kept: Kept | None = None,
) -> list[Result]:  # fmt: skip
    """Return ``work(item)`` for every item, in order: for runs whose times are not what is measured.

    Args:
        work: a function of a module; items and results must pickle.
        processes: 1 works in this process.
        kept: where results go as they come, and from where those of an earlier run are taken.

    Raises:
        Crashed: a process died.
    """
    results: dict[int, Result] = {}

    def name(k: int) -> str:
        return f"{work.__module__}.{work.__qualname__}, {k + 1} of {len(items)}"

    def keep(k: int, result: Result) -> None:
        results[k] = result if kept is None else kept.put(name(k), result)
        done()

    for k in range(len(items) if kept is not None else 0):
        if kept is not None and (found := kept.get(name(k))) is not None:
            results[k] = found[0]
            done()

    waiting = [k for k in range(len(items)) if k not in results]
    if processes < 2 or len(waiting) < 2:
        for k in waiting:
            keep(k, work(items[k]))
    else:
        with Crew(min(processes, len(waiting)), fresh=True) as crew:
            futures = {crew.submit(Worker.call, work, items[k]): k for k in waiting}
            for future in as_completed(futures):
                keep(futures[future], future.result())
    return [results[k] for k in range(len(items))]
