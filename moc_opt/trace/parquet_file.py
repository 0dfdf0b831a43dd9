"""One Parquet file of a trace: its footer, its columns as arrays, and its checks.

Columns are arrow arrays of numbers, of fixed-size lists for (N, k), or of dictionary-encoded texts; meta is JSON in the
schema's metadata.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import TraceError, describe
from moc_opt.inputs.files import MOST_TEXT, check_regular, parse_json
from moc_opt.inputs.parquet_footer import demand_of

Types = dict[str, np.dtype[Any]]

MOST_ROWS = 20_000_000
"""Ticks of a trace: 11 hours at 500 Hz."""
VERSION = "1"
VERSION_KEY, META_KEY, TYPES_KEY = b"moc_opt.trace.trace", b"moc_opt.meta", b"moc_opt.types"
_MOST_BYTES = 2**33


@contextmanager
def _opened(path: str | os.PathLike[str], **options: Any) -> Iterator[Any]:
    """Yield a Parquet file that was looked at before; what its reader says is turned into TraceError."""
    import pyarrow.parquet as pq

    with (
        _told(path),
        pq.ParquetFile(
            path, page_checksum_verification=True, thrift_string_size_limit=MOST_TEXT,
            thrift_container_size_limit=1_000_000, **options,
        ) as file,
    ):  # fmt: skip
        yield file


@contextmanager
def _told(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn what a reader says of a damaged file into TraceError."""
    import pyarrow as pa

    check_regular(path, "trace", TraceError)
    try:
        yield
    except TraceError:
        raise
    except (OSError, ValueError, KeyError, MemoryError, pa.ArrowException) as error:
        raise TraceError(
            f"{str(path)!r} is damaged or no Parquet file ({describe(error)}): "
            "run the scenario again and save its trace"
        ) from error


def described(path: str | os.PathLike[str]) -> tuple[int, Types, dict[str, int | None], dict[str, Any]]:
    """Read rows, types, widths and meta of a file, from its footer alone."""
    import pyarrow as pa

    name = str(path)
    rows = _checked_rows(path)
    with _opened(path) as file:
        schema = file.schema_arrow
        metadata = schema.metadata or {}
    version = metadata.get(VERSION_KEY, b"").decode(errors="replace")
    if version != VERSION:
        found = f"a trace of format {version!r}" if version else "a Parquet file, but no trace"
        raise TraceError(f"{name!r} is {found}: give a file written by Trace.save of this version")
    wrong = f"{name!r} holds columns or metadata that no trace has"
    try:
        types = parse_json(metadata[TYPES_KEY], wrong, TraceError)
        meta = dict(parse_json(metadata[META_KEY], wrong, TraceError))
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


def _checked_rows(path: str | os.PathLike[str]) -> int:
    """Count the rows of a file that asks for no more than a trace may, before pyarrow is given it."""
    with _told(path), open(path, "rb") as file:
        rows = demand_of(file, _MOST_BYTES).rows
    if rows > MOST_ROWS:
        raise TraceError(f"{str(path)!r} is damaged or no trace: {rows} rows, {MOST_ROWS} at most")
    return rows


def read_column(path: str | os.PathLike[str], name: str, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Read one column of one file."""
    import pyarrow as pa

    with _opened(path, read_dictionary=[name] if dtype.kind == "U" else None) as file:
        found = file.read([name]).column(name)
    try:
        return from_arrow(found, dtype)
    except (ValueError, TypeError, MemoryError, pa.ArrowException) as error:
        raise TraceError(
            f"{str(path)!r} holds columns or metadata that no trace has ({name!r}: {describe(error)}): "
            "run the scenario again and save its trace"
        ) from error


def to_arrow(array: NDArray[Any]) -> Any:
    """Make an arrow array of one column; floats as they are, bit by bit, NaN not as null."""
    import pyarrow as pa

    if array.dtype.kind == "U":
        return pa.array(array.tolist(), pa.string()).dictionary_encode()
    values = pa.array(np.ascontiguousarray(array).reshape(math.prod(array.shape)))
    return values if array.ndim == 1 else pa.FixedSizeListArray.from_arrays(values, array.shape[1])


def from_arrow(column: Any, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the array that `to_arrow` was given."""
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
