"""Run jobs in other processes, on this machine or on a Dask scheduler's workers.

    results = run([Job(trial, (scenario, "osqp", seed)) for seed in range(60)], kept=Kept(out / "jobs"))

A failed job does not stop the others.
"""

from __future__ import annotations

import ctypes
import faulthandler
import importlib
import multiprocessing
import os
import pickle
import resource
import signal
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, TimeoutError, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import count as count_from_zero
from pathlib import Path
from typing import IO, Any, Literal, cast

from pebble import ProcessExpired, ProcessPool

from moc_opt.errors import MocOptError, StudyError, describe
from moc_opt.study.kept import Kept, digest_of, key_of, loaded_sources

CONNECT_S = 30.0  # largest time to connect to the Dask scheduler, and to find a worker there [s]
LOOK_S = 1.0  # time between checks of whether processes have died [s]
ATTEMPTS = 3  # a job is submitted at most this often if the pool breaks
PID_FILE = ".pid"  # ending of the file with a worker's process id
WAIT_FACTOR = 5.0
PR_SET_PDEATHSIG = 1  # option of Linux's prctl: the signal to get when the parent dies
PRELOAD = ("moc_opt.scenario", "moc_opt.study.trials", "moc_opt.study.solver_answers")

_parts: IO[bytes] | None = None  # in a worker: the file that `report` writes to


@dataclass(frozen=True)
class Job:
    """A call of a module-level function. Function, arguments and result must be picklable."""

    work: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    limit_s: float = 600.0
    alone: bool = False  #: for a job that measures times: no other job runs meanwhile
    group: str = ""
    """Name of a group, or "". If ``give_up`` jobs of a group have hung or crashed, `run` skips its later jobs."""


@dataclass(frozen=True)
class Failed:
    """Why a job has no result."""

    kind: Literal["hung", "crashed", "raised", "not run"]
    reason: str
    parts: tuple[Any, ...] = ()  #: what the job saved by `report`

    def __str__(self) -> str:
        return self.reason if self.kind in ("raised", "not run") else f"{self.kind}: {self.reason}"


@dataclass(frozen=True)
class _Done:
    """A pickled result, the worker's imported source files, and their digest."""

    packed: bytes
    sources: tuple[str, ...]
    digest: str


def run(
    jobs: Sequence[Job], *, kept: Kept | None = None, workers: int | None = None, dask: str | None = None,
    done: Callable[[Job, Any], None] = lambda job, result: None, keep: Callable[[Any], bool] = lambda result: True,
    give_up: int = 1,
) -> list[Any]:  # fmt: skip
    """Run jobs, and return their results in order. The result of a failed job is a `Failed`.

    Args:
        kept: results of finished jobs, which are not run again.
        workers: processes on this machine; None: one per core.
        dask: address of a Dask scheduler, such as "tcp://host:8786", for the jobs without ``alone``.
        done: called with each job and its result.
        keep: called with a result; returns whether to store it.
        give_up: number of hangs or crashes after which a group's later jobs are skipped.

    Raises:
        StudyError: ``workers`` is below 1, no worker stays alive, no scheduler answers, or results cannot be stored.
    """
    if workers is not None and workers < 1:
        raise StudyError(f"workers = {workers}: give 1 or more, or None for one per core")
    results: dict[int, Any] = {}
    keys = {k: key_of(job.work, job.arguments) for k, job in enumerate(jobs)} if kept is not None else {}

    def finish(k: int, result: Any) -> None:
        results[k] = result
        done(jobs[k], result)

    for k in keys:
        if kept is not None and (found := kept.get(keys[k])) is not None:
            finish(k, found[0])
    broken = Counter[str]()
    for alone in (True, False):
        waiting = [k for k, job in enumerate(jobs) if k not in results and job.alone is alone]
        if not waiting:
            continue
        count = 1 if alone else min(workers or len(os.sched_getaffinity(0)), len(waiting))
        with _cluster(dask) if dask and not alone else _processes(count) as (submit, slots):
            for k, answer in _answers(jobs, waiting, submit, slots, broken, give_up):
                if not isinstance(answer, _Done):
                    finish(k, answer)
                    continue
                same = digest_of(answer.sources) == answer.digest
                if dask and not alone and not same:
                    raise StudyError("a Dask worker has another version of the sources: install this version there")
                try:
                    result = pickle.loads(answer.packed)
                except Exception as error:  # noqa: BLE001 - a user's class may raise anything
                    finish(k, Failed("raised", f"its result cannot be unpickled: {describe(error)}"))
                    continue
                # If a file that the job names has changed since, its result is not stored.
                if kept is not None and same and keep(result) and keys[k] == key_of(jobs[k].work, jobs[k].arguments):
                    kept.put(keys[k], result, answer.sources)
                finish(k, result)
    gone, answers = Counter[str](), list[Any]()
    # Later jobs of a given-up group may have run. Their results are dropped: the list must not depend on timing.
    for k, job in enumerate(jobs):
        answers.append(_not_begun(job.group) if job.group and gone[job.group] >= give_up else results[k])
        gone[job.group] += _broke(answers[-1])
    return answers


def _broke(answer: Any) -> bool:
    return isinstance(answer, Failed) and answer.kind in ("hung", "crashed")


def _not_begun(group: str) -> Failed:
    return Failed("not run", f"not run: {group} hung or crashed before")


Answer = Future[_Done | Failed]
Submit = Callable[[Job], Answer]


def _answers(
    jobs: Sequence[Job], waiting: Sequence[int], submit: Submit, slots: int, broken: Counter[str], give_up: int
) -> Iterator[tuple[int, _Done | Failed]]:
    """Yield (index, answer) as answers come. At most two jobs per worker are submitted at a time."""
    left, flying = list(reversed(waiting)), dict[Answer, int]()
    gone, again = set[Answer](), Counter[int]()
    while left or flying:
        while left and len(flying) < 2 * slots:
            k = left.pop()
            group = jobs[k].group
            if group and broken[group] >= give_up:
                yield k, _not_begun(group)
            else:
                flying[submit(jobs[k])] = k
        done, pending = wait(flying, timeout=LOOK_S, return_when=FIRST_COMPLETED)
        # Pebble does not notice every process that dies.
        before, gone = gone, {future for future in pending if _process_is_gone(future)}
        for future in done | (gone & before):
            k = flying.pop(future)
            try:
                answer = _answer(future, jobs[k]) if future in done else Failed("crashed", "the process died")
            except BrokenProcessPool as error:
                again[k] += 1
                if _process_is_gone(future):
                    answer = Failed("crashed", "the process died")
                elif again[k] < ATTEMPTS:
                    left.append(k)
                    continue
                else:
                    raise StudyError(f"every worker died ({error}); see the lines above") from error
            if isinstance(answer, Failed):
                answer = replace(answer, parts=_reported(getattr(future, "parts", None)))
            broken[jobs[k].group] += _broke(answer)
            yield k, answer


def _process_is_gone(future: Answer) -> bool:
    begun = Path(f"{getattr(future, 'parts', '')}{PID_FILE}")
    if not begun.exists() or not (pid := begun.read_text()):
        return False
    try:
        os.kill(int(pid), 0)
    except ProcessLookupError:
        return True
    return False


def _answer(future: Answer, job: Job) -> _Done | Failed:
    try:
        return future.result()
    except TimeoutError:
        return Failed("hung", f"no answer within {job.limit_s:g} s")
    except ProcessExpired as error:
        code = error.exitcode or 0
        if -code in (signal.SIGALRM, signal.SIGPROF):
            return Failed("hung", "no answer within the time limit that the job set")
        how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return Failed("crashed", f"the process died ({how})")
    except BrokenProcessPool:
        raise
    except CancelledError as error:
        raise StudyError("the connection to the scheduler and the running jobs are lost; start again") from error
    except OSError as error:
        raise StudyError(f"no worker can be reached: {describe(error)}") from error
    except Exception as error:  # noqa: BLE001 - also a cluster's error for a dead worker
        if type(error).__name__ == "KilledWorker":
            return Failed("crashed", f"the worker died, or the job took more than {job.limit_s:g} s")
        return Failed("raised", describe(error))


def _do(work: Callable[..., Any], arguments: tuple[Any, ...], parts: str | None = None) -> _Done | Failed:
    global _parts
    if parts is not None:
        Path(f"{parts}{PID_FILE}").write_text(str(os.getpid()))
        _parts = open(parts, "wb", buffering=0)  # noqa: SIM115 - closed below
    try:
        result = pickle.dumps(work(*arguments))
    except BaseException as error:  # noqa: BLE001 - a user's code may raise anything
        own = isinstance(error, MocOptError)
        return Failed("raised", f"{type(error).__name__}: {error}" if own else describe(error))
    finally:
        alarm(0.0)
        if _parts is not None:
            _parts.close()
            _parts = None
    sources = loaded_sources()
    return _Done(result, sources, digest_of(sources))


# --- processes on this machine ---


@contextmanager
def _processes(count: int) -> Iterator[tuple[Submit, int]]:
    """Start workers. Leaving the context ends them and their children."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([*PRELOAD, "__main__"])
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // (count + 1)  # this process needs memory, too
    with tempfile.TemporaryDirectory(prefix="moc-opt-") as folder:
        for name in ("groups", "parts"):
            Path(folder, name).mkdir()
        numbers = count_from_zero()

        def started() -> ProcessPool:
            # The workers inherit this mask, so that Ctrl-C prints no tracebacks.
            masked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            try:
                made = ProcessPool(count, initializer=_begin, initargs=(folder, memory), context=context)
                made.schedule(os.getpid).result()  # this starts the workers
                return made
            except BrokenProcessPool as error:
                raise StudyError(f"no worker can be started: {error}") from error
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, masked)

        def ended() -> None:
            pool.stop()
            pool.join()
            for group in Path(folder, "groups").iterdir():
                with suppress(ProcessLookupError, PermissionError):
                    os.killpg(int(group.name), signal.SIGKILL)
                group.unlink(missing_ok=True)

        pool = started()

        def submit(job: Job) -> Answer:
            nonlocal pool
            parts = str(Path(folder, "parts", str(next(numbers))))
            if not pool.active:  # pebble stops a pool if the only worker dies at start-up
                ended()
                pool = started()
            future: Any = pool.schedule(_do, args=[job.work, job.arguments, parts], timeout=job.limit_s)
            future.parts = parts
            return cast("Answer", future)

        try:
            yield submit, count
            pool.close()
        finally:
            ended()


def _begin(folder: str, memory: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in (signal.SIGALRM, signal.SIGPROF):
        signal.signal(number, signal.SIG_DFL)
    os.setpgrp()
    with suppress(FileNotFoundError):  # the study may have ended and removed the folder
        Path(folder, "groups", str(os.getpid())).touch()
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))


def report(part: Any) -> None:
    """Save a part of the running job's result, for `Failed.parts`."""
    if _parts is not None:
        _parts.write(pickle.dumps(part))


def _reported(file: str | None) -> tuple[Any, ...]:
    parts = list[Any]()
    if file is not None and os.path.exists(file):
        with open(file, "rb") as packed, suppress(Exception):  # the final part may be cut off
            while True:
                parts.append(pickle.load(packed))
    return tuple(parts)


def alarm(seconds: float) -> None:
    """Let the kernel end this process after ``seconds`` of processor time. With 0, cancel the alarm.

    A waiting process uses no processor time. So it is also ended after `WAIT_FACTOR` * ``seconds`` of wall time.
    """
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.setitimer(signal.ITIMER_REAL, WAIT_FACTOR * seconds)


# --- workers of a cluster ---


@contextmanager
def _cluster(address: str) -> Iterator[tuple[Submit, int]]:
    try:
        client_of: Any = importlib.import_module("distributed").Client
    except ImportError as error:
        raise StudyError("Dask needs a missing package: pip install '.[cluster]' in the clone") from error
    try:
        client = client_of(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise StudyError(f"no Dask scheduler answers at {address}: {error}") from error
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
        slots = sum(client.nthreads().values())
        executor = client.get_executor(pure=False)
        yield lambda job: executor.submit(_do_within, job.work, job.arguments, job.limit_s), max(1, slots)
    except TimeoutError as error:
        raise StudyError(f"{address} has no worker: start one with `dask worker {address} --nthreads 1`") from error
    finally:
        client.close(timeout=CONNECT_S)


def _do_within(work: Callable[..., Any], arguments: tuple[Any, ...], limit_s: float) -> _Done | Failed:
    faulthandler.dump_traceback_later(limit_s, exit=True, file=2)
    try:
        return _do(work, arguments)
    finally:
        faulthandler.cancel_dump_traceback_later()
