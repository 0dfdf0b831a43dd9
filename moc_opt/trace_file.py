"""The Parquet form of a trace: columns of arrays, and JSON about the run in the schema's metadata."""

from __future__ import annotations

import contextlib
import json
import math
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import TraceError

Columns = Mapping[str, NDArray[Any]]

_VERSION = "1"
_MOST_ROWS, _MOST_BYTES = 20_000_000, 2**31
_VERSION_KEY, _META_KEY, _TYPES_KEY = b"moc_opt.trace", b"moc_opt.meta", b"moc_opt.types"


def write(path: str | os.PathLike[str], columns: Columns, meta: Mapping[str, Any]) -> None:
    """Write a trace, all or nothing.

    Args:
        path: the file.
        columns: name -> (N,) or (N, k) numbers or flags, or (N,) texts.
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
        _TYPES_KEY: json.dumps({name: array.dtype.str for name, array in columns.items()}),
    }
    table = pa.table([_to_arrow(array) for array in columns.values()], names=list(columns))
    target = Path(path)
    # In the same directory, because only there is a rename atomic.
    partial = target.with_name(f".{target.name}.{secrets.token_hex(6)}.tmp")
    try:
        pq.write_table(
            table.replace_schema_metadata(metadata), partial, compression="zstd", write_page_checksum=True
        )
        os.replace(partial, target)
    except OSError as error:
        raise TraceError(
            f"the trace cannot be saved as {str(target)!r} ({error}): "
            f"give a file in a directory that exists and can be written"
        ) from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()


def read(path: str | os.PathLike[str]) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Read the columns and meta that `write` wrote, the same to the last bit.

    Raises:
        TraceError: the file is missing, damaged, or no trace.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    name = str(path)
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            if file.metadata.num_rows > _MOST_ROWS:  # a few bytes of a repeated value can stand for terabytes
                raise ValueError(f"{file.metadata.num_rows} rows, {_MOST_ROWS} at most")
            table = file.read()
    except FileNotFoundError as error:
        raise TraceError(f"there is no trace {name!r}: check the path") from error
    except (OSError, ValueError, pa.ArrowException) as error:
        raise TraceError(
            f"{name!r} is damaged or no Parquet file ({error}): run the scenario again and save its trace"
        ) from error
    metadata = table.schema.metadata or {}
    version = metadata.get(_VERSION_KEY, b"").decode(errors="replace")
    if version != _VERSION:
        found = f"a trace of format {version!r}" if version else "a Parquet file, but no trace"
        raise TraceError(f"{name!r} is {found}: give a file written by Trace.save of this version")
    try:
        types, meta = json.loads(metadata[_TYPES_KEY]), dict(json.loads(metadata[_META_KEY]))
        names = table.column_names
        return {key: _from_arrow(table.column(key), np.dtype(types[key])) for key in names}, meta
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError, pa.ArrowException) as error:
        raise TraceError(
            f"{name!r} holds columns or metadata that no trace has ({error}): "
            f"run the scenario again and save its trace"
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

    if dtype.kind not in "fiubU" or dtype.names is not None:
        raise ValueError(f"type {dtype} is none of a trace's")
    array = column.combine_chunks()
    if array.null_count:
        raise ValueError("a row is null")
    if dtype.kind == "U":
        if dtype.itemsize * len(array) > _MOST_BYTES:
            raise ValueError(f"type {dtype} for {len(array)} texts")
        return np.array(array.to_pylist(), dtype=dtype)
    if not pa.types.is_fixed_size_list(array.type):
        return np.asarray(array.to_numpy(zero_copy_only=False), dtype=dtype)
    width = array.type.list_size
    return np.asarray(array.flatten().to_numpy(zero_copy_only=False), dtype=dtype).reshape(-1, width)
