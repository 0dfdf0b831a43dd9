"""A trace: columns, immutability, its file and its forms in other libraries."""

import contextlib
import copy
import itertools
import os
import pickle
import sys

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import moc_opt as mo
from moc_opt.errors import MocOptError, TraceError
from moc_opt.report.run_table import run_tables
from moc_opt.trace.file import check_trace
from moc_opt.trace.trace import MissingDataError, Trace

N = 40


def example(rows=N):
    rng = np.random.default_rng(2)
    loss = rng.uniform(size=rows)
    loss[::3] = np.nan
    columns = {
        "t_s": 0.1 * np.arange(rows), "q_rad": rng.normal(size=(rows, 7)), "tip_m": rng.normal(size=(rows, 3)),
        "mu": rng.uniform(0.1, 0.3, rows), "rcm_error_m": rng.uniform(0, 1e-3, rows), "loss": loss,
        "verified": rng.uniform(size=rows) < 0.8, "own": rng.normal(size=(rows, 3)),
        "status": np.where(rng.uniform(size=rows) < 0.9, "solved", "infeasible"),
    }  # fmt: skip
    scenario = {"name": "spiral", "control": {"law": "moc"}, "solver": {"name": "osqp"}}
    return Trace(columns, {"ended": "completed", "period_s": 0.1, "robot": "lwr4", "scenario": scenario})


@pytest.fixture(scope="module")
def trace():
    return example()


def assert_same(one, other):
    assert list(one.columns) == list(other.columns)
    for name, array in one.columns.items():
        again = other.columns[name]
        assert (again.dtype, again.shape, again.tobytes()) == (array.dtype, array.shape, array.tobytes()), name
    # `repr` tells 1.0 from 1, and -0.0 from 0.0.
    assert repr(one.meta) == repr(other.meta)


@st.composite
def traces(draw):
    """Draw a trace with unknown columns whose floats have any bit pattern."""
    rows, columns = draw(st.integers(0, 6)), {}
    for i in range(draw(st.integers(0, 4))):
        dtype = np.dtype(draw(st.sampled_from(["f8", "f4", "i8", "i1", "u2", "?", "U5"])))
        width = 0 if dtype.kind == "U" else draw(st.integers(0, 3))
        bits = np.dtype(f"u{dtype.itemsize}") if dtype.kind == "f" else dtype
        columns[f"c{i}"] = draw(arrays(bits, (rows, width) if width else rows)).view(dtype)
    finite = st.floats(allow_nan=False, allow_infinity=False)
    json = st.recursive(
        st.none() | st.booleans() | st.integers() | finite | st.text(),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3), max_leaves=6,
    )
    return Trace(columns, draw(st.dictionaries(st.text(), json, max_size=3)))


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(traces())
def test_file_pickle_and_copy_give_back_every_bit(tmp_path, trace):
    trace.save(tmp_path / "trace.parquet")
    for again in (Trace.load(tmp_path / "trace.parquet"), pickle.loads(pickle.dumps(trace)), copy.deepcopy(trace)):
        assert_same(trace, again)


def test_columns_are_attributes_and_length_is_ticks(trace):
    assert repr(trace).startswith("Trace(40 ticks, 4.000 s, spiral, lwr4, osqp, completed: t_s, q_rad")
    assert "3 answers replaced (a)" in repr(trace.with_meta(faults={"a": {"count": 3, "first_at_s": 0.1, "first": ""}}))
    assert trace.q_rad is trace.columns["q_rad"]
    assert (len(trace), len(trace.head(0)), len(Trace({}))) == (N, 0, 0)
    assert Trace({"text": np.array(["a", "bc"], dtype=object)}).text.dtype == "<U2"
    assert not any(map(hasattr, (object.__new__(Trace), trace), ("meta", "limited")))  # slot not set, no such column
    assert {"q_rad", "own", "between", "plot"} <= set(dir(trace))
    with pytest.raises(MissingDataError, match=r"no column 'q_rads'; it has q_rad"):
        _ = trace.q_rads


def test_trace_owns_its_arrays():
    mu, deep, view = np.ones(4, dtype=">f8"), {"a": [1]}, np.ones(4)
    locked = view[:]
    locked.setflags(write=False)  # its base is writable
    made = Trace({"mu": mu, "own": locked}, {"deep": deep})
    mu[0] = view[0] = 7.0
    deep["a"].append(2)
    assert made.mu.tolist() == made.own.tolist() == [1.0] * 4
    assert made.mu.dtype == np.dtype("f8")  # this machine's byte order
    assert made.with_columns(own=[2.0] * 4).mu is made.mu
    assert made.meta["deep"] == {"a": [1]}
    with pytest.raises(ValueError, match="read-only"):
        made.mu[0] = 2.0
    with pytest.raises(AttributeError):
        made.mu = np.zeros(4)


def test_select_keeps_the_tick_numbers(trace):
    part = trace.select(trace.verified)
    np.testing.assert_array_equal(part.tick, np.flatnonzero(trace.verified))
    np.testing.assert_array_equal(part.q_rad, trace.q_rad[trace.verified])
    np.testing.assert_array_equal(part.select(np.arange(len(part)) % 2 == 1).tick, part.tick[1::2])
    first, second = trace.between(0.0, 2.0), trace.between(2.0, 99.0)
    assert [*first.tick, *second.tick] == list(range(N))
    assert first.t_s[-1] < 2.0 <= second.t_s[0]
    with pytest.raises(TraceError, match=f"give {N} flags"):
        trace.select(np.arange(N))


def test_part_of_a_run_is_marked_as_part(trace):
    whole = trace.with_meta(ticks=N, ticks_planned=N)
    assert mo.summarize(whole)["completed"] == 1.0
    for part in (whole.between(1.0, 2.0), whole.head(10), whole.select(np.arange(N) < 10)):
        found = mo.summarize(part)
        assert ("completed" in found, found["share_of_run"]) == (False, 0.25)
        assert part.meta["run_ended"] == "completed"
    part = whole.between(1.0, 2.0).head(3)
    assert part.meta["ended"] == "part: 1.000 to 1.200 s of a run, which ended: completed"
    assert run_tables({"x": part}, {"x": mo.summarize(part)})[0].title == "x (a part)"
    assert whole.head(N).meta["ended"] == whole.head(N + 5).meta["ended"] == "completed"
    untimed = trace.with_columns(t_s=np.full(N, np.nan)).head(10)
    assert untimed.meta["ended"] == "part: 10 ticks of a run, which ended: completed"


@pytest.mark.parametrize(("name", "value"), [
    ("mu", np.zeros((N, 2))), ("tip_m", np.zeros((N, 2))), ("q_rad", np.zeros(N)), ("verified", np.zeros(N)),
    ("status", np.zeros(N, dtype=np.int8)), ("mu", np.full(N, "0.3")), ("other", np.zeros((N, 2, 2))),
    ("other", np.zeros((N, 0))), ("other", 3.0), ("other", np.zeros(N, dtype=complex)),
    ("other", np.zeros(N, dtype=np.float16)), ("other", np.zeros(N, dtype="M8[s]")), ("other", [None] * N),
    ("other", [[1.0], [1.0, 2.0]]), ("not a name", np.zeros(N)), ("save", np.zeros(N)), ("_private", np.zeros(N)),
])  # fmt: skip
def test_error_names_the_unusable_column(name, value):
    with pytest.raises(TraceError, match=f"column {name!r}"):
        Trace({name: value})


@pytest.mark.parametrize(("call", "named"), [
    (lambda t: t.between(None, None), "start_s = None"), (lambda t: t.between(0.0, True), "stop_s = True"),
    (lambda t: t.between(0.0, 10**400), "stop_s = 1000"), (lambda t: t.with_columns(mu=[0.0]), "'mu' has 1 rows"),
    (lambda t: t.between(7.0, 8.0), "from 0 to 3.9 s"), (lambda t: Trace({"mu": [1.0]}).between(0, 1), "column 't_s'"),
    (lambda t: t.head(-1), "ticks = -1"), (lambda t: t.head(1.5), "ticks = 1.5"),
    (lambda t: t.head(True), "ticks = True"), (lambda t: t.plot([]), r"columns = \[\]"),
    (lambda t: t.plot(["status"]), "column 'status'"), (lambda t: t.plot(["mue"]), "column 'mue' .* such as mu"),
    (lambda t: t.plot("mu"), "columns = 'mu'"), (lambda t: t.plot(beside="a.parquet"), "beside = 'a.parquet'"),
    (lambda t: mo.summarize("a.parquet"), "trace is 'a.parquet'"), (lambda t: mo.summarize(t, 3), "baseline is 3"),
    (lambda t: mo.summarize(t, t.head(20)), "20 ticks from 0.000 to 1.900 s, but the trace has 40 ticks from 0.000"),
    (lambda t: mo.summarize(t, t.with_columns(t_s=t.t_s + 0.1)), "from 0.100 to 4.000 s, but"),
])  # fmt: skip
def test_error_names_the_wrong_argument(trace, call, named):
    with pytest.raises(MocOptError, match=named):
        call(trace)


def test_open_file_can_be_replaced(tmp_path):
    path = tmp_path / "t.parquet"
    example().save(path)
    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(path)
    assert table.schema.field("q_rad").type.list_size == 7
    assert str(table.schema.field("verified").type) == "bool"
    assert b'"osqp"' in parquet.read_metadata(path).metadata[b"moc_opt.meta"]
    assert table.column("status").to_pylist() == example().status.tolist()
    with path.open("rb") as reader:
        example(3).save(str(path))
        assert (len(pl.read_parquet(reader)), len(Trace.load(str(path)))) == (N, 3)
    assert os.listdir(tmp_path) == ["t.parquet"]


def test_file_that_is_no_trace_is_refused(tmp_path):
    foreign, versioned = tmp_path / "foreign.parquet", tmp_path / "versioned.parquet"
    pl.DataFrame({"mu": [0.1, None]}).write_parquet(foreign)
    pl.DataFrame({"mu": [0.1]}).write_parquet(versioned, metadata={"moc_opt.trace.trace": "99"})
    (tmp_path / "text.parquet").write_text("t_s,mu\n0.0,0.3\n")
    (tmp_path / "s.toml").write_text("seed = 1\n")
    for name, said in {
        "gone.parquet": "no such file", "text.parquet": "no trace", "": "no regular file", "s.toml": "is a scenario",
        "foreign.parquet": "no trace", "versioned.parquet": "format '99'",
    }.items():  # fmt: skip
        with pytest.raises(TraceError, match=said):
            Trace.load(tmp_path / name)


def test_no_file_is_replaced_except_an_empty_one_or_a_trace_of_the_same_kind(tmp_path):
    files = gone, empty, run, plan, foreign, text = [tmp_path / f"{k}.parquet" for k in range(6)]
    empty.touch()
    example(3).save(run)
    example(3).with_meta(kind="plan").save(plan)
    pl.DataFrame({"mu": [0.1]}).write_parquet(foreign, metadata={"moc_opt.meta": "{}"})
    text.write_text("t_s,mu")
    for kind, path in itertools.product(("run", "plan"), files):
        allowed = path in (gone, empty, run if kind == "run" else plan)
        with contextlib.nullcontext() if allowed else pytest.raises(TraceError, match=f"holds no {kind}"):
            check_trace(path, kind)


WARNING = {"of": "the RCM error", "unit": "m", "level": 6e-3, "first_s": 0.1, "largest": 8e-3}


@pytest.mark.parametrize(("name", "sound", "wrong"), [
    ("period_s", 1, "0.002"), ("ticks", 3, True), ("best_courses", {"end": None}, {"absent": 3}),
    ("warnings", [WARNING], [{**WARNING, "level": None}]),
    ("scenario", {"robot": {"name": "lwr4", "tool_length_m": None}, "seed": 1}, {"robot": ["lwr4"]}),
])  # fmt: skip
def test_error_names_the_meta_entry_of_wrong_type(name, sound, wrong):
    Trace({"mu": np.ones(2)}, {name: sound, "my_own": [{"a": None}]})
    for give in (lambda meta: Trace({}, meta), lambda meta: Trace({}).with_meta(**meta)):
        with pytest.raises(TraceError, match=name):
            give({name: wrong})


def test_meta_is_converted_to_json_types():
    assert Trace({}, {"a": (1, 2), "b": {3: "x"}}).meta == {"a": [1, 2], "b": {"3": "x"}}
    for value in (np.nan, np.inf, {1, 2}, np.zeros(2), {"deep": [np.nan]}):
        with pytest.raises(TraceError, match=r"meta\['seed'\]"):
            Trace({}, {"seed": value})
    with pytest.raises(TraceError, match="not a text"):
        Trace({}, {1: "a"})


def test_pandas_table_has_every_number(trace, monkeypatch):
    frame = trace.to_pandas()
    assert (frame.index.name, frame.shape) == ("t_s", (N, 7 + 3 + 3 + 5))
    assert np.array_equal(frame.index, trace.t_s)
    assert np.array_equal(frame[["tip_m_x", "tip_m_y", "tip_m_z"]], trace.tip_m)
    assert np.array_equal(frame[[f"q_rad_{joint}" for joint in range(7)]], trace.q_rad)
    assert np.array_equal(frame["own_2"], trace.own[:, 2])
    assert list(frame["status"]) == list(trace.status)
    assert frame.attrs["ended"] == "completed"
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(TraceError, match=r"pandas is not installed: pip install '.\[dataframes\]'"):
        trace.to_pandas()


def test_xarray_dataset_has_named_dimensions_and_units(trace):
    pytest.importorskip("xarray", reason="xarray is not installed: pip install '.[dataframes]'")
    found = trace.to_xarray()
    assert (found.q_rad.dims, found.tip_m.dims) == (("t_s", "joint"), ("t_s", "axis"))
    assert found.q_rad.attrs["units"] == "rad"
    assert np.array_equal(found.t_s, trace.t_s)
    assert np.array_equal(found.tip_m.sel(axis="y"), trace.tip_m[:, 1])
    assert np.array_equal(found.own, trace.own)
    assert found.attrs["robot"] == "lwr4"


def test_plot_draws_the_requested_columns(trace):
    lines = {line.name: line for line in trace.plot(["mu"], name="osqp", beside=trace.between(0.0, 1.0)).data}
    assert set(lines) == {"baseline", "osqp"}
    assert np.allclose(lines["osqp"].y, trace.mu)
    assert len(lines["baseline"].x) == 10
    assert {line.name for line in trace.plot().data} == {"osqp"}
