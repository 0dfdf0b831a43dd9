"""A trace as pandas, xarray and plotly have it: the same numbers under names that say what they are."""

import sys

import numpy as np
import pytest

import moc_opt as mo
from moc_opt.errors import MocOptError, TraceError
from moc_opt.report.run_table import run_table
from moc_opt.trace.trace import Trace

ROWS = 40


@pytest.fixture
def trace():
    rng = np.random.default_rng(5)
    columns = {
        "t_s": 0.1 * np.arange(ROWS), "q_rad": rng.normal(size=(ROWS, 7)), "tip_m": rng.normal(size=(ROWS, 3)),
        "mu": rng.uniform(0.1, 0.3, ROWS), "rcm_error_m": rng.uniform(0, 1e-3, ROWS),
        "status": np.array(["solved"] * ROWS), "own": rng.normal(size=(ROWS, 3)),
    }  # fmt: skip
    scenario = {"name": "spiral", "control": {"law": "moc"}, "solver": {"name": "osqp"}}
    return Trace(columns, {"ended": "completed", "period_s": 0.1, "robot": "lwr4", "scenario": scenario})


def test_pandas_has_every_number_of_every_column(trace):
    frame = trace.to_pandas()
    assert frame.index.name == "t_s"
    assert frame.shape == (ROWS, 7 + 3 + 1 + 1 + 1 + 3)
    assert np.array_equal(frame.index, trace.t_s)
    for axis, name in enumerate("xyz"):
        assert np.array_equal(frame[f"tip_m_{name}"], trace.tip_m[:, axis])
    for joint in range(7):
        assert np.array_equal(frame[f"q_rad_{joint}"], trace.q_rad[:, joint])
    assert np.array_equal(frame["own_2"], trace.own[:, 2])
    assert set(frame["status"]) == {"solved"}
    assert frame.attrs["ended"] == "completed"


def test_xarray_names_the_dimensions_and_units(trace):
    pytest.importorskip("xarray", reason="xarray is not installed: pip install 'moc-opt[dataframes]'")
    found = trace.to_xarray()
    assert found.q_rad.dims == ("t_s", "joint")
    assert found.tip_m.dims == ("t_s", "axis")
    assert found.q_rad.attrs["units"] == "rad"
    assert list(found.axis.values) == ["x", "y", "z"]
    assert np.array_equal(found.tip_m.sel(axis="y"), trace.tip_m[:, 1])
    assert np.array_equal(found.own, trace.own)
    assert found.attrs["robot"] == "lwr4"


@pytest.mark.parametrize(("package", "method"), [("pandas", "to_pandas"), ("xarray", "to_xarray")])
def test_without_the_package_the_extra_is_named(trace, monkeypatch, package, method):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(TraceError, match=rf"{package} is not installed: pip install 'moc-opt\[dataframes\]'"):
        getattr(trace, method)()


def test_plot_draws_the_columns_asked_for_and_a_baseline(trace):
    figure = trace.plot(["mu"], name="osqp", beside=trace.between(0.0, 1.0))
    lines = {line.name: line for line in figure.data}
    assert set(lines) == {"baseline", "osqp"}
    assert np.allclose(lines["osqp"].y, trace.mu)
    assert len(lines["baseline"].x) == 10
    assert {line.name for line in trace.plot().data} == {"run"}


def test_pieces_that_meet_make_the_whole(trace):
    first, second = trace.between(0.0, 2.0), trace.between(2.0, 99.0)
    assert len(first) + len(second) == len(trace)
    assert np.array_equal(np.concatenate([first.tick, second.tick]), np.arange(ROWS))
    assert first.t_s[-1] < 2.0 <= second.t_s[0]
    assert {**first.meta, "ended": trace.meta["ended"]} == {**trace.meta, "run_ended": "completed"}


def test_a_part_of_a_run_says_so(trace):
    whole = trace.with_meta(ticks=ROWS, ticks_planned=ROWS)
    assert mo.summarize(whole)["completed"] == 1.0
    for part in (whole.between(1.0, 2.0), whole.head(10), whole.select(np.arange(ROWS) < 10)):
        assert "completed" not in mo.summarize(part)  # nor is it said that it was not
        assert mo.summarize(part)["share_of_run"] == 0.25
        assert part.meta["run_ended"] == "completed"
    part = whole.between(1.0, 2.0).head(3)  # a part of a part
    assert part.meta["ended"] == "part: 1.000 to 1.200 s of a run, which ended: completed"
    assert "part: 1.000 to 1.200 s" in repr(part)
    assert run_table("x", part, mo.summarize(part)).title == "x (a part)"
    for all_of_it in (whole.between(0.0, np.inf), whole.head(ROWS), whole.select(np.ones(ROWS, dtype=bool))):
        assert dict(all_of_it.meta) == dict(whole.meta)


@pytest.mark.parametrize("where", [slice(None), 0, 9])
def test_a_part_whose_times_are_no_numbers_is_told_by_its_ticks(trace, where):
    t = trace.t_s.copy()
    t[where] = np.nan
    part = trace.with_columns(t_s=t).head(10)
    assert part.meta["ended"] == "part: 10 ticks of a run, which ended: completed"


@pytest.mark.parametrize(("call", "named"), [
    (lambda t: t.between(None, None), "start_s = None"), (lambda t: t.between(0.0, "1"), "stop_s = '1'"),
    (lambda t: t.between(0.0, True), "stop_s = True"), (lambda t: t.head(None), "ticks = None"),
    (lambda t: t.head(-1), "ticks = -1"), (lambda t: t.head(1.5), "ticks = 1.5"),
    (lambda t: t.plot([]), r"columns = \[\]"), (lambda t: t.plot("mu"), "columns = 'mu'"),
    (lambda t: t.plot(7), "columns = 7"), (lambda t: t.plot(["status"]), "column 'status'"),
    (lambda t: t.plot(["mu", "mue"]), "column 'mue' .* such as mu"), (lambda t: t.plot([None]), "column None"),
    (lambda t: t.plot(beside="a.parquet"), "beside = 'a.parquet'"),
    (lambda t: mo.summarize("a.parquet"), "trace is 'a.parquet'"), (lambda t: mo.summarize(None), "trace is None"),
    (lambda t: mo.summarize(t, 3), "baseline is 3"), (lambda t: t.between(7.0, 8.0), "from 0 to 3.9 s"),
    (lambda t: Trace({"mu": [1.0]}).between(0, 1), "no column 't_s'"),
])  # fmt: skip
def test_a_wrong_argument_is_named(trace, call, named):
    with pytest.raises(MocOptError, match=named):
        call(trace)


def test_a_baseline_of_another_time_is_refused(trace):
    for baseline, words in (
        (trace.head(20), "20 ticks from 0.000 to 1.900 s where the trace has 40 ticks from 0.000 to 3.900 s"),
        (trace.with_columns(t_s=trace.t_s + 0.1), "from 0.100 to 4.000 s where"),
    ):
        with pytest.raises(TraceError, match=words):
            mo.summarize(trace, baseline)
    assert "mu_gain_percent" in mo.summarize(trace.between(1.0, 2.0), trace.between(1.0, 2.0))


def test_repr_says_what_run_it_is(trace):
    assert repr(trace).startswith("Trace(40 ticks, 4.000 s, spiral, lwr4, osqp, completed: t_s, q_rad")
    html = trace.with_meta(ended="stopped: <b>off</b>")._repr_html_()
    assert "osqp" in html
    assert "mu [m^3]" in html
    assert "&lt;b&gt;off" in html
    assert "<b>off" not in html


def test_columns_are_completed(trace):
    assert {"q_rad", "own", "between", "plot"} <= set(dir(trace))
