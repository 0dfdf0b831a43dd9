"""The Parquet files of a trace: written all or nothing, and read whole or column by column."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import TraceError
from moc_opt.inputs.files import as_path, check_replaceable
from moc_opt.inputs.memory import available_bytes
from moc_opt.numerics.arrays import read_only
from moc_opt.trace.parquet_file import (
    META_KEY,
    TYPES_KEY,
    VERSION,
    VERSION_KEY,
    Types,
    described,
    read_column,
    to_arrow,
)

Columns = Mapping[str, NDArray[Any]]
_OTHER_FORMATS = frozenset({".csv", ".tsv", ".txt", ".json", ".npy", ".npz", ".mat", ".h5", ".xlsx", ".html", ".toml"})


def new_file(path: str | os.PathLike[str]) -> Path:
    """Return where a trace may be written.

    Raises:
        TraceError: a name that promises another format than Parquet, or something that is no file is there.
    """
    target = as_path(path, "trace", TraceError)
    if target.suffix.lower() in _OTHER_FORMATS:
        raise TraceError(
            f"trace {str(target)!r}: a trace is written as Parquet: name it {target.stem + '.parquet'!r}; in Python "
            "load_trace(...).to_pandas().to_csv(...) makes a CSV of it"
        )
    check_replaceable(target, "trace", TraceError)
    return target


def write(path: str | os.PathLike[str], columns: Columns, meta: Mapping[str, Any]) -> None:
    """Write a trace, all or nothing.

    Args:
        columns: name -> (N,) or (N, k) numbers or flags, or (N,) texts.
        meta: JSON values.

    Raises:
        TraceError: the file cannot be written.
    """
    join(path, [columns], {name: array.dtype for name, array in columns.items()}, meta)


def join(path: str | os.PathLike[str], blocks: Iterable[Columns], types: Types, meta: Mapping[str, Any]) -> None:
    """Write blocks of rows one after the other, a row group each, all or nothing.

    Args:
        blocks: the same columns in each.
        types: name -> type in the file, which holds that of every block.
        meta: JSON values.

    Raises:
        TraceError: the file cannot be written.
    """
    # pyarrow is loaded only where a file is touched: it costs more than the rest of the imports together.
    import pyarrow as pa
    import pyarrow.parquet as pq

    metadata = {
        VERSION_KEY: VERSION,
        META_KEY: json.dumps(dict(meta), allow_nan=False),
        TYPES_KEY: json.dumps({name: dtype.str for name, dtype in types.items()}, allow_nan=False),
    }
    target = new_file(path)
    # In the same directory, because only there is a rename atomic.
    partial = target.with_name(f".{target.name}.{secrets.token_hex(6)}.tmp")
    writer = None
    try:
        for block in blocks:
            arrays = {name: block[name] for name in types}
            table = pa.table([to_arrow(array) for array in arrays.values()], names=list(arrays))
            table = table.replace_schema_metadata(metadata)
            if writer is None:
                writer = pq.ParquetWriter(partial, table.schema, compression="zstd", write_page_checksum=True)
            writer.write_table(table)
        if writer is not None:
            writer.close()
        os.replace(partial, target)
    except OSError as error:
        raise TraceError(
            f"the trace cannot be saved as {str(target)!r} ({error}): "
            f"give a file in a directory that exists and can be written"
        ) from error
    finally:
        with contextlib.suppress(OSError, pa.ArrowException):
            if writer is not None:
                writer.close()
        with contextlib.suppress(OSError):
            partial.unlink()


def read(path: str | os.PathLike[str]) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Read the columns and meta that `write` wrote, the same to the last bit.

    Raises:
        TraceError: the file is missing, damaged, no trace, or does not fit into the memory.
    """
    stored = Stored([path])
    need, free = stored.bytes(), available_bytes()
    if 2 * need > free:
        raise TraceError(
            f"{str(path)!r} takes {2 * need / 2**30:.1f} GiB of memory, and {free / 2**30:.1f} are free: "
            "read it column by column, with Trace.open"
        )
    return {name: stored[name] for name in stored}, stored.meta


class Stored(Mapping[str, NDArray[Any]]):
    """Columns that stay in their files, and are read when they are asked for.

    Args:
        paths: files that `write` wrote, of the same columns, one after the other; at least one.
        rows: only the first so many; None: all.

    Raises:
        TraceError: a file is missing, damaged, no trace, or made to fill the memory.
    """

    def __init__(self, paths: Sequence[str | os.PathLike[str]], rows: int | None = None) -> None:
        self._paths = list(paths)
        self._lengths, self._types, self._widths, self.meta = [], {}, {}, {}  # type: ignore[var-annotated]
        for path in self._paths:
            length, types, widths, self.meta = described(path)
            if self._types and (set(types) != set(self._types) or widths != self._widths):
                raise TraceError(f"{str(path)!r} has other columns than {str(self._paths[0])!r}: no parts of one trace")
            self._lengths.append(length)
            self._widths = widths
            # Texts may be of different lengths.
            self._types = {n: np.promote_types(dtype, self._types.get(n, dtype)) for n, dtype in types.items()}
        self.rows = sum(self._lengths) if rows is None else min(rows, sum(self._lengths))

    @property
    def types(self) -> Types:
        """Name -> type of every column."""
        return dict(self._types)

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of a column: (N,) or (N, k)."""
        width = self._widths[name]
        return (self.rows,) if width is None else (self.rows, width)

    def bytes(self) -> int:
        """Count the bytes of all columns as arrays."""
        return sum(self.rows * dtype.itemsize * (self._widths[name] or 1) for name, dtype in self._types.items())

    def head(self, rows: int) -> Stored:
        """Return the first rows of them."""
        return Stored(self._paths, rows)

    def blocks(self) -> Iterator[Stored]:
        """Yield the rows of one file after the other."""
        for path in self._paths:
            yield Stored([path])

    def __iter__(self) -> Iterator[str]:
        return iter(self._types)

    def __len__(self) -> int:
        return len(self._types)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Read a column: (N,) or (N, k), read-only.

        Raises:
            KeyError: there is none of that name.
            TraceError: damaged.
        """
        dtype, left = self._types[name], self.rows
        parts: list[NDArray[Any]] = []
        for path, length in zip(self._paths, self._lengths, strict=True):
            if left > 0 or not parts:
                parts.append(read_column(path, name, dtype)[: max(left, 0)])
            left -= length
        return read_only(parts[0] if len(parts) == 1 else np.concatenate(parts))
