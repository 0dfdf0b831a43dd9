"""A trace: what it accepts, that it is frozen, and that its file gives back every bit."""

from __future__ import annotations

import copy
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays, from_dtype

from moc_opt.errors import TraceError
from moc_opt.trace.trace import MissingDataError, Trace

N = 50


def example(rows: int = N) -> Trace:
    """A trace with columns of every type."""
    rng = np.random.default_rng(2)
    loss = rng.uniform(size=rows)
    loss[::3] = np.nan
    columns = {
        "t_s": 0.002 * np.arange(rows), "q_rad": rng.normal(size=(rows, 7)),
        "trocar_force_N": rng.normal(size=(rows, 3)), "verified": rng.uniform(size=rows) < 0.8, "loss": loss,
        "status": np.where(rng.uniform(size=rows) < 0.9, "solved", "infeasible"),
    }  # fmt: skip
    return Trace(columns, {"solver": "osqp", "seed": 3, "config": {"rho": 1e-5, "gains": [1, 2]}})


def assert_same(one: Trace, other: Trace) -> None:
    """Same names in the same order, same types, shapes and bits."""
    assert list(one.columns) == list(other.columns)
    for name, array in one.columns.items():
        again = other.columns[name]
        assert (again.dtype, again.shape) == (array.dtype, array.shape), name
        assert again.tobytes() == array.tobytes(), name
    assert dict(one.meta) == dict(other.meta)


dtypes = st.sampled_from(["f8", "f4", "i8", "i1", "u2", "?", "U5"])


@st.composite
def traces(draw: st.DrawFn) -> Trace:
    """Any trace with columns unknown to the package, every bit pattern of a float included."""
    rows = draw(st.integers(0, 6))
    columns: dict[str, Any] = {}
    for i in range(draw(st.integers(0, 4))):
        dtype = np.dtype(draw(dtypes))
        width = 0 if dtype.kind == "U" else draw(st.integers(0, 3))
        shape = (rows, width) if width else (rows,)
        if dtype.kind == "f":
            bits = np.dtype(f"u{dtype.itemsize}")
            columns[f"c{i}"] = draw(arrays(bits, shape)).view(dtype)
        elif dtype.kind == "U":
            text = st.text(st.characters(exclude_categories=["Cs"]), max_size=5)
            columns[f"c{i}"] = np.array(draw(st.lists(text, min_size=rows, max_size=rows)), dtype=dtype)
        else:
            columns[f"c{i}"] = draw(arrays(dtype, shape, elements=from_dtype(dtype)))
    finite = st.floats(allow_nan=False, allow_infinity=False)
    json = st.recursive(
        st.none() | st.booleans() | st.integers() | finite | st.text(),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
        max_leaves=6,
    )
    return Trace(columns, draw(st.dictionaries(st.text(), json, max_size=3)))


@settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(traces())
def test_file_gives_back_every_bit(tmp_path: Path, trace: Trace) -> None:
    trace.save(tmp_path / "trace.parquet")
    again = Trace.load(tmp_path / "trace.parquet")
    assert_same(trace, again)
    # Python calls 1.0 and 1, or -0.0 and 0.0, equal; the types and signs must survive too.
    assert repr(again.meta) == repr(trace.meta)


def test_columns_are_attributes_and_length_is_ticks() -> None:
    trace = example()
    assert trace.q_rad is trace.columns["q_rad"]
    assert len(trace) == N
    assert len(Trace({})) == 0
    assert "50 ticks" in repr(trace)


def test_absent_column_is_an_attribute_error_with_the_nearest_names() -> None:
    trace = example()
    with pytest.raises(MissingDataError, match=r"no column 'q_rads'; it has q_rad"):
        _ = trace.q_rads
    assert issubclass(MissingDataError, TraceError)
    assert not hasattr(trace, "mu")


def test_trace_is_frozen_and_owns_its_arrays() -> None:
    mu, deep = np.ones(4), {"a": [1]}
    trace = Trace({"mu": mu}, {"deep": deep})
    mu[0] = 7.0
    deep["a"].append(2)
    assert trace.mu.tolist() == [1.0] * 4
    assert trace.meta["deep"] == {"a": [1]}
    with pytest.raises(ValueError, match="read-only"):
        trace.mu[0] = 2.0
    with pytest.raises(AttributeError, match="frozen"):
        trace.mu = np.zeros(4)
    with pytest.raises(TypeError):
        trace.columns["mu"] = np.zeros(4)  # type: ignore[index]
    # A read-only view of a writable array can still change underneath.
    view = np.ones(4)
    locked = view[:]
    locked.setflags(write=False)
    trace = Trace({"mu": locked})
    view[0] = 5.0
    assert trace.mu[0] == 1.0


def test_with_columns_adds_and_replaces() -> None:
    trace = example()
    more = trace.with_columns(mu=np.full(N, 0.3), loss=np.zeros(N))
    assert more.mu.tolist() == [0.3] * N
    assert more.loss.max() == 0.0
    assert np.isnan(trace.loss).any()
    assert "mu" not in trace.columns
    # Nothing is copied that need not be.
    assert more.q_rad is trace.q_rad
    assert dict(more.meta) == dict(trace.meta)
    with pytest.raises(TraceError, match="'mu' has 3 rows where 't_s' has 50"):
        trace.with_columns(mu=np.zeros(3))


def test_select_keeps_the_numbers_of_the_ticks() -> None:
    trace = example()
    part = trace.select(trace.verified)
    np.testing.assert_array_equal(part.tick, np.flatnonzero(trace.verified))
    np.testing.assert_array_equal(part.q_rad, trace.q_rad[trace.verified])
    again = part.select(np.arange(len(part)) % 2 == 1)
    np.testing.assert_array_equal(again.tick, part.tick[1::2])
    with pytest.raises(TraceError, match="give 50 flags"):
        trace.select(np.arange(N))


def test_pickle_and_copy_keep_everything() -> None:
    trace = example()
    assert_same(trace, pickle.loads(pickle.dumps(trace)))
    assert_same(trace, copy.deepcopy(trace))


@pytest.mark.parametrize(("name", "value"), [
    ("mu", np.zeros((N, 2))), ("tip_m", np.zeros((N, 2))), ("q_rad", np.zeros(N)), ("verified", np.zeros(N)),
    ("status", np.zeros(N, dtype=np.int8)), ("mu", np.full(N, "0.3")), ("other", np.zeros((N, 2, 2))),
    ("other", np.zeros((N, 0))), ("other", 3.0), ("other", np.zeros(N, dtype=complex)),
    ("other", np.zeros(N, dtype=np.float16)), ("other", np.zeros(N, dtype="M8[s]")), ("other", [None] * N),
    ("other", [[1.0], [1.0, 2.0]]), ("not a name", np.zeros(N)), ("save", np.zeros(N)), ("_private", np.zeros(N)),
])  # fmt: skip
def test_unusable_columns_are_named(name: str, value: Any) -> None:
    with pytest.raises(TraceError, match=f"column {name!r}"):
        Trace({name: value})


@pytest.mark.parametrize("value", [np.nan, np.inf, {1, 2}, np.zeros(2), {"deep": [np.nan]}])
def test_meta_must_be_json(value: Any) -> None:
    with pytest.raises(TraceError, match=r"meta\['seed'\] cannot be written as JSON"):
        Trace({}, {"seed": value})


def test_meta_is_kept_as_json_gives_it_back() -> None:
    assert Trace({}, {"a": (1, 2), "b": {3: "x"}}).meta == {"a": [1, 2], "b": {"3": "x"}}
    with pytest.raises(TraceError, match="not a text"):
        Trace({}, {1: "a"})  # type: ignore[dict-item]


def test_file_is_readable_by_others(tmp_path: Path) -> None:
    """Here by pyarrow, and so by pandas."""
    example().save(tmp_path / "t.parquet")
    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(tmp_path / "t.parquet")
    assert table.schema.field("q_rad").type.list_size == 7
    assert str(table.schema.field("verified").type) == "bool"
    assert b'"osqp"' in parquet.read_metadata(tmp_path / "t.parquet").metadata[b"moc_opt.meta"]
    assert table.column("loss").null_count == 0
    assert table.column("status").to_pylist() == example().status.tolist()


def test_byte_order_of_another_machine_is_turned() -> None:
    trace = Trace({"mu": np.array([0.1, 0.2], dtype=">f8")})
    assert trace.mu.dtype == np.dtype("f8")
    assert trace.mu.tolist() == [0.1, 0.2]


def test_failed_save_leaves_the_old_file_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "t.parquet"
    example().save(path)
    before = path.read_bytes()

    def full(handle: int) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(TraceError, match="no space left"):
        example(3).save(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["t.parquet"]


def test_save_replaces_and_keeps_no_partial_file(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    example().save(path)
    # Who has the old file open keeps the old file: it is replaced, never written over.
    with path.open("rb") as reader:
        example(3).save(str(path))
        assert len(pl.read_parquet(reader)) == N
    assert len(Trace.load(str(path))) == 3
    assert os.listdir(tmp_path) == ["t.parquet"]


def test_damaged_files_are_told_from_good_ones(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    example(2000).save(path)
    good = path.read_bytes()
    for length in (0, 3, len(good) // 2, len(good) - 1):
        path.write_bytes(good[:length])
        with pytest.raises(TraceError, match=r"t\.parquet.*is damaged .* run the scenario again"):
            Trace.load(path)


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    with pytest.raises(TraceError, match=r"trace .*t.parquet.: no such file; check the path"):
        Trace.load(path)
    path.write_text("t_s,mu\n0.0,0.3\n")
    with pytest.raises(TraceError, match="no trace"):
        Trace.load(path)
    with pytest.raises(TraceError, match="no regular file"):
        Trace.load(tmp_path)
    foreign = pl.DataFrame({"mu": [0.1, None]})
    foreign.write_parquet(path)
    with pytest.raises(TraceError, match=r"a Parquet file, but no trace: give a file written by Trace\.save"):
        Trace.load(path)
    foreign.write_parquet(path, metadata={"moc_opt.trace.trace": "99"})
    with pytest.raises(TraceError, match="format '99'"):
        Trace.load(path)
    (tmp_path / "s.toml").write_text("seed = 1\n")
    with pytest.raises(TraceError, match=r"is a scenario, no trace: run it first: moc-opt run .* --trace"):
        Trace.load(tmp_path / "s.toml")


@pytest.mark.parametrize("name", ["t.csv", "t.JSON", "a.b.npz", "absent/t.parquet"])
def test_a_name_of_another_format_or_in_no_folder_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(TraceError):
        example().save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_every_documented_column_says_its_unit_and_shape() -> None:
    units = {"_m": "m", "_s": "s", "_us": "us", "_N": "N", "_Nm": "Nm", "_rad": "rad", "_rad_per_s": "rad/s"}
    for name, column in Trace.COLUMNS.items():
        assert column.shape in ("(N,)", "(N, 3)", "(N, n)", "(N, k)"), name
        assert column.meaning, name
        # The unit stands in the name where there is one.
        suffix = max((end for end in units if name.endswith(end)), key=len, default=None)
        if suffix is not None:
            assert column.unit == units[suffix], name
