"""What a Parquet file asks for: pyarrow's own numbers of sound files, a ValueError for all others, never an abort."""

import io
import re

import hypothesis.strategies as st
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings

from moc_opt.inputs.parquet_footer import Demand, demand_of

MOST = 2**33


def written(table, **options):
    sink = io.BytesIO()
    pq.write_table(table, sink, **options)
    return sink.getvalue()


def with_footer(data, footer):
    length = int.from_bytes(data[-8:-4], "little")
    return data[: -8 - length] + footer + len(footer).to_bytes(4, "little") + b"PAR1"


def footer_of(data):
    return data[-8 - int.from_bytes(data[-8:-4], "little") : -8]


def by_pyarrow(data):
    """Count by the library; only for files that are known to be sound."""
    found = pq.read_metadata(io.BytesIO(data))
    groups = [found.row_group(i) for i in range(found.num_row_groups)]
    chunks = [group.column(i) for group in groups for i in range(group.num_columns)]
    asked = sum(max(8 * chunk.num_values, chunk.total_uncompressed_size) for chunk in chunks)
    return Demand(found.num_rows, len(groups), len(chunks), asked)


VALUES = {
    "float": pa.array(np.linspace(0.0, 1.0, 40)), "flag": pa.array([True, False] * 20),
    "text": pa.array(["solved", None] * 20), "pair": pa.FixedSizeListArray.from_arrays(pa.array(np.zeros(80)), 2),
    "list": pa.array([[1.0] * (i % 3) for i in range(40)]), "struct": pa.array([{"a": i, "b": "x"} for i in range(40)]),
    "map": pa.array([[("k", i)] for i in range(40)], pa.map_(pa.string(), pa.int64())),
    "time": pa.array(range(40), pa.timestamp("us", tz="UTC")), "null": pa.nulls(40),
    "decimal": pa.array(range(40), pa.decimal128(20, 2)), "small": pa.array(range(40), pa.uint8()),
}  # fmt: skip


@given(
    names=st.lists(st.sampled_from(sorted(VALUES)), min_size=1, unique=True),
    rows=st.integers(0, 40),
    options=st.fixed_dictionaries(
        {},
        optional={
            "row_group_size": st.integers(1, 40), "compression": st.sampled_from(["zstd", "snappy", None]),
            "write_page_index": st.booleans(), "data_page_version": st.sampled_from(["1.0", "2.0"]),
            "write_statistics": st.booleans(), "store_schema": st.booleans(), "use_dictionary": st.booleans(),
            "version": st.sampled_from(["1.0", "2.4", "2.6"]), "write_page_checksum": st.booleans(),
            "sorting_columns": st.just([pq.SortingColumn(0)]),
        },
    ),
    metadata=st.dictionaries(st.text(max_size=9), st.text(max_size=300), max_size=20),
)  # fmt: skip
@settings(max_examples=150)
def test_a_sound_file_asks_for_what_pyarrow_says(names, rows, options, metadata):
    table = pa.table({name: VALUES[name] for name in names}).slice(0, rows).replace_schema_metadata(metadata)
    data = written(table, **options)
    assert demand_of(io.BytesIO(data), MOST) == by_pyarrow(data)


def test_many_columns_and_row_groups():
    table = pa.table({f"column {i}": np.arange(60.0) for i in range(70)})
    data = written(table, row_group_size=1)
    assert demand_of(io.BytesIO(data), MOST) == by_pyarrow(data)


@pytest.fixture(scope="module")
def sound():
    return written(pa.table({name: VALUES[name] for name in ("float", "text", "list")}), row_group_size=15)


@given(st.data())
@settings(max_examples=600, deadline=None)
def test_a_damaged_footer_is_read_or_a_value_error(sound, data):
    """Whatever pyarrow opens with other numbers of rows than were read is a difference that could be used."""
    footer = bytearray(footer_of(sound))
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(footer) - 1))
        footer[place : place + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=11))
    damaged = with_footer(sound, bytes(footer))
    try:
        found = demand_of(io.BytesIO(damaged), MOST)
    except ValueError:
        return
    try:
        opened = pq.read_metadata(io.BytesIO(damaged))
    except (OSError, ValueError):
        return
    assert (found.rows, found.row_groups) == (opened.num_rows, opened.num_row_groups)
    assert found.rows >= 0
    assert found.bytes >= 0


def test_every_cut_is_refused(sound):
    footer = footer_of(sound)
    for end in range(len(footer)):
        with pytest.raises(ValueError, match=r"footer|bytes|missing|type"):
            demand_of(io.BytesIO(with_footer(sound, footer[:end])), MOST)


def varint(number):
    found = b""
    while number > 127:
        found, number = found + bytes([number & 127 | 128]), number >> 7
    return found + bytes([number])


@pytest.mark.parametrize(
    ("footer", "what"),
    [
        (b"\x1c" * 100_000, "nested"),
        (b"\x19" * 100_000, "nested|where the format"),
        (b"\x16\x00\x16\x00\x00", "missing"),
        (b"\x16\x02\x06\x02\x02\x00", "twice"),
        (b"\x29\xfc" + varint(2**40), "left"),
        (b"\x18" + varint(2**62), "left"),
        (b"\x16" + b"\x80" * 20, "64 bits"),
        (b"\x1d\x00", "type 13"),
        (b"\x29\x15\x02\x00", "where the format has another"),
        (b"\x36\x02\x19\x0c\x00", "no file has"),
        (b"\x36\x01\x19\x0c\x00", "no file has"),
        (b"\x36\x00\x19\x0c\x00" + b"more", "of which 5 are used"),
        (b"", "footer of 0 bytes"),
    ],
)
def test_a_footer_that_no_file_has(sound, footer, what):
    with pytest.raises(ValueError, match=what):
        demand_of(io.BytesIO(with_footer(sound, footer)), MOST)
    empty = b"\x36\x00\x19\x0c\x00"
    assert demand_of(io.BytesIO(with_footer(sound, empty)), MOST) == Demand(0, 0, 0, 0)


@pytest.mark.parametrize("data", [b"", b"PAR1", b"PAR1" * 2, b"PAR1" + b"\xff" * 4 + b"PAR1", b"x" * 100])
def test_no_parquet_file(data):
    with pytest.raises(ValueError, match=r"bytes|Parquet"):
        demand_of(io.BytesIO(data), MOST)


def test_what_would_fill_the_memory_is_refused():
    """A kilobyte for each million values."""
    data, asked = written(pa.table({"none": pa.nulls(10_000_000)})), 80_000_000
    assert len(data) < asked / 2000
    with pytest.raises(ValueError, match=f"{len(data)} bytes that ask for {asked}"):
        demand_of(io.BytesIO(data), MOST)
    small = written(pa.table({"none": pa.nulls(100)}))
    assert demand_of(io.BytesIO(small), 800).bytes == 800
    with pytest.raises(ValueError, match="ask for 800"):
        demand_of(io.BytesIO(small), 799)


def test_sizes_that_do_not_fit_each_other(sound):
    """A histogram with one entry more than its column has levels: pyarrow's `RowGroup.column` aborts the process."""
    footer = footer_of(sound)
    found = list(re.finditer(rb"[\x19\x29\x39]([\x16\x26\x36\x46])", footer))  # lists of 64-bit numbers
    assert len(found) > 3
    for head in found:
        longer = footer[: head.start(1)] + bytes([head[1][0] + 16, 0]) + footer[head.end() :]
        damaged = with_footer(sound, longer)
        assert demand_of(io.BytesIO(damaged), MOST) == demand_of(io.BytesIO(sound), MOST)
