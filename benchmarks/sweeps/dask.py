"""Workers of a sweep on other machines, through Dask distributed (``pip install 'moc-opt[cluster]'``)."""

from __future__ import annotations

import importlib
import sys
from concurrent.futures import Future
from time import monotonic
from types import ModuleType
from typing import Any, Self

from benchmarks.sweeps.engine import Table, Work
from benchmarks.sweeps.errors import WorkerError
from benchmarks.sweeps.version import code_version

CONNECT_S = 30.0
LOOK_EVERY_S = 2.0


class DaskPool:
    """The workers behind a Dask scheduler, as many as there are at the time.

    Args:
        address: of the scheduler, as "tcp://host:8786".
        workers: wait until there are so many, at most ``patience_s``.
        patience_s: [s].

    Raises:
        WorkerError: Dask is not installed, no scheduler answers, or the workers lack this package.
    """

    shared: bool = True
    attempts: int = 2  # each of several workers: the scheduler itself tries a run again elsewhere

    def __init__(self, address: str, workers: int | None = None, patience_s: float = 300.0) -> None:
        self.address, self._wanted, self._patience_s = address, workers or 1, patience_s
        self.deaths: tuple[type[BaseException], ...] = (_distributed().KilledWorker,)
        self._looked, self._window = -LOOK_EVERY_S, 0

    def __enter__(self) -> Self:
        library = _distributed()
        try:
            self._client = library.Client(self.address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise WorkerError(f"no Dask scheduler answers at {self.address}: {error}") from error
        try:
            self._meet_workers()
        except BaseException as error:
            self.__exit__(type(error))
            raise
        self._executor = self._client.get_executor(pure=False)
        return self

    def __exit__(self, kind: type[BaseException] | None, *exc: object) -> None:
        self._client.close(timeout=CONNECT_S)

    def window(self) -> int:
        """Return two runs for each thread of a worker; looked up again now and then, as workers come and go."""
        if monotonic() - self._looked >= LOOK_EVERY_S:
            try:
                self._window = max(2, 2 * sum(self._client.nthreads().values()))
            except OSError as error:
                raise WorkerError(f"the Dask scheduler at {self.address} went away: {error}; start again") from error
            self._looked = monotonic()
        return self._window

    def submit(self, work: Work, table: Table, limit_s: float) -> Future[dict[str, Any]]:
        """See ``engine.Pool``."""
        found: Future[dict[str, Any]] = self._executor.submit(work, table, limit_s)
        return found

    def _meet_workers(self) -> None:
        try:
            self._client.wait_for_workers(self._wanted, timeout=self._patience_s)
        except OSError as error:
            raise WorkerError(
                f"fewer than {self._wanted} workers came to {self.address} in {self._patience_s:g} s; "
                f"start them with: dask worker {self.address} --nthreads 1"
            ) from error
        try:
            versions = self._client.run(_version)
        except ImportError as error:
            raise WorkerError(
                f"the workers at {self.address} lack what runs need ({error}): install this checkout there too, "
                "and start them in its folder"
            ) from error
        for worker, version in versions.items():
            if version != code_version():
                raise WorkerError(f"worker {worker} has moc_opt {version}, here is {code_version()}: install the same")


def _version() -> str:
    """Say on a worker whether everything can be loaded, and which worker it is."""
    import benchmarks.sweeps.engine  # noqa: F401

    return code_version()


def _distributed() -> ModuleType:
    try:
        return importlib.import_module("distributed")
    except ImportError as error:
        raise WorkerError(
            f"--scheduler needs Dask, which is not in {sys.prefix}: pip install 'moc-opt[cluster]'"
        ) from error
