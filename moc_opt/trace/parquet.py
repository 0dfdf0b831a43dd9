"""The Parquet form of a trace: columns of arrays, and JSON about the run in the schema's metadata."""

from __future__ import annotations

import contextlib
import json
import math
import os
import secrets
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import TraceError, describe
from moc_opt.inputs.files import MOST_TEXT, check_regular, check_replaceable, parse_json
from moc_opt.inputs.memory import available_bytes

Columns = Mapping[str, NDArray[Any]]
Types = dict[str, np.dtype[Any]]

MOST_ROWS = 20_000_000
"""Ticks of a trace: 11 hours at 500 Hz."""
_VERSION = "1"
_MOST_BYTES = 2**33
# Noise does not shrink, a constant does, by this much at most: beyond it a file is made to fill the memory.
_SHRINKS, _SMALL = 2000, 2**26
_VERSION_KEY, _META_KEY, _TYPES_KEY = b"moc_opt.trace.trace", b"moc_opt.meta", b"moc_opt.types"


def write(path: str | os.PathLike[str], columns: Columns, meta: Mapping[str, Any]) -> None:
    """Write a trace, all or nothing.

    Args:
        path: the file.
        columns: name -> (N,) or (N, k) numbers or flags, or (N,) texts.
        meta: JSON values.

    Raises:
        TraceError: the file cannot be written.
    """
    join(path, [columns], {name: array.dtype for name, array in columns.items()}, meta)


def join(path: str | os.PathLike[str], blocks: Sequence[Columns], types: Types, meta: Mapping[str, Any]) -> None:
    """Write blocks of rows one after the other, a row group each, all or nothing.

    Args:
        path: the file.
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
        _VERSION_KEY: _VERSION,
        _META_KEY: json.dumps(dict(meta), allow_nan=False),
        _TYPES_KEY: json.dumps({name: dtype.str for name, dtype in types.items()}, allow_nan=False),
    }
    target = Path(path)
    check_replaceable(target, "trace", TraceError)
    # In the same directory, because only there is a rename atomic.
    partial = target.with_name(f".{target.name}.{secrets.token_hex(6)}.tmp")
    writer = None
    try:
        for block in blocks:
            arrays = {name: block[name] for name in types}
            table = pa.table([_to_arrow(array) for array in arrays.values()], names=list(arrays))
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
            length, types, widths, self.meta = _described(path)
            if self._types and (set(types) != set(self._types) or widths != self._widths):
                raise TraceError(f"{str(path)!r} has other columns than {str(self._paths[0])!r}: no parts of one trace")
            self._lengths.append(length)
            self._widths = widths
            self._types = {name: _common(dtype, self._types.get(name)) for name, dtype in types.items()}
        self.rows = sum(self._lengths) if rows is None else min(rows, sum(self._lengths))

    @property
    def types(self) -> Types:
        """Name -> type of every column."""
        return dict(self._types)

    def shape(self, name: str) -> tuple[int, ...]:
        """Of a column: (N,) or (N, k)."""
        width = self._widths[name]
        return (self.rows,) if width is None else (self.rows, width)

    def bytes(self) -> int:
        """Of all columns as arrays."""
        return sum(self.rows * dtype.itemsize * (self._widths[name] or 1) for name, dtype in self._types.items())

    def head(self, rows: int) -> Stored:
        """The first rows of them."""
        return Stored(self._paths, rows)

    def blocks(self) -> Iterator[Columns]:
        """The rows of one file after the other."""
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
                parts.append(_column(path, name, dtype)[: max(left, 0)])
            left -= length
        array = parts[0] if len(parts) == 1 else np.concatenate(parts)
        array.setflags(write=False)
        return array


def _common(one: np.dtype[Any], other: np.dtype[Any] | None) -> np.dtype[Any]:
    """The type that holds both: texts may be of different lengths."""
    return one if other is None else np.promote_types(one, other)


@contextmanager
def _opened(path: str | os.PathLike[str], **options: Any) -> Iterator[Any]:
    """A Parquet file that was looked at before; what its reader says is turned into TraceError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    check_regular(path, "trace", TraceError)
    try:
        with pq.ParquetFile(
            path, page_checksum_verification=True, thrift_string_size_limit=MOST_TEXT,
            thrift_container_size_limit=1_000_000, **options,
        ) as file:  # fmt: skip
            yield file
    except TraceError:
        raise
    except (OSError, ValueError, KeyError, MemoryError, pa.ArrowException) as error:
        raise TraceError(
            f"{str(path)!r} is damaged or no Parquet file ({describe(error)}): "
            "run the scenario again and save its trace"
        ) from error


def _described(path: str | os.PathLike[str]) -> tuple[int, Types, dict[str, int | None], dict[str, Any]]:
    """Rows, types, widths and meta of a file, from its footer alone."""
    import pyarrow as pa

    name = str(path)
    with _opened(path) as file:
        rows, schema = file.metadata.num_rows, file.schema_arrow
        _check_size(name, file.metadata, os.path.getsize(path))
        metadata = schema.metadata or {}
    version = metadata.get(_VERSION_KEY, b"").decode(errors="replace")
    if version != _VERSION:
        found = f"a trace of format {version!r}" if version else "a Parquet file, but no trace"
        raise TraceError(f"{name!r} is {found}: give a file written by Trace.save of this version")
    wrong = f"{name!r} holds columns or metadata that no trace has"
    try:
        types = parse_json(metadata[_TYPES_KEY], wrong, TraceError)
        meta = dict(parse_json(metadata[_META_KEY], wrong, TraceError))
        kinds = {field.name: np.dtype(types[field.name]) for field in schema}
        widths = {
            field.name: field.type.list_size if pa.types.is_fixed_size_list(field.type) else None for field in schema
        }
    except TraceError:
        raise
    except (KeyError, TypeError, AttributeError, ValueError, SyntaxError) as error:
        raise TraceError(f"{wrong} ({describe(error)}): run the scenario again and save its trace") from error
    for column, dtype in kinds.items():
        if dtype.kind not in "fiubU" or dtype.names is not None or dtype.itemsize * rows > _MOST_BYTES:
            raise TraceError(f"{wrong} (type {dtype.str} of column {column!r}, {rows} rows)")
    if len(kinds) < len(schema.names):
        raise TraceError(f"{wrong} (two columns of one name)")
    return rows, kinds, widths, meta


def _check_size(name: str, found: Any, size: int) -> None:
    """Refuse a file that is made to fill the memory: a few bytes of a repeated value can stand for terabytes."""
    if found.num_rows > MOST_ROWS:
        raise TraceError(f"{name!r} is damaged or no trace: {found.num_rows} rows, {MOST_ROWS} at most")
    asked = 0
    for group in range(found.num_row_groups):
        part = found.row_group(group)
        for i in range(part.num_columns):
            chunk = part.column(i)
            asked += max(8 * chunk.num_values, chunk.total_uncompressed_size)
    if asked > min(_MOST_BYTES, max(_SMALL, _SHRINKS * size)):
        raise TraceError(f"{name!r} is damaged or no trace: {size} bytes that ask for {asked}")


def _column(path: str | os.PathLike[str], name: str, dtype: np.dtype[Any]) -> NDArray[Any]:
    """One column of one file."""
    import pyarrow as pa

    with _opened(path, read_dictionary=[name] if dtype.kind == "U" else None) as file:
        found = file.read([name]).column(name)
    try:
        return _from_arrow(found, dtype)
    except (ValueError, TypeError, MemoryError, pa.ArrowException) as error:
        raise TraceError(
            f"{str(path)!r} holds columns or metadata that no trace has ({name!r}: {describe(error)}): "
            "run the scenario again and save its trace"
        ) from error


def _to_arrow(array: NDArray[Any]) -> Any:
    """One column as an arrow array; floats as they are, bit by bit, NaN not as null."""
    import pyarrow as pa

    if array.dtype.kind == "U":
        return pa.array(array.tolist(), pa.string()).dictionary_encode()
    values = pa.array(np.ascontiguousarray(array).reshape(math.prod(array.shape)))
    return values if array.ndim == 1 else pa.FixedSizeListArray.from_arrays(values, array.shape[1])


def _from_arrow(column: Any, dtype: np.dtype[Any]) -> NDArray[Any]:
    """The array that `_to_arrow` was given."""
    import pyarrow as pa

    array = column.combine_chunks()
    if array.null_count:
        raise ValueError("a row is null")
    if dtype.kind == "U":
        if dtype.itemsize * len(array) > _MOST_BYTES:
            raise ValueError(f"type {dtype} for {len(array)} texts")
        if isinstance(array, pa.ChunkedArray):
            array = array.unify_dictionaries().combine_chunks()
        if pa.types.is_dictionary(array.type):  # each text once, whatever the number of rows
            words = np.array([*array.dictionary.to_pylist(), ""], dtype=dtype)
            return words[array.indices.to_numpy(zero_copy_only=False)]
        return np.array(array.to_pylist(), dtype=dtype)
    if not pa.types.is_fixed_size_list(array.type):
        return np.asarray(array.to_numpy(zero_copy_only=False), dtype=dtype)
    width = array.type.list_size
    return np.array(array.flatten().to_numpy(zero_copy_only=False), dtype=dtype).reshape(-1, width)
