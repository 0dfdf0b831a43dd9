"""The tables of a sweep: their columns, and the reproducible bytes of the final ones."""

from __future__ import annotations

import io
import os
import re
import secrets
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.sweeps.errors import StoreError
from benchmarks.sweeps.plan import Plan, canonical
from moc_opt.inputs.files import plain, read_bytes
from moc_opt.inputs.parquet_footer import demand_of

BLOCK = 20_000
"""Rows of a row group of the final tables, whatever the pieces were: the bytes depend on it."""
PLAN_KEY = b"moc_opt.sweep"
MOST_BYTES = 2**28
"""Of a shard, packed and unpacked."""


def is_clock(metric: str) -> bool:
    """Tell whether a metric is read off a clock, so that two runs of the same scenario differ in it."""
    return metric.endswith("_us") or metric == "deadline_misses"


def record_schema(metrics: Sequence[str]) -> pa.Schema:
    """Describe one finished run as it is kept: place in the plan, error or figures, and how it was timed."""
    return pa.schema(
        [
            ("index", pa.int64()),
            ("ended", pa.string()),
            ("error", pa.string()),
            ("timing_shared", pa.bool_()),
            ("wall_s", pa.float64()),
        ]
        + [(name, pa.float64()) for name in metrics]
    )


def rows_schema(plan: Plan) -> pa.Schema:
    """Describe rows.parquet: everything that the plan decides."""
    values = plan.grid | plan.draws
    fields = [(path, column_type(values[path])) for path in plan.fields]
    figures = [(name, pa.float64()) for name in plan.metrics if not is_clock(name)]
    head = [("index", pa.int64()), ("run", pa.string()), ("solver", pa.string()), ("seed", pa.int64())]
    schema = pa.schema([*head, *fields, ("ended", pa.string()), ("error", pa.string()), *figures])
    return schema.with_metadata({PLAN_KEY: plan.digest})


def clock_schema(plan: Plan) -> pa.Schema:
    """Describe clock.parquet: measured times, row by row as in rows.parquet."""
    figures = [(name, pa.float64()) for name in plan.metrics if is_clock(name)]
    head = [("index", pa.int64()), ("run", pa.string()), ("solver", pa.string()), ("timing_shared", pa.bool_())]
    return pa.schema([*head, ("wall_s", pa.float64()), *figures]).with_metadata({PLAN_KEY: plan.digest})


def column_type(values: Iterable[Any]) -> pa.DataType:
    """Store numbers, flags and texts as such; anything mixed or nested as the text of its JSON."""
    kinds = {type(value) for value in values}
    if kinds <= {int, float} and kinds:
        return pa.int64() if kinds == {int} else pa.float64()
    return pa.bool_() if kinds == {bool} else pa.string()


def record_table(records: Sequence[Mapping[str, Any]], metrics: Sequence[str]) -> pa.Table:
    """Return finished runs as a table of :func:`record_schema`; figures that are not finite become null."""
    schema = record_schema(metrics)
    flat = [{**record, **record["figures"]} for record in records]
    return pa.table({n: pa.array([plain(row.get(n)) for row in flat], schema.field(n).type) for n in schema.names})


def described(plan: Plan, indices: Sequence[int]) -> dict[str, list[Any]]:
    """Return the columns that the plan knows, for some of its runs."""
    points = [plan.point(i) for i in indices]
    schema = rows_schema(plan)
    columns: dict[str, list[Any]] = {
        "run": [plan.run_id(i) for i in indices],
        "solver": [point.solver for point in points],
        "seed": [point.seed for point in points],
    }
    for path in plan.fields:
        found = [point.values[path] for point in points]
        if schema.field(path).type == pa.string():
            found = [v if v is None or isinstance(v, str) else canonical(v) for v in found]
        columns[path] = found
    return columns


def write_final(folder: Path, plan: Plan, blocks: Iterator[pa.Table]) -> None:
    """Write rows.parquet and clock.parquet, from blocks of records in order; both appear whole, or not at all.

    Args:
        blocks: tables of :func:`record_schema`, BLOCK rows each but the last, sorted by index.

    Raises:
        OSError: no space, no permission.
    """
    # The rows come last: where they are, the sweep is finished.
    with (
        whole_parquet(folder / "rows.parquet", rows_schema(plan)) as write_rows,
        whole_parquet(folder / "clock.parquet", clock_schema(plan)) as write_clock,
    ):
        for block in blocks:
            known = described(plan, block.column("index").to_pylist())
            for write, schema in ((write_rows, rows_schema(plan)), (write_clock, clock_schema(plan))):
                columns = [
                    pa.array(known[field.name], field.type)
                    if field.name in known
                    else block.column(field.name).combine_chunks()
                    for field in schema
                ]
                write(pa.table(columns, schema=schema))


@contextmanager
def whole_parquet(path: Path, schema: pa.Schema) -> Iterator[Callable[[pa.Table], None]]:
    """Make a Parquet file that is there only once all of it is written; yields what writes one row group."""
    name = path.with_name(f".{path.name}.{secrets.token_hex(6)}")
    try:
        with open(name, "xb") as file:
            # No statistics of time or writer enter: the same tables in give the same bytes out.
            with pq.ParquetWriter(file, schema, compression="zstd", write_page_checksum=True) as writer:
                yield lambda table: writer.write_table(table, row_group_size=BLOCK)
            file.flush()
            os.fsync(file.fileno())
        os.replace(name, path)
    except BaseException:
        name.unlink(missing_ok=True)
        raise


def read_shard(path: Path, digest: str) -> pa.Table:
    """Read a table of records that was written whole, ``N-CRC.parquet``, for the sweep of this digest.

    Raises:
        StoreError: damaged, of another sweep, or something else.
    """
    table = _read(path)
    if table.schema.metadata.get(PLAN_KEY, b"").decode(errors="replace") != digest:
        raise StoreError(f"{path}: of another sweep; start the same command again: its runs are done again")
    return table


def shard_plan(path: Path) -> str:
    """Return the digest of the sweep that a shard belongs to; StoreError where it is damaged."""
    owner: bytes = _read(path).schema.metadata.get(PLAN_KEY, b"")
    return owner.decode(errors="replace")


def _read(path: Path) -> pa.Table:
    again = "start the same command again: its runs are done again"
    data = read_bytes(path, "part of a sweep", StoreError, MOST_BYTES)
    if not re.fullmatch(rf"[0-9]{{6,9}}-{zlib.crc32(data):08x}", path.stem):
        raise StoreError(f"{path}: damaged, or no part of a sweep; {again}")
    try:
        demand_of(io.BytesIO(data), MOST_BYTES)
        table = pq.read_table(pa.BufferReader(data))
    except (OSError, ValueError, pa.ArrowException, MemoryError) as error:
        raise StoreError(f"{path}: no table of a sweep ({error}); {again}") from error
    if table.schema.metadata is None:
        raise StoreError(f"{path}: no table of a sweep; {again}")
    return table
