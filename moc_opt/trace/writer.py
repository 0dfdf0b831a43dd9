"""A trace that grows on disk: blocks of rows in a folder beside the file, joined into the file at the end.

Every block is a small trace file of its own, there whole or not at all, so that a process may be killed at any moment:
`found` reads what is there, and the next run of the same name keeps it under another.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections import ChainMap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Self

from moc_opt.errors import TraceError, describe
from moc_opt.inputs.files import as_path, file_in, read_json
from moc_opt.trace.parquet import Columns, Stored, join, new_file, write

KILLED = "interrupted: the process ended before the run did"
_META, _LOCK = "meta.json", ".lock"


class TraceWriter:
    """Writes a trace while it grows. Use as a context; one process at a time writes to a name.

    Args:
        path: of the finished file.
        meta: of the run, as far as it is known before it; JSON values.

    Raises:
        TraceError: another process writes there, something that is no file is there, or the folder cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str], meta: Mapping[str, Any]) -> None:
        self.path, self._meta = as_path(path, "trace", TraceError), dict(meta)
        self.folder = parts_of(self.path)
        self.kept: Path | None = None
        """Where the rows of an earlier run of this name are now, which had been killed."""
        self._lock: int | None = None

    def __enter__(self) -> Self:
        new_file(self.path)  # before the run, not after it
        try:
            self.folder.mkdir(exist_ok=True)
            self._lock = os.open(self.folder / _LOCK, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o666)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._keep_what_is_left()
            text = json.dumps({**self._meta, "ended": KILLED}, allow_nan=False)
            (self.folder / _META).write_text(text, encoding="utf-8")
        except BlockingIOError as error:
            self.__exit__()
            raise TraceError(f"{self.path}: another run is writing this trace; wait, or give another name") from error
        except OSError as error:
            self.__exit__()
            raise TraceError(
                f"the trace cannot be saved as {str(self.path)!r} ({error}): "
                "give a file in a directory that exists and can be written"
            ) from error
        return self

    def __exit__(self, *exc: object) -> None:
        if self._lock is not None:
            os.close(self._lock)  # and with it the lock
            self._lock = None

    def write(self, first: int, columns: Columns) -> None:
        """Keep a block of rows whose first is that of tick ``first``; the same block again replaces itself.

        Raises:
            TraceError: it cannot be written.
        """
        write(self.folder / f"{first:09d}.parquet", columns, {})

    def rows(self) -> int:
        """Return how many there are so far."""
        return self.columns().rows if _blocks(self.folder) else 0

    def columns(self) -> Stored:
        """Return the rows so far.

        Raises:
            TraceError: there are none.
        """
        return _stored(self.folder)

    def finish(self, meta: Mapping[str, Any], more: Columns | None = None) -> None:
        """Join the blocks into the file, and take them away.

        Args:
            meta: of the run; JSON values.
            more: columns of all rows that are added, numbers or flags, (N,).

        Raises:
            TraceError: it cannot be written; the blocks stay.
        """
        columns = self.columns()
        added = dict(more or {})
        types = {**columns.types, **{name: array.dtype for name, array in added.items()}}
        join(self.path, _with(columns, added), types, meta)
        self._clear()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _keep_what_is_left(self) -> None:
        """Put the rows of an earlier run under another name: one file, or the blocks as they are if one is damaged."""
        left = [path for path in self.folder.iterdir() if path.name not in (_LOCK, _META)]
        if left:
            self.kept = file_in(self.path.parent, f"{self.path.stem}.interrupted{self.path.suffix}")
            try:
                columns, meta = found(self.folder)
                join(self.kept, columns.blocks(), columns.types, meta or columns.meta)
            except TraceError:
                self.kept = file_in(self.path.parent, f"{self.path.stem}.interrupted.parts")
                self.kept.mkdir()
                for path in left:
                    path.rename(self.kept / path.name)
        if (self.folder / _META).is_dir():
            (self.folder / _META).rename(file_in(self.path.parent, f"{self.path.stem}.meta"))
        self._clear()

    def _clear(self) -> None:
        for path in [*_blocks(self.folder), self.folder / _META]:
            path.unlink(missing_ok=True)


def _with(columns: Stored, more: Columns) -> Iterator[Columns]:
    """Yield the blocks of `columns`, each with its rows of the columns `more`."""
    first = 0
    for block in columns.blocks():
        rows = slice(first, first + block.rows)
        yield ChainMap({name: array[rows] for name, array in more.items()}, block)  # type: ignore[arg-type]
        first += block.rows


def parts_of(path: Path) -> Path:
    """Return the folder of blocks beside a file.

    Raises:
        TraceError: the path ends in no name ("/", ".").
    """
    if not path.name:
        raise TraceError(f"trace {str(path)!r} is a folder: give the name of a file in it")
    return path.with_name(f"{path.name}.parts")


def found(path: str | os.PathLike[str]) -> tuple[Stored, dict[str, Any] | None]:
    """Return the columns of a trace's file; where only blocks are there, theirs, and the meta that was known.

    Raises:
        TraceError: neither is there, or it is damaged.
    """
    given = as_path(path, "trace", TraceError)
    is_folder = os.path.isdir(given)  # False, too, for a name that no file can have
    folder = given if is_folder else parts_of(given)
    if (os.path.lexists(given) and not is_folder) or not os.path.isdir(folder) or not _blocks(folder):
        return Stored([path]), None
    columns = _stored(folder)
    ended = KILLED
    try:
        meta = dict(read_json(folder / _META, "trace", TraceError))
    except (TraceError, TypeError, ValueError) as error:  # the rows matter more than the meta
        meta, ended = {}, f"{KILLED}, and what is known of it is damaged ({describe(error)})"
    return columns, {**meta, "ended": ended, "ticks": columns.rows}


def _blocks(folder: Path) -> list[Path]:
    return sorted(folder.glob("[0-9]*.parquet"))


def _stored(folder: Path) -> Stored:
    blocks = _blocks(folder)
    if not blocks:
        raise TraceError(f"{folder} holds no rows: the run ended before its first tick")
    return Stored(blocks)
