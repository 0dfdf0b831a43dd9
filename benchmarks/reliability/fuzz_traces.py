"""Results as strangers send them: a trace's file with bytes changed, and Parquet files that claim to be traces."""

from __future__ import annotations

import io
import json
from functools import cache

import hypothesis.strategies as st
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.reliability.fuzz_case import folder
from benchmarks.reliability.fuzz_inputs import junk
from moc_opt.trace.parquet import join
from moc_opt.trace.trace import Trace


@cache
def good_trace() -> tuple[Trace, bytes]:
    """Return a small trace and its file."""
    rng = np.random.default_rng(0)
    trace = Trace(
        {
            "t_s": 0.002 * np.arange(20), "q_rad": rng.normal(size=(20, 7)), "mu": rng.uniform(size=20),
            "status": np.array(["solved", "infeasible"] * 10), "verified": rng.uniform(size=20) < 0.5,
            "iterations": np.arange(20, dtype=np.int32),
        },
        {"deadline_us": 2000.0, "scenario": {"name": "x"}, "ended": "completed"},
    )  # fmt: skip
    return trace, saved(trace)


def saved(trace: Trace) -> bytes:
    """Return the bytes of its file."""
    with folder() as where:
        trace.save(where / "trace.parquet")
        return (where / "trace.parquet").read_bytes()


@st.composite
def result_files(draw: st.DrawFn) -> bytes:
    """Draw a trace's file with bytes changed, or a Parquet file of other columns and hostile metadata."""
    if draw(st.booleans()):
        data = bytearray(good_trace()[1])
        for _ in range(draw(st.integers(1, 4))):
            place = draw(st.integers(0, max(len(data) - 1, 0)))
            how = draw(st.integers(0, 3))
            if how == 0 and data:
                data[place] = draw(st.integers(0, 255))
            elif how == 1:
                del data[place : place + draw(st.integers(1, 50))]
            elif how == 2:
                data[place:place] = draw(st.binary(max_size=20))
            else:
                del data[place:]
        return bytes(data)
    return draw(foreign_tables())


@cache
def _sound_files() -> list[tuple[bytes, bytes]]:
    """Return what is before the footer and the footer: of traces of one and of four blocks, and of other writers."""
    trace, data = good_trace()
    with folder() as where:
        types = {name: column.dtype for name, column in trace.columns.items()}
        join(where / "four.parquet", [trace.columns] * 4, types, trace.meta)
        table = pq.read_table(where / "four.parquet")
        files = [data, (where / "four.parquet").read_bytes()]
    for options in (
        {"write_page_index": True, "data_page_version": "2.0"}, {"version": "1.0", "compression": "gzip"},
        {"use_dictionary": False, "compression": None, "write_statistics": False}, {"store_schema": False},
    ):  # fmt: skip
        sink = io.BytesIO()
        pq.write_table(table, sink, row_group_size=20, **options)  # type: ignore[arg-type]
        files.append(sink.getvalue())
    lengths = [int.from_bytes(file[-8:-4], "little") for file in files]
    return [(file[: -8 - n], file[-8 - n : -8]) for file, n in zip(files, lengths, strict=True)]


_ENDS = [
    b"\x00", b"\x01", b"\x7f", b"\xff" * 9 + b"\x01", b"\xfe" + b"\xff" * 8 + b"\x01", b"\xff" * 4 + b"\x0f",
    b"\x80" * 12,
]  # fmt: skip
_HEADS = [0x0C, 0x11, 0x12, 0x15, 0x16, 0x18, 0x19, 0x1A, 0x1B, 0x1C, 0x26, 0x2C, 0xFF]


@st.composite
def footers(draw: st.DrawFn) -> bytes:
    """Draw a Parquet file whose footer is damaged and as long as it says.

    Bits and bytes, heads of Thrift's fields, its numbers at their ends, and pieces taken from elsewhere in it.
    """
    before, sound = draw(st.sampled_from(_sound_files()))
    footer = bytearray(sound)
    for _ in range(draw(st.integers(1, 4))):
        place, other = (draw(st.integers(0, len(footer))) for _ in range(2))
        how, length = draw(st.integers(0, 6)), draw(st.integers(1, 60))
        if how == 0 and place < len(footer):
            footer[place] ^= 1 << draw(st.integers(0, 7))
        elif how == 1:
            footer[place : place + 1] = bytes([draw(st.integers(0, 255))])
        elif how == 2:
            footer[place : place + 1] = bytes([draw(st.sampled_from(_HEADS))])
        elif how == 3:
            del footer[place : place + length]
        elif how == 4:
            footer[place : place + draw(st.integers(0, 1))] = draw(st.sampled_from(_ENDS))
        else:
            footer[place : place + length * (how == 5)] = footer[other : other + length]
    return before + bytes(footer) + len(footer).to_bytes(4, "little") + b"PAR1"


@st.composite
def foreign_tables(draw: st.DrawFn) -> bytes:
    """Draw a Parquet file that claims to be a trace."""
    rows = draw(st.integers(0, 4))
    columns = {
        "t_s": pa.array([0.1] * rows), "list": pa.array([[1.0]] * rows, pa.list_(pa.float64())),
        "fixed": pa.array([[1.0, 2.0]] * rows, pa.list_(pa.float64(), 2)), "bytes": pa.array([b"x"] * rows),
        "text": pa.array(["x"] * rows, pa.string()), "when": pa.array([1] * rows, pa.timestamp("ns")),
        "null": pa.array([None] * rows), "struct": pa.array([{"a": 1}] * rows, pa.struct([("a", pa.int64())])),
        "holes": pa.array([None if i else 1.0 for i in range(rows)], pa.float64()),
        "columns": pa.array([1.0] * rows), "__class__": pa.array([1.0] * rows), "q_rad": pa.array([1.0] * rows),
        "decimal": pa.array([1] * rows, pa.decimal128(30, 2)), "status": pa.array(["solved"] * rows),
    }  # fmt: skip
    names = draw(st.lists(st.sampled_from(sorted(columns)), min_size=1, max_size=4, unique=True))
    kinds = [
        "<f8", "|O", "<U9", "<U999999999", "|V8", "<M8[ns]", "|S4", "<f2", "<c16", "|b1", ">i4", "f8,i4", "junk",
        3, None,
    ]  # fmt: skip
    types = {name: draw(st.sampled_from(kinds)) for name in names}
    if draw(st.booleans()):
        types = {name: "<f8" for name in names}
    metadata = {
        b"moc_opt.trace.trace": draw(st.sampled_from([b"1", b"1", b"1", b"2", b"\xff"])),
        b"moc_opt.types": draw(st.sampled_from([json.dumps(types).encode(), b"[]", b"\xff", b"{}", b"[" * 100_000])),
        b"moc_opt.meta": draw(
            st.one_of(
                st.just(b"{}"), st.just(b'{"deadline_us": NaN}'), st.just(b"[" * 100_000), st.just(b'[["a", 1]]'),
                junk.map(lambda value: json.dumps(value).encode("utf-8", "surrogatepass")), st.binary(max_size=30),
            )
        ),
        **draw(st.dictionaries(st.binary(min_size=1, max_size=5), st.binary(max_size=20), max_size=2)),
    }  # fmt: skip
    table = pa.table({name: columns[name] for name in names}).replace_schema_metadata(metadata)
    sink = io.BytesIO()
    pq.write_table(table, sink)
    return sink.getvalue()
