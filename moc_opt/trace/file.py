"""The Parquet file of a trace."""

from __future__ import annotations

import io
import json
import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import TraceError, describe
from moc_opt.inputs.files import MOST_DATA, as_path, check_replaceable, read_bytes, write_whole

if TYPE_CHECKING:
    import polars as pl

Columns = Mapping[str, NDArray[Any]]

VERSION = "2"
VERSION_KEY, META_KEY, TYPES_KEY, SUM_KEY = "moc_opt.trace.trace", "moc_opt.meta", "moc_opt.types", "moc_opt.crc32"
MOST_BYTES = 2**32  # largest unpacked size, because a small file could unpack to any size
_OTHER_FORMATS = frozenset({".csv", ".tsv", ".txt", ".json", ".npy", ".npz", ".mat", ".h5", ".xlsx", ".html", ".toml"})


def new_file(path: str | os.PathLike[str]) -> Path:
    """Return the path of a new trace. Raise a TraceError if the path cannot be used."""
    target = as_path(path, "trace", TraceError)
    if target.suffix.lower() in _OTHER_FORMATS:
        raise TraceError(
            f"trace {str(target)!r} has to be a Parquet file: name it {target.stem + '.parquet'!r}; in Python "
            "load_trace(...).to_pandas().to_csv(...) converts it to CSV"
        )
    folder = target.absolute().parent
    if not os.path.isdir(folder):
        raise TraceError(f"the trace cannot be saved as {str(target)!r}: there is no folder {str(folder)!r}")
    check_replaceable(target, "trace", TraceError)
    return target


def check_trace(path: str | os.PathLike[str], kind: str = "run") -> None:
    """Raise a TraceError if the path is a non-empty file, but no trace of this kind."""
    import polars as pl

    if os.path.isfile(path) and os.path.getsize(path):
        try:
            found = pl.read_parquet_metadata(os.fspath(path))
            is_kind = VERSION_KEY in found and json.loads(found[META_KEY]).get("kind", "run") == kind
        except (OSError, ValueError, LookupError, pl.exceptions.PolarsError):
            is_kind = False
        if not is_kind:
            raise TraceError(f"{os.fspath(path)!r} holds no {kind} and would be replaced: give another name or --force")


def write(path: str | os.PathLike[str], columns: Columns, meta: Mapping[str, Any]) -> None:
    """Write a trace. Raise a TraceError if the file cannot be written."""
    import polars as pl  # slow to import

    target, packed = new_file(path), io.BytesIO()
    entries = json.dumps(dict(meta))
    types = json.dumps({name: array.dtype.str for name, array in columns.items()})
    metadata = {VERSION_KEY: VERSION, META_KEY: entries, TYPES_KEY: types, SUM_KEY: checksum(columns, entries, types)}
    frame = pl.DataFrame([
        pl.Series(name, array.tolist(), dtype=pl.String) if array.dtype.kind == "U" else pl.Series(name, array)
        for name, array in columns.items()
    ])  # fmt: skip
    frame.write_parquet(packed, compression="zstd", metadata=metadata)
    write_whole(target, packed.getvalue(), "trace", TraceError)


def read(path: str | os.PathLike[str]) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Read columns and meta. Raise a TraceError if the file is missing, damaged or no trace."""
    import polars as pl

    file = as_path(path, "trace", TraceError)
    where = repr(str(file))
    if file.suffix.lower() == ".toml":
        raise TraceError(f"{where} is a scenario, no trace: run it first: moc-opt run {file} --trace run.parquet")
    data = read_bytes(path, "trace", TraceError, MOST_DATA)
    try:
        metadata = pl.read_parquet_metadata(data)
        version = metadata.get(VERSION_KEY, "")
        if version != VERSION:
            found = f"a trace of format {version!r}" if version else "a Parquet file, but no trace"
            raise TraceError(f"{where} is {found}: give a file written by Trace.save of this version")
        types = {name: np.dtype(of) for name, of in json.loads(metadata[TYPES_KEY]).items()}
        rows = pl.scan_parquet(data).select(pl.len()).collect().item()
        if rows * sum(of.itemsize for of in types.values()) > MOST_BYTES:
            raise ValueError(f"{rows} rows of {len(types)} columns are too many for a trace")
        columns = {column.name: _array(column, types[column.name]) for column in pl.read_parquet(io.BytesIO(data))}
        if metadata[SUM_KEY] != checksum(columns, metadata[META_KEY], metadata[TYPES_KEY]):
            raise ValueError("its checksum does not match")
        return columns, dict(json.loads(metadata[META_KEY]))
    except (
        pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, LookupError, TypeError, ValueError,
        AttributeError, SyntaxError, RecursionError,
    ) as error:  # fmt: skip
        raise TraceError(
            f"{where} is damaged or no trace ({describe(error)}): run the scenario again and save its trace"
        ) from error


def _array(column: pl.Series, dtype: np.dtype[Any]) -> NDArray[Any]:
    if dtype.kind not in "fiubU":
        raise ValueError(f"column {column.name!r} has the wrong type {dtype}")
    return np.array(column.to_list() if dtype.kind == "U" else column.to_numpy(), dtype=dtype)


def checksum(columns: Columns, *texts: str) -> str:
    """Return the CRC-32 of the texts and columns."""
    found = zlib.crc32("".join(texts).encode())
    for array in columns.values():
        found = zlib.crc32(array.tobytes(), found)
    return str(found)
