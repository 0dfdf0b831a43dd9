"""Who does the runs: the same loop over any executor. Lost runs are done again, a few times, then reported."""

from __future__ import annotations

import faulthandler
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from time import perf_counter
from typing import Any, Protocol, Self

from benchmarks.sweeps.errors import WorkerError
from benchmarks.sweeps.version import code_version
from moc_opt import scenario
from moc_opt.errors import MocOptError
from moc_opt.scenario import Scenario
from moc_opt.trace.metrics import summarize

Table = Mapping[str, Any]
Work = Callable[[Table, float], dict[str, Any]]

BARREN_DEATHS = 10
"""Workers that may die one after the other without a finished run between them, before all stops."""
_ONE_AT_A_TIME = threading.Lock()


def execute(table: Table, limit_s: float) -> dict[str, Any]:
    """Do one run, in a worker.

    A process has one clock and one collector, so a worker with several threads still does one run at a time.

    Args:
        limit_s: the process ends itself when the run takes longer [s]; even where a library hangs.

    Returns:
        {ended, error, figures, wall_s, version}: figures is {metric: number}, empty where error is a text; ended is
        the run's ``meta["ended"]``, or "failed" with an error.
    """
    ended, error, figures = "failed", None, {}
    with _ONE_AT_A_TIME:
        begin = perf_counter()
        faulthandler.dump_traceback_later(limit_s, exit=True, file=2)
        try:
            trace = scenario.run(Scenario(**table))
            ended, figures = str(trace.meta["ended"]), summarize(trace)
        except MocOptError as reason:
            error = f"{type(reason).__name__}: {reason}"
        except (OSError, MemoryError):
            raise  # the machine's failure, not the run's: it is tried again
        except Exception as reason:  # noqa: BLE001 - a defect in one run must not cost the others; its row tells
            error = f"unexpected {type(reason).__name__}: {reason}"
        finally:
            faulthandler.cancel_dump_traceback_later()
        wall_s = perf_counter() - begin
    return {"ended": ended, "error": error, "figures": figures, "wall_s": wall_s, "version": code_version()}


class Pool(Protocol):
    """Where runs are sent to."""

    shared: bool  # other work on the same machine while a run is timed
    deaths: tuple[type[BaseException], ...]  # what a run ends with when its worker died under it
    attempts: int  # that a run has, before it is given up

    def __enter__(self) -> Self: ...

    def __exit__(self, kind: type[BaseException] | None, *exc: object) -> None: ...

    def window(self) -> int:
        """Tell how many runs to keep in flight."""

    def submit(self, work: Work, table: Table, limit_s: float) -> Future[dict[str, Any]]:
        """Send one run."""


def run_all(
    pool: Pool, todo: Iterable[int], table_of: Callable[[int], Table], keep: Callable[[int, dict[str, Any]], None],
    limit_s: float, work: Work = execute,
) -> dict[int, str]:  # fmt: skip
    """Do all runs; each result is kept as soon as it is there.

    A run whose worker dies is done again, alone, so that one that kills its worker harms no other. It is given up
    after ``pool.attempts``.

    Args:
        pool: entered.
        todo: indices, in the order to begin them.
        table_of: the scenario's table of an index.
        keep: called here, in this process, with an index and its {error, figures, wall_s, timing_shared}.
        limit_s: see :func:`execute`.

    Returns:
        index -> why it has no result.

    Raises:
        WorkerError: no worker stays alive, or none can be reached.
        MocOptError: from ``keep``.
    """
    fresh, more, alone = iter(todo), True, False
    suspects = Suspects(pool, limit_s)
    flying: dict[Future[dict[str, Any]], int] = {}

    def launch(index: int) -> None:
        flying[_sent(pool, work, table_of(index), limit_s)] = index

    while more or suspects.waiting or flying:
        if not flying:
            alone = bool(suspects.waiting)
            if alone:
                launch(suspects.waiting.popleft())
        while more and not alone and not suspects.waiting and len(flying) < pool.window():
            index = next(fresh, -1)
            more = index >= 0
            if more:
                launch(index)
        landed, _ = wait(flying, timeout=1.0, return_when=FIRST_COMPLETED)
        fallen: dict[int, BaseException] = {}
        for future in landed:
            index = flying.pop(future)
            result = _landed(future, pool, index)
            if isinstance(result, BaseException):
                fallen[index] = result
            else:
                keep(index, {**result, "timing_shared": pool.shared})
                suspects.barren = 0
        if fallen:
            suspects.take(fallen)
    return suspects.lost


class Suspects:
    """Runs whose worker died under them: which to try again, alone, and which to give up."""

    def __init__(self, pool: Pool, limit_s: float) -> None:
        self.pool, self.limit_s = pool, limit_s
        self.waiting: deque[int] = deque()
        self.lost: dict[int, str] = {}
        self.barren = 0  # deaths since the last finished run
        self._died: Counter[int] = Counter()

    def take(self, fallen: Mapping[int, BaseException]) -> None:
        """Count one death of a worker against all these runs.

        Raises:
            WorkerError: too many deaths with nothing finished between: it is not the runs.
        """
        self.barren += 1
        if self.barren > BARREN_DEATHS:
            raise WorkerError(
                f"workers died {self.barren} times without a finished run between ({next(iter(fallen.values()))}): "
                "see what they wrote above, and the memory of the machine; then start again, with fewer --workers"
            )
        for index, error in sorted(fallen.items()):
            self._died[index] += 1
            if self._died[index] < self.pool.attempts:
                self.waiting.append(index)
                continue
            death = isinstance(error, self.pool.deaths)
            why = f"the worker died (or the run took more than {self.limit_s:g} s)" if death else repr(error)
            self.lost[index] = f"WorkerError: given up after {self._died[index]} attempts: {why}"


def _sent(pool: Pool, work: Work, table: Table, limit_s: float) -> Future[dict[str, Any]]:
    try:
        return pool.submit(work, table, limit_s)
    except pool.deaths as error:  # since the last look
        fallen: Future[dict[str, Any]] = Future()
        fallen.set_exception(error)
        return fallen
    except OSError as error:
        raise WorkerError(f"no worker can be started: {error}; try fewer --workers") from error


def _landed(future: Future[dict[str, Any]], pool: Pool, index: int) -> dict[str, Any] | BaseException:
    """Return the result, or what took the worker or the machine down."""
    if future.cancelled():
        raise WorkerError("the scheduler went away with the runs that were under way; start again")
    error = future.exception()
    if error is None:
        result = future.result()
        if result.pop("version") != code_version():
            raise WorkerError(f"a worker has another moc_opt than this one ({code_version()}): install the same")
        return result
    if isinstance(error, (*pool.deaths, OSError, MemoryError)):
        return error
    raise WorkerError(f"a worker cannot do run {index}: {type(error).__name__}: {error}") from error
