"""Finished jobs of a benchmark in a folder: after Ctrl-C the same command goes on from there.

A result is whatever a worker sends home: rows, records of the project's own classes, traces, arrays. Only those kinds
are read back, so that a file from elsewhere calls nothing.
"""

from __future__ import annotations

import hashlib
import io
import json
import pickle
import sys
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.common.output import write_atomically
from benchmarks.common.store import circumstances
from moc_opt.errors import MocOptError
from moc_opt.inputs.files import file_in, read_bytes

Result = TypeVar("Result")

HOME = Path(__file__).resolve().parents[1]
OWN = ("benchmarks", "moc_opt")
OTHERS = {
    ("numpy", "dtype"), ("numpy", "ndarray"), ("numpy._core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"), ("numpy._core.numeric", "_frombuffer"),
}  # fmt: skip
"""Of which modules a result has classes, and what it needs beside them."""
MOST_BYTES = 2**30
DIGEST = 32


class Kept:
    """Results in a folder.

    Args:
        folder: made when the first result is there.
        config: plain values that decide what the jobs are, the seed among them.
    """

    def __init__(self, folder: Path, config: Mapping[str, Any]) -> None:
        self.folder, self.reused = folder, 0
        self._config = json.dumps(config, sort_keys=True)

    def of(self, job: str, make: Callable[[], Result]) -> Result:
        """Return the result of a job: that of an earlier run, or what ``make`` returns, which is then kept."""
        found = self.get(job)
        if found is None:
            found = (self.put(job, make()),)
        return found[0]

    def get(self, job: str) -> tuple[Any] | None:
        """Return (result,) of an earlier run, or None; a damaged file is set aside with a line on stderr."""
        path = self._path(job)
        if not path.exists():
            return None
        try:
            found = (_opened(path),)
        except MocOptError as error:
            aside = file_in(self.folder / "damaged", path.name)
            path.rename(aside)
            print(f"{error}; set aside as {aside}, and done again", file=sys.stderr)
            return None
        self.reused += 1
        return found

    def put(self, job: str, result: Result) -> Result:
        """Keep a result, and return it."""
        data = pickle.dumps(result)
        write_atomically(self._path(job), data + hashlib.sha256(data).digest())
        return result

    def _path(self, job: str) -> Path:
        asked = f"{job}\n{self._config}\n{circumstances(_sources())}"
        return self.folder / f"{hashlib.sha256(asked.encode()).hexdigest()[:24]}.job"


@cache
def _sources() -> tuple[str, ...]:
    return tuple(sorted(path.relative_to(HOME).with_suffix("").as_posix() for path in HOME.rglob("*.py")))


def _opened(path: Path) -> Any:
    """Return what `Kept.put` wrote.

    Raises:
        MocOptError: damaged, or of a kind that no result is.
    """
    data = read_bytes(path, "finished job", MocOptError, MOST_BYTES)
    if hashlib.sha256(data[:-DIGEST]).digest() != data[-DIGEST:]:
        raise MocOptError(f"finished job {path} is damaged")
    try:
        return _Reader(io.BytesIO(data[:-DIGEST])).load()
    except Exception as error:
        raise MocOptError(f"finished job {path} holds no result: {error}") from error


class _Reader(pickle.Unpickler):
    """Makes instances of the project's own classes, and arrays."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in OTHERS:
            return super().find_class(module, name)
        if module.partition(".")[0] in OWN:
            found = super().find_class(module, name)
            if isinstance(found, type) and found.__module__.partition(".")[0] in OWN:
                return found
        raise pickle.UnpicklingError(f"{module}.{name} is no kind of result")
