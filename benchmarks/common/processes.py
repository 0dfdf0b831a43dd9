"""Calls in another process of this machine, with a limit of time, crashes told from hangs; see `crew` for several.

A call that hangs inside a compiled library cannot be interrupted from Python, and one that crashes takes its process
with it. So a worker process hands over the results of a generator one by one; when the next one does not come in
time, the worker is killed and a new one started. What came before stays. Libraries of process pools limit a whole
call; here every result, and every sign of life within one, starts the time anew.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection, wait
from typing import Any, Self, TypeVar

from moc_opt.errors import MocOptError

Result = TypeVar("Result")

START_S = 40.0
"""For the first result: the worker may still be importing and compiling."""
PRELOAD = ("__main__", "benchmarks.common.preload")

_beat: Callable[[], None] | None = None  # set in a worker while it works


class WorkerError(MocOptError, RuntimeError):
    """A call in a worker did not come to its end."""


class Hung(WorkerError):
    """No result came in time; the worker was killed."""


class Crashed(WorkerError):
    """The worker died by itself, as by a segmentation fault."""


class Raised(WorkerError):
    """The call raised an exception; the worker lives. The exception is the cause, where it can be pickled."""


class Worker:
    """One process, started when first needed and started again after a hang or a crash.

    It ends with this process, however that ends. Use it as a context manager: leaving it ends the process.

    Args:
        fresh: a new interpreter, which inherits nothing; else it is forked from a server that has imported
            ``preload``, which takes milliseconds instead of seconds.
        preload: modules; those of the first worker of this process are taken.
    """

    def __init__(self, *, fresh: bool = False, preload: Sequence[str] = PRELOAD) -> None:
        forks = not fresh and "forkserver" in multiprocessing.get_all_start_methods()
        self._context: Any = multiprocessing.get_context("forkserver" if forks else "spawn")
        if forks:
            self._context.set_forkserver_preload(list(preload))
        self._process: Any = None
        self._pipe: Connection | None = None
        self._starting, self._ended = threading.Lock(), False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *exc: object) -> None:
        self.stop()

    def kill(self) -> None:
        """End this worker for good, from any thread: who waits for a result gets `Crashed`."""
        with self._starting:
            self._ended = True
            self._kill()

    def stop(self) -> None:
        """End the process, whatever it does."""
        with self._starting:
            if self._process is not None:
                self._kill()
                self._process.join()
                self._process.close()
                self._process = None
            if self._pipe is not None:
                self._pipe.close()
                self._pipe = None

    def stream(
        self, make: Callable[..., Iterator[Any]], *arguments: Any, patience_s: float | None, first_s: float = START_S,
        on_beat: Callable[[], Any] = lambda: None,
    ) -> Iterator[Any]:  # fmt: skip
        """Yield what the generator function ``make(*arguments)`` yields in the worker.

        Args:
            make: a function of a module; arguments and results must pickle.
            patience_s: how long the next result or sign of life may take; None: for ever.
            first_s: how long the first one may take, on top of that.
            on_beat: called here for every `beat` there.

        Raises:
            Hung: no result within that time.
            Crashed: the process died.
            Raised: the generator raised an exception.
        """
        pipe = self._start()
        limit = None if patience_s is None else patience_s + first_s
        try:
            pipe.send((make, arguments, limit))
            while True:
                if not pipe.poll(limit):
                    self.stop()
                    raise Hung(f"no answer within {limit:g} s")
                kind, item = pipe.recv()
                limit = patience_s
                if kind == "beat":
                    on_beat()
                elif kind == "end":
                    return
                elif kind == "raised":
                    text, pickled = item
                    raise Raised(text) from _loaded(pickled)
                else:
                    yield item
        except (EOFError, ConnectionError) as error:
            self._process.join(5.0)
            code = self._process.exitcode
            self.stop()
            raise Crashed(f"the process died ({_reason(code)})") from error
        except GeneratorExit:
            self.stop()  # the rest is not needed, and the worker is still making it
            raise

    def call(self, work: Callable[..., Result], *arguments: Any, patience_s: float | None = None) -> Result:
        """Return ``work(*arguments)`` from the worker; its exception is raised here.

        Raises:
            Hung: no result in time.
            Crashed: the process died.
        """
        try:
            (result,) = self.stream(_once, work, *arguments, patience_s=patience_s)
        except Raised as raised:
            raise (raised.__cause__ or raised) from None
        found: Result = result
        return found

    def _start(self) -> Connection:
        with self._starting:
            if self._ended:
                raise Crashed("the worker was stopped")
            if self._pipe is None:
                mine, theirs = self._context.Pipe()
                process = self._context.Process(target=serve, args=(theirs,), daemon=True)
                process.start()
                self._process = process
                theirs.close()
                self._pipe = mine
            return self._pipe

    def _kill(self) -> None:
        if self._process is not None:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)  # what it has started is in its group
            self._process.kill()


def beat() -> None:
    """Say from inside a worker that work goes on: the parent's patience starts anew. Elsewhere it does nothing."""
    if _beat is not None:
        _beat()


def serve(pipe: Connection) -> None:
    """Run in the worker what is asked for, until the other side closes."""
    global _beat
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    os.setpgrp()  # so that what it starts can be killed with it
    threading.Thread(target=_end_with_parent, daemon=True).start()
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
        except BaseException as error:  # noqa: BLE001 - whatever it was, it is handed over
            pipe.send(("raised", (f"{type(error).__name__}: {error}", _dumped(error))))
        finally:
            _alarm(None)


def _once(work: Callable[..., Result], *arguments: Any) -> Iterator[Result]:
    yield work(*arguments)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])  # which the kernel closes, also for a process that is killed
    os._exit(1)


def _say(pipe: Connection, limit: float | None) -> None:
    _alarm(limit)
    pipe.send(("beat", None))


def _alarm(seconds: float | None) -> None:
    """Let the kernel end this process should the parent be gone when a library hangs; it asks no interpreter."""
    if hasattr(signal, "alarm"):
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(0 if seconds is None else math.ceil(seconds) + 60)


def _dumped(error: BaseException) -> bytes:
    try:
        return pickle.dumps((type(error), error.args, error.__dict__))
    except Exception:  # noqa: BLE001 - an exception may hold anything; its text is handed over all the same
        return b""


def _loaded(pickled: bytes) -> BaseException | None:
    """Return the exception, made without its constructor, which may take other arguments than it keeps."""
    try:
        kind, arguments, state = pickle.loads(pickled)
        found: BaseException = kind.__new__(kind, *arguments)
        found.__dict__.update(state)
    except Exception:  # noqa: BLE001 - of a type that cannot be made here; its text was handed over
        return None
    return found


def _reason(code: int | None) -> str:
    if code is not None and code < 0:
        return signal.Signals(-code).name
    return f"exit code {code}"
