"""A process of one's own for calls that may never return, or take the process with them.

A solver that hangs inside a compiled library cannot be interrupted from Python. So it runs in a worker that
hands over its results one by one; when the next one does not come in time, the worker is killed and a new one started.
"""

from __future__ import annotations

import math
import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from multiprocessing.connection import Connection
from queue import SimpleQueue
from types import TracebackType
from typing import Any, Self, TypeVar

from moc_opt.errors import MocOptError

Item = TypeVar("Item")
Result = TypeVar("Result")

START_S = 40.0  # for the first result: the worker may still be importing and compiling

_beat: Callable[[], None] | None = None  # set in a worker while it works


class WorkerError(MocOptError, RuntimeError):
    """A call in a worker did not come to its end."""


class Hung(WorkerError):
    """No result came in time; the worker was killed."""


class Crashed(WorkerError):
    """The worker died by itself, as by a segmentation fault."""


class Raised(WorkerError):
    """The call raised an exception; the worker lives."""


class Worker:
    """One worker process, started when first needed and started again after a hang or a crash.

    Use it as a context manager: leaving it ends the process.
    """

    def __init__(self) -> None:
        known = multiprocessing.get_all_start_methods()
        # Forked from a clean server that has imported everything, a new worker costs milliseconds, not seconds.
        self._context: Any = multiprocessing.get_context("forkserver" if "forkserver" in known else "spawn")
        if "forkserver" in known:
            self._context.set_forkserver_preload(["__main__", "benchmarks.solver_study.preload"])
        self._process: Any = None
        self._pipe: Connection | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def stop(self) -> None:
        """End the process, whatever it does."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process.close()
            self._process = None
        if self._pipe is not None:
            self._pipe.close()
            self._pipe = None

    def stream(
        self, make: Callable[..., Iterator[Any]], *arguments: Any, patience_s: float, first_s: float = START_S
    ) -> Iterator[Any]:
        """Yield what the generator function ``make(*arguments)`` yields in the worker.

        Args:
            make: a function of a module; arguments and results must pickle.
            arguments: its arguments.
            patience_s: how long the next result may take.
            first_s: how long the first one may take, on top of that.

        Raises:
            Hung: no result within that time.
            Crashed: the process died.
            Raised: the generator raised an exception.
        """
        pipe = self._start()
        pipe.send((make, arguments, patience_s + first_s))
        wait = patience_s + first_s
        try:
            while True:
                if not pipe.poll(wait):
                    self.stop()
                    raise Hung(f"no answer within {wait:g} s")  # the process is gone, and the answer with it
                kind, item = pipe.recv()
                wait = patience_s
                if kind == "beat":
                    continue
                if kind == "end":
                    return
                if kind == "raised":
                    raise Raised(item)
                yield item
        except (EOFError, ConnectionError) as error:
            self._process.join(5.0)
            code = self._process.exitcode
            self.stop()
            raise Crashed(f"the process died ({_reason(code)})") from error
        except GeneratorExit:
            self.stop()  # the rest is not needed, and the worker is still making it
            raise

    def _start(self) -> Connection:
        if self._pipe is None:
            mine, theirs = self._context.Pipe()
            self._process = self._context.Process(target=serve, args=(theirs,), daemon=True)
            self._process.start()
            theirs.close()
            self._pipe = mine
        return self._pipe


def beat() -> None:
    """Say from inside a worker that work goes on: the parent's patience starts anew. Elsewhere it does nothing."""
    if _beat is not None:
        _beat()


def serve(pipe: Connection) -> None:
    """The worker's side: run what is asked for until the other side closes."""
    global _beat
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    while True:
        try:
            make, arguments, limit = pipe.recv()
        except EOFError:
            return
        try:
            _alarm(limit)
            _beat = partial(_say, pipe, limit)
            for item in make(*arguments):
                pipe.send(("item", item))
                _alarm(limit)
            pipe.send(("end", None))
        except BrokenPipeError:
            return
        except Exception as error:  # noqa: BLE001 - whatever it was, it is handed over
            pipe.send(("raised", f"{type(error).__name__}: {error}"))
        finally:
            _alarm(0.0)


def _say(pipe: Connection, limit: float) -> None:
    _alarm(limit)
    pipe.send(("beat", None))


def _alarm(seconds: float) -> None:
    """The kernel ends this process should the parent be gone when a library hangs; it asks no interpreter."""
    if hasattr(signal, "alarm"):
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(math.ceil(seconds) + 60 if seconds else 0)


def _reason(code: int | None) -> str:
    if code is not None and code < 0:
        return signal.Signals(-code).name
    return f"exit code {code}"


def spread(items: Sequence[Item], work: Callable[[Worker, Item], Result], processes: int) -> list[Result]:
    """``work(worker, item)`` on every item, each of ``processes`` threads with a worker of its own; in order."""
    workers: SimpleQueue[Worker] = SimpleQueue()
    everyone = [Worker() for _ in range(max(1, min(processes, len(items))))]
    for worker in everyone:
        workers.put(worker)

    def call(item: Item) -> Result:
        worker = workers.get()
        try:
            return work(worker, item)
        finally:
            workers.put(worker)

    pool = ThreadPoolExecutor(len(everyone))
    try:
        return list(pool.map(call, items))
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    finally:
        for worker in everyone:
            worker.stop()
        pool.shutdown()
