"""The folder of a sweep: what is finished stays finished, whenever the sweep is stopped.

    plan.json           which sweep this is
    runs/ID.json        one finished run each, written at once
    shards/N.parquet    a thousand of these together, after which the single files go
    rows.parquet        all runs in order, once all are finished; clock.parquet beside it

Every file appears under its name whole or not at all, and every step can be repeated, so that a sweep
goes on from whatever it finds.
"""

from __future__ import annotations

import fcntl
import json
import os
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from benchmarks.output import write_atomically
from benchmarks.sweeps.errors import StoreError
from benchmarks.sweeps.plan import Plan, differences
from benchmarks.sweeps.table import BLOCK, read_records, record_table, whole_parquet, write_final

SHARD = 1000
"""Finished runs that are files of their own before they become one."""


class Store:
    """What is finished. Use as a context: one process at a time owns the folder.

    Args:
        folder: made where it is missing.
        plan: the sweep it belongs to.

    Raises:
        StoreError: another process owns it, it belongs to another sweep, or it cannot be written.
    """

    def __init__(self, folder: Path, plan: Plan) -> None:
        self.folder, self.plan = folder, plan
        self.done: NDArray[np.bool_] = np.zeros(len(plan), dtype=np.bool_)
        self.dropped: list[str] = []  # what was found damaged; those runs are done again
        self._loose: dict[int, dict[str, Any]] = {}
        self._shards: dict[Path, tuple[int, int]] = {}  # first and last index
        self._lock: int | None = None

    def __enter__(self) -> Store:
        with self._plainly("cannot be used"):
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock = os.open(self.folder / ".lock", os.O_CREAT | os.O_RDWR, 0o666)
            try:
                self._own()
                self._check_plan()
                for name in ("runs", "shards"):
                    (self.folder / name).mkdir(exist_ok=True)
                self._load()
            except BaseException:
                self.__exit__()
                raise
        return self

    def __exit__(self, *exc: object) -> None:
        if self._lock is not None:
            os.close(
                self._lock
            )  # and with it the lock; the kernel does the same for a process that is killed
            self._lock = None

    def add(self, index: int, result: Mapping[str, Any]) -> None:
        """Keep a finished run, at once.

        Args:
            index: in the plan.
            result: {error, figures, timing_shared, wall_s}.

        Raises:
            StoreError: it could not be written; nothing of it stays.
        """
        record = {"index": index, **result}
        text = json.dumps(record, sort_keys=True)
        sealed = json.dumps({"crc": zlib.crc32(text.encode()), "record": text})
        with self._plainly("cannot take another run"):
            write_atomically(self._file(index), sealed.encode())
            self._loose[index] = record
            self.done[index] = True
            if len(self._loose) >= SHARD:
                self._compact()

    def finish(self, lost: Mapping[int, str]) -> None:
        """Write the final tables.

        Args:
            lost: index -> why there is no result; these are rows with that error, and not kept.

        Raises:
            StoreError: a run has neither a result nor a reason, or a table cannot be written.
        """
        with self._plainly("cannot take the final tables"):
            if self._loose:
                self._compact()
            write_final(self.folder, self.plan, self._blocks(lost))

    def _own(self) -> None:
        assert self._lock is not None
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise StoreError(
                f"{self.folder}: another sweep is writing here; wait for it, or give another --out"
            ) from error

    def _check_plan(self) -> None:
        path, mine = self.folder / "plan.json", self.plan.description
        if not path.exists():
            for name in ("runs", "shards", "rows.parquet", "summary.json"):
                if (self.folder / name).exists():
                    raise StoreError(
                        f"{self.folder} holds {name} and no plan.json: no sweep's folder; give another --out"
                    )
            write_atomically(path, (json.dumps(mine, indent=1, sort_keys=True) + "\n").encode())
            return
        try:
            theirs = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise StoreError(f"{path} cannot be read ({error}): give another --out") from error
        if theirs != mine:
            found = list(differences(mine, theirs))
            more = f", and {len(found) - 3} more" if len(found) > 3 else ""
            raise StoreError(
                f"{self.folder} holds another sweep: {'; '.join(found[:3])}{more}. "
                "Give another --out, or take that folder away"
            )

    def _load(self) -> None:
        for folder in (self.folder, self.folder / "runs", self.folder / "shards"):
            for torn in folder.glob(".*.*.*"):  # what a killed process was writing
                torn.unlink()
        for path in sorted((self.folder / "shards").glob("*.parquet")):
            indices = _indices(path)
            if len(indices) == 0 or indices.min() < 0 or indices.max() >= len(self.done):
                self._drop(path)
                continue
            self.done[indices] = True
            self._shards[path] = (int(indices.min()), int(indices.max()))
        for path in sorted((self.folder / "runs").glob("*.json")):
            record = _opened(path)
            index = -1 if record is None else int(record["index"])
            if record is None or not 0 <= index < len(self.done) or self._file(index) != path:
                self._drop(path)
            elif self.done[index]:
                path.unlink()  # the stop came between a shard and the removal of what is in it
            else:
                self.done[index] = True
                self._loose[index] = record

    def _drop(self, damaged: Path) -> None:
        self.dropped.append(str(damaged))
        damaged.unlink()

    def _compact(self) -> None:
        """Loose files into one; a stop after the shard leaves files that :meth:`_load` takes away."""
        number = 1 + max((int(path.stem) for path in self._shards), default=-1)
        path = self.folder / "shards" / f"{number:06d}.parquet"
        indices = sorted(self._loose)
        table = record_table([self._loose[i] for i in indices], self.plan.metrics)
        with whole_parquet(path, table.schema) as write:
            write(table)
        self._shards[path] = (indices[0], indices[-1])
        for index in indices:
            self._file(index).unlink(missing_ok=True)
        self._loose.clear()

    def _blocks(self, lost: Mapping[int, str]) -> Iterator[pa.Table]:
        """All records in order, BLOCK rows at a time: of the shards only those are open that reach into a block."""
        for first in range(0, len(self.plan), BLOCK):
            last = min(first + BLOCK, len(self.plan)) - 1
            parts = [read_records(path) for path, (a, b) in self._shards.items() if a <= last and b >= first]
            gone = [
                {"index": i, "ended": "failed", "error": why, "figures": {}}
                for i, why in lost.items()
                if first <= i <= last
            ]
            block = pa.concat_tables([*parts, record_table(gone, self.plan.metrics)])
            inside = pc.and_(pc.greater_equal(block["index"], first), pc.less_equal(block["index"], last))
            block = block.filter(inside).sort_by("index")
            if block["index"].to_pylist() != list(range(first, last + 1)):
                raise StoreError(f"{self.folder}: not every run has a result; start the sweep again")
            yield block

    def _file(self, index: int) -> Path:
        return self.folder / "runs" / f"{self.plan.run_id(index)}.json"

    @contextmanager
    def _plainly(self, what: str) -> Iterator[None]:
        try:
            yield
        except StoreError:
            raise
        except (OSError, pa.ArrowException) as error:
            raise StoreError(
                f"{self.folder} {what}: {error}. {int(self.done.sum())} of {len(self.done)} runs are safe there; "
                "see to the space and the permissions and start the same command again"
            ) from error


def _opened(path: Path) -> dict[str, Any] | None:
    """The record in a file, or None where that is damaged."""
    try:
        sealed = json.loads(path.read_text(encoding="utf-8"))
        record: dict[str, Any] = json.loads(sealed["record"])
        return record if zlib.crc32(sealed["record"].encode()) == sealed["crc"] else None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _indices(path: Path) -> NDArray[np.int64]:
    """Which runs a shard holds; none where it is damaged."""
    try:
        found: NDArray[np.int64] = read_records(path, ["index"]).column("index").to_numpy()
    except (StoreError, KeyError):
        return np.empty(0, dtype=np.int64)  # the caller drops it, and says so
    return found
