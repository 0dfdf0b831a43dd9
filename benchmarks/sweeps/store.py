"""The folder of a sweep: what is finished stays finished, whenever the sweep is stopped.

    plan.json           which sweep this is
    runs/ID.json        one finished run each, written at once
    shards/N-CRC.parquet  a thousand of these together, after which the single files go
    damaged/            what was found damaged, set aside: its runs are done again
    rows.parquet        all runs in order, once all are finished; clock.parquet beside it

Every file appears under its name whole or not at all, and every step can be repeated, so that a sweep
goes on from whatever it finds.
"""

from __future__ import annotations

import fcntl
import os
import re
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from benchmarks.common.output import parquet_bytes, write_atomically
from benchmarks.sweeps.errors import StoreError
from benchmarks.sweeps.plan import Plan, differences, digest_of
from benchmarks.sweeps.record import opened, owner, sealed, shard_indices
from benchmarks.sweeps.table import BLOCK, PLAN_KEY, read_shard, record_table, write_final
from moc_opt.inputs.files import file_in, read_json, to_json

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
        self.dropped: list[str] = []  # what was found damaged, and set aside; those runs are done again
        self._loose: dict[int, dict[str, Any]] = {}
        self._shards: dict[Path, NDArray[np.int64]] = {}  # which runs it holds
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
            os.close(self._lock)  # and with it the lock; the kernel does the same for a process that is killed
            self._lock = None

    def add(self, index: int, result: Mapping[str, Any]) -> None:
        """Keep a finished run, at once.

        Args:
            result: {error, figures, timing_shared, wall_s}.

        Raises:
            StoreError: it could not be written; nothing of it stays.
        """
        data, record = sealed({"index": index, **result}, self.plan.digest)
        with self._plainly("cannot take another run"):
            write_atomically(self._file(index), data)
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
        """Own a new folder, or one of the same sweep; a plan that is damaged or gone is written anew.

        Every run and shard says which sweep it belongs to: without plan.json the folder is told by these.
        """
        path, mine = self.folder / "plan.json", self.plan.description
        theirs = self._described(path)
        if theirs is None:
            self._told_by_its_runs()
            described = {"digest": self.plan.digest, "plan": mine}
            write_atomically(path, (to_json(described, indent=1, sort_keys=True) + "\n").encode())
        elif theirs != mine:
            found = list(differences(mine, theirs))
            more = f", and {len(found) - 3} more" if len(found) > 3 else ""
            raise StoreError(
                f"{self.folder} holds another sweep: {'; '.join(found[:3])}{more}. "
                "Give another --out, or take that folder away"
            )

    def _described(self, path: Path) -> Any:
        """Return the plan in the folder; None where there is none, or a damaged one, which is set aside."""
        if not os.path.lexists(path):
            return None
        try:
            described = read_json(path, "plan of a sweep", StoreError)
            if isinstance(described, dict) and digest_of(described.get("plan")) == described.get("digest"):
                return described["plan"]
        except (StoreError, TypeError, ValueError):
            pass  # not JSON, or values that no plan has: damaged like one whose digest is wrong
        self._drop(path)
        return None

    def _told_by_its_runs(self) -> None:
        """Refuse a folder without a plan that holds runs of another sweep, or tables and no run at all."""
        pieces = [*self.folder.glob("shards/*.parquet"), *self.folder.glob("runs/*.json")]
        signs = {owner(path) for path in pieces} - {None}
        if signs - {self.plan.digest}:
            raise StoreError(
                f"{self.folder} holds runs of another sweep, whose plan.json is damaged or gone: give another --out"
            )
        ours = re.compile(r"runs/[0-9a-f]{20}\.json|shards/[0-9]+-[0-9a-f]{8}\.parquet")
        tables = [path for path in (self.folder / "rows.parquet", self.folder / "summary.json") if path.exists()]
        foreign = [path for path in pieces if not ours.fullmatch(path.relative_to(self.folder).as_posix())]
        if (tables or foreign) and not signs and not self.dropped:
            raise StoreError(
                f"{self.folder} holds {(tables or foreign)[0].name} and no plan.json: no sweep's folder; "
                "give another --out"
            )

    def verify(self) -> int:
        """Read every shard again and set damaged ones aside; returns how many runs that takes away."""
        before = int(self.done.sum())
        with self._plainly("cannot be used"):
            for path, indices in list(self._shards.items()):
                if shard_indices(path, self.plan) is None:
                    self._drop(path)
                    del self._shards[path]
                    self.done[indices] = False
        return before - int(self.done.sum())

    def _load(self) -> None:
        for folder in (self.folder, self.folder / "runs", self.folder / "shards"):
            for torn in folder.glob(".*.*.*"):  # what a killed process was writing
                torn.unlink()
        for path in sorted((self.folder / "shards").glob("*.parquet")):
            indices = shard_indices(path, self.plan)
            if indices is None or self.done[indices].any():
                self._drop(path)
                continue
            self.done[indices] = True
            self._shards[path] = indices
        for path in sorted((self.folder / "runs").glob("*.json")):
            record = opened(path, self.plan.digest)
            index = -1 if record is None else record["index"]
            if record is None or not 0 <= index < len(self.done) or self._file(index) != path:
                self._drop(path)
            elif self.done[index]:
                path.unlink()  # the stop came between a shard and the removal of what is in it
            else:
                self.done[index] = True
                self._loose[index] = record

    def _drop(self, damaged: Path) -> None:
        """Set aside what is damaged: under its name in a folder of its own, so that its runs can be done again."""
        damaged.rename(file_in(self.folder / "damaged", damaged.name))
        self.dropped.append(str(damaged))

    def _compact(self) -> None:
        """Put loose files into one; a stop after the shard leaves files that :meth:`_load` takes away."""
        number = 1 + max((int(path.stem.partition("-")[0]) for path in self._shards), default=-1)
        indices = sorted(self._loose)
        table = record_table([self._loose[i] for i in indices], self.plan.metrics)
        data = parquet_bytes(table.replace_schema_metadata({PLAN_KEY: self.plan.digest}))
        # Parquet's own checksums leave its footer out; the one in the name does not.
        path = self.folder / "shards" / f"{number:06d}-{zlib.crc32(data):08x}.parquet"
        write_atomically(path, data)
        self._shards[path] = np.array(indices)
        for index in indices:
            self._file(index).unlink(missing_ok=True)
        self._loose.clear()

    def _blocks(self, lost: Mapping[int, str]) -> Iterator[pa.Table]:
        """Yield all records in order, BLOCK rows at a time; only those shards are open that reach into a block."""
        for first in range(0, len(self.plan), BLOCK):
            last = min(first + BLOCK, len(self.plan)) - 1
            inside = [path for path, of in self._shards.items() if of.min() <= last and of.max() >= first]
            parts = [read_shard(path, self.plan.digest).replace_schema_metadata() for path in inside]
            gone = [
                {"index": i, "ended": "failed", "error": why, "figures": {}}
                for i, why in lost.items()
                if first <= i <= last
            ]
            block = pa.concat_tables([*parts, record_table(gone, self.plan.metrics)])
            asked = pc.and_(pc.greater_equal(block["index"], first), pc.less_equal(block["index"], last))
            block = block.filter(asked).sort_by("index")
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
