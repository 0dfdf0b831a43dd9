"""Finished jobs of a benchmark in a folder: after Ctrl-C the same command goes on from there.

A result is whatever a worker returns: rows, records of the project's own classes, traces, arrays. It is kept as the
plain values and arrays of a `Part`, so that reading a file calls nothing but the constructor of such a record.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.store import Part, Store
from moc_opt.errors import MocOptError
from moc_opt.trace.trace import Trace

Result = TypeVar("Result")

HOME = Path(__file__).resolve().parents[1]
OWN = ("benchmarks", "moc_opt")
_PLAIN = (bool, int, str, type(None))


class Kept:
    """Results in a folder.

    Args:
        folder: made when the first result is there.
        config: plain values that decide what the jobs are, the seed among them.
    """

    def __init__(self, folder: Path, config: Mapping[str, Any]) -> None:
        self._store, self._config = Store(folder, _sources()), dict(config)

    @property
    def reused(self) -> int:
        """Number of results taken from an earlier run."""
        return self._store.reused

    def of(self, job: str, make: Callable[[], Result]) -> Result:
        """Return the result of a job: that of an earlier run, or what ``make`` returns, which is then kept."""
        found = self.get(job)
        return self.put(job, make()) if found is None else found[0]

    def get(self, job: str) -> tuple[Any] | None:
        """Return (result,) of an earlier run, or None; a damaged file is set aside with a line on stderr."""
        part = self._store.get(self._key(job))
        return None if part is None else (unpacked(part.values["result"], part.arrays),)

    def put(self, job: str, result: Result) -> Result:
        """Keep a result, and return it.

        Raises:
            TypeError: a result of a kind that is not kept.
        """
        arrays: dict[str, NDArray[Any]] = {}
        self._store.put(self._key(job), Part({"result": packed(result, arrays)}, arrays))
        return result

    def _key(self, job: str) -> str:
        return self._store.key(job=job, config=self._config)


@cache
def _sources() -> tuple[str, ...]:
    return tuple(sorted(path.relative_to(HOME).with_suffix("").as_posix() for path in HOME.rglob("*.py")))


def packed(value: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    """Return a value as JSON holds it; everything else is a pair [kind, content], and arrays go into ``arrays``.

    Raises:
        TypeError: a value of another kind than those below.
    """
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else ["float", repr(value)]
    if isinstance(value, _PLAIN):
        return value
    if isinstance(value, np.ndarray):
        name = f"a{len(arrays)}"
        arrays[name] = value
        return ["array", name]
    if isinstance(value, Trace):
        return ["trace", [packed(dict(part), arrays) for part in (value.columns, value.meta)]]
    kind = type(value)
    if names := _fields(kind):
        fields = {name: packed(getattr(value, name), arrays) for name in names}
        return ["record", [kind.__module__, kind.__qualname__, fields]]
    if isinstance(value, Mapping):
        return ["mapping", [[packed(name, arrays), packed(entry, arrays)] for name, entry in value.items()]]
    if isinstance(value, list | tuple):
        return [kind.__name__, [packed(entry, arrays) for entry in value]]
    raise TypeError(f"a result of type {kind.__name__} is not kept: use rows, arrays, traces and records")


def unpacked(value: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """Return what `packed` was given; a tuple's and a mapping's entries in their order.

    Raises:
        MocOptError: a kind that `packed` does not write, or a record that is no class of the project.
    """
    if not isinstance(value, list):
        return value
    kind, content = value
    if kind == "array":
        return arrays[content]
    if kind == "float":
        return float(content)
    if kind == "record":
        module, name, fields = content
        record: Any = getattr(sys.modules.get(module), name, None)
        if module.partition(".")[0] not in OWN or not _fields(record) or record.__module__ != module:
            raise MocOptError(f"a kept result is of no known kind: {module}.{name}")
        return record(**{field: unpacked(entry, arrays) for field, entry in fields.items()})
    if kind == "mapping":
        return {unpacked(name, arrays): unpacked(entry, arrays) for name, entry in content}
    entries = [unpacked(entry, arrays) for entry in content]
    if kind == "trace":
        return Trace(*entries)
    if kind not in ("list", "tuple"):
        raise MocOptError(f"a kept result is of no known kind: {kind}")
    return entries if kind == "list" else tuple(entries)


def _fields(kind: Any) -> tuple[str, ...]:
    """Return the names of a record's fields; empty for any other kind."""
    if dataclasses.is_dataclass(kind):
        return tuple(field.name for field in dataclasses.fields(kind))
    return kind._fields if isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields") else ()
