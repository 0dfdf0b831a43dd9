"""A malformed trace is read or refused. It neither runs code nor controls the terminal."""

import contextlib
import copy
import json

import hypothesis.strategies as st
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given

import moc_opt as mo
from moc_opt.errors import TraceError
from moc_opt.report.replay import load_runs
from moc_opt.report.run_table import part, remarks, run_json, run_tables
from moc_opt.scenario import Scenario, run
from moc_opt.trace import file
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace
from tests.odd_inputs import ends_well, junk, many
from tests.trace.test_trace import WARNING, assert_same, example

GOOD = example(20)


@pytest.fixture(scope="module")
def good_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("good") / "trace.parquet"
    GOOD.save(path)
    return path.read_bytes()


changes = st.lists(
    st.tuples(st.floats(0.0, 1.0), st.sampled_from(["flip", "cut", "insert", "end", "copy"]), st.binary(max_size=12)),
    min_size=1, max_size=4,
)  # fmt: skip


def changed(data, changes):
    for share, how, new in changes:
        place = round(share * len(data))
        data = data[:place] + {
            "flip": new + data[place + len(new) :], "cut": data[place + 5 * len(new) :], "insert": new + data[place:],
            "end": b"", "copy": data[-place - 40 : -place - 10] + data[place + 20 :],
        }[how]  # fmt: skip
    return data


@many(2.0)
@given(st.booleans(), changes)
def test_a_damaged_trace_is_read_or_refused(tmp_path, good_file, footer_only, changes):
    """With `footer_only`, only the footer is damaged, and the file states the new length of the footer."""
    path, length = tmp_path / "trace.parquet", int.from_bytes(good_file[-8:-4], "little")
    if footer_only:
        footer = changed(good_file[-8 - length : -8], changes)
        path.write_bytes(good_file[: -8 - length] + footer + len(footer).to_bytes(4, "little") + b"PAR1")
    else:
        path.write_bytes(changed(good_file, changes))
    with ends_well(path.name):
        assert_same(mo.load_trace(path), GOOD)


VALUES = {
    "list": [[1.0], [1.0]], "bytes": [b"x", b"y"], "struct": [{"a": 1}] * 2, "holes": [1.0, None],
    "columns": [1.0, 2.0], "__class__": [1.0, 2.0], "q_rad": [1.0, 2.0], "text": ["x", "y"], "t_s": [0.1, 0.2],
    "when": pa.array([1, 2], pa.timestamp("ns")), "decimal": pa.array([1, 2], pa.decimal128(30, 2)),
}  # fmt: skip
DEEP, SOUND = b"[" * 100_000, {"t_s": "<f8"}
CLAIMS = [  # metadata of a file: (types of the columns, or bytes in place of their JSON; meta; version)
    *(({name: "<f8"}, b"{}", b"2") for name in VALUES if name != "t_s"), (SOUND, DEEP, b"2"), (SOUND, b"{}", b"\xff"),
    *(({"t_s": kind}, b"{}", b"2") for kind in ("|O", "<U9", "|V8", "<M8[ns]", "<c16", "|b1", "f8,i4", "junk", 3)),
    ({"text": "<U999999999"}, b"{}", b"2"), (b"[]", b"{}", b"2"), (DEEP, b"{}", b"2"), (b"\xff", b"{}", b"2"),
    *((SOUND, meta, b"2") for meta in (b'{"deadline_us": NaN}', b'[["a", 1]]', b"\xff", b"3", b'{"ended": 3}')),
]


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: str(claim)[:60])
def test_file_that_claims_to_be_a_trace_is_checked(tmp_path, claim):
    types, meta, version = claim
    path, names = tmp_path / "trace.parquet", types if isinstance(types, dict) else SOUND
    types = json.dumps(types).encode() if isinstance(types, dict) else types
    keys = {b"moc_opt.trace.trace": version, b"moc_opt.types": types, b"moc_opt.meta": meta}
    with contextlib.suppress(TypeError, ValueError, SyntaxError):
        small = {name: np.dtype(kind) for name, kind in names.items() if kind != "<U999999999"}
        arrays = {name: np.array(pa.array(VALUES[name]).to_pylist(), dtype=kind) for name, kind in small.items()}
        keys[b"moc_opt.crc32"] = file.checksum(arrays, meta.decode(), types.decode())
    pq.write_table(pa.table({name: VALUES[name] for name in names}).replace_schema_metadata(keys), path)
    with contextlib.suppress(TraceError):
        assert all(column.dtype.kind in "fiubU" for column in mo.load_trace(path).columns.values())


def test_parquet_file_of_many_rows_is_not_unpacked(tmp_path):
    """A few kilobytes could unpack to terabytes."""
    path, rows = tmp_path / "many.parquet", 3_000_000
    keys = {"moc_opt.trace.trace": "2", "moc_opt.types": '{"status": "<U1000"}', "moc_opt.meta": "{}"}
    pq.write_table(pa.table({"status": ["solved"] * rows}).replace_schema_metadata(keys), path)
    assert path.stat().st_size < 1e6
    with pytest.raises(TraceError, match=f"{rows} rows"):
        mo.load_trace(path)


MARK = "\x1b[2J<script>alert(1)</script>\u202e"
odd_entries = junk | st.sampled_from([MARK, "a" * 100_000, [0] * 10_000, 1e308, 1e-320, 2**62, [[]], {"": {}}])
odd_columns = st.sampled_from(["text", "one", "nothing", 0.0, np.nan, np.inf, 1e308, 5e-324])


@pytest.fixture(scope="module")
def faulty_run():
    trace = run(Scenario(duration_s=0.04, bound_samples=2, faults={"solver": "raise", "solver_share": 0.5}))
    more = {"warnings": [WARNING], "restarts": [{"at_s": 0.1, "reason": "it hung"}]}
    return dict(trace.columns), {**json.loads(json.dumps(dict(trace.meta))), **more}


def places(value, before=()):
    yield before
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, entry in pairs:
        yield from places(entry, (*before, key))


@many()
@given(data=st.data())
def test_a_foreign_trace_is_shown_or_refused(tmp_path, faulty_run, data):
    columns, meta = dict(faulty_run[0]), copy.deepcopy(faulty_run[1])
    entries = [place for place in places(meta) if place]
    for _ in range(data.draw(st.integers(0, 3))):
        (*path, last), odd, inner = data.draw(st.sampled_from(entries)), data.draw(odd_entries), meta
        with contextlib.suppress(KeyError, IndexError, TypeError):  # removed by an earlier change
            for key in path:
                inner = inner[key]
            inner[last] = odd
    name, how = data.draw(st.sampled_from(sorted(columns))), data.draw(odd_columns)
    if how in ("one", "nothing"):
        columns = {key: column[: how == "one"] for key, column in columns.items()}
    elif how == "text":
        columns[name] = np.full(len(columns[name]), MARK)
    elif columns[name].dtype.kind == "f":
        columns[name] = np.full_like(columns[name], how)
    with ends_well():
        Trace(columns, meta).save(tmp_path / "trace.parquet")
        (trace,) = load_runs([tmp_path / "trace.parquet"])[0].values()
        metrics = summarize(trace)
        assert all(isinstance(line, str) for line in (part(trace), *remarks(trace)))
        json.dumps(run_json(trace, metrics))
        assert not {"\x1b", "\u202e"} & set(run_tables({"run": trace}, {"run": metrics})[0].to_text())
