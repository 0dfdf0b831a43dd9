"""Figures draw the values that they are given."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from moc_opt import figures
from moc_opt.errors import ReportError

RNG = np.random.default_rng(5)


def run(ticks: int, **columns: object) -> dict[str, object]:
    t = 0.002 * np.arange(ticks)
    return {
        "t_s": t, "mu": 0.3 + 0.01 * np.sin(t), "tip_error_m": 1e-4 * RNG.random(ticks),
        "rcm_error_m": 1e-3 * RNG.random(ticks), "trocar_force_N": RNG.normal(size=(ticks, 3)), **columns,
    }  # fmt: skip


def test_markup_in_names_is_escaped() -> None:
    name = '<a href="x">bad</a>'
    made = [
        figures.latency_ecdf({name: [1.0, 2.0]}), figures.box_plots({name: {name: [1.0, 2.0]}}, "y"),
        figures.accuracy_against_time({name: (1.0, 1.0)}), figures.time_series({name: run(9)}),
    ]  # fmt: skip
    for figure in made:
        shown = [trace.name for trace in figure.data if trace.name] + list(figure.layout.yaxis.ticktext or ())
        shown += [text for trace in figure.data if trace.type == "box" for text in trace.x]
        assert any("&lt;a" in text for text in shown)
        assert not any("<a" in text for text in shown)


@settings(max_examples=25)
@given(arrays(np.float64, st.integers(1, 60), elements=st.floats(0.5, 1e4)))
def test_an_ecdf_of_few_samples_is_exact(times: np.ndarray) -> None:
    (line,) = figures.latency_ecdf({"a": times}).data
    for x, y in zip(line.x, line.y, strict=True):
        below = np.count_nonzero(times < x) / len(times)
        assert below < y <= np.count_nonzero(times <= x) / len(times) + 1e-12
    assert (line.x[-1], line.y[-1]) == (times.max(), 1.0)


def test_points_of_a_long_ecdf_are_exact() -> None:
    times = RNG.lognormal(3, 1, 50_000)
    (line,) = figures.latency_ecdf({"a": times}).data
    assert len(line.x) < 900
    assert np.max(np.abs(line.y - [np.mean(times <= x) for x in line.x])) < 1e-12
    assert set(np.sort(times)[-20:]) <= set(line.x), "the 20 slowest times are kept"


def test_box_has_tukeys_whiskers() -> None:
    values = [*range(1, 12), 100.0, math.nan]
    made = figures.box_plots({"DCAC": {"line": [], "circle": values}, "MOC": {"line": [2.0]}}, "error [mm]")
    box = made.data[0]
    known = np.array(values[:-1], dtype=float)
    assert (box.q1[0], box.median[0], box.q3[0]) == tuple(np.percentile(known, (25, 50, 75)))
    assert (box.lowerfence[0], box.upperfence[0]) == (1.0, 11.0)
    assert list(box.y[0]) == [100.0]
    assert list(made.layout.xaxis.categoryarray) == ["line", "circle"]
    assert [list(box.x) for box in made.data] == [["circle"], ["line"]]


@settings(max_examples=50)
@given(st.dictionaries(
    st.text("ab", min_size=1), st.tuples(st.floats(0.1, 1e3), st.floats(1e-9, 1.0)), min_size=1, max_size=9
))  # fmt: skip
def test_no_point_dominates_the_pareto_front(points: dict[str, tuple[float, float]]) -> None:
    front = set(figures.pareto(points))
    assert {points[name] for name in front} == {
        p for p in points.values()
        if not any(t <= p[0] and e <= p[1] and (t, e) != p for t, e in points.values())
    }  # fmt: skip
    assert len({points[name] for name in front}) == len(front)


@settings(max_examples=50)
@given(arrays(np.float64, st.integers(1, 400), elements=st.floats(-1e6, 1e6) | st.just(math.nan)), st.integers(4, 60))
def test_an_envelope_loses_no_peak(y: np.ndarray, points: int) -> None:
    t = np.arange(len(y), dtype=float)
    kept_t, kept_y = figures.envelope(t, y, points)
    assert np.all(np.diff(kept_t) > 0)
    np.testing.assert_array_equal(y[kept_t.astype(int)], kept_y)
    assert (kept_t[0], kept_t[-1]) == (0, len(y) - 1)
    if not np.isnan(y).all():
        assert (np.nanmax(kept_y), np.nanmin(kept_y)) == (np.nanmax(y), np.nanmin(y))
    assert np.isnan(kept_y).any() == np.isnan(y).any()
    if not np.isnan(y).any():
        assert len(kept_t) <= points or len(y) <= points


@pytest.mark.parametrize(("build", "word"), [
    (lambda: figures.latency_ecdf({"x": [math.nan]}), "needs values"),
    (lambda: figures.latency_ecdf({"x": [-1.0]}), "negative"),
    (lambda: figures.box_plots({"x": {"t": [math.inf]}}, "y"), "x, t"),
    (lambda: figures.box_plots({"x": {"t": [0.0]}}, "y"), "x, t"),
    (lambda: figures.accuracy_against_time({"x": (0.0, 1.0)}), "'x'"), (lambda: figures.time_series({}), "mu"),
    (lambda: figures.time_series({"x": {"mu": np.ones(2)}}), "no column t_s"),
    (lambda: figures.time_series({"x": run(3)}, ["mus"]), "is in no run"),
    (lambda: figures.time_series({"x": run(3, status=np.array(["a"] * 3))}, ["status"]), "holds texts"),
    (lambda: figures.time_series({"x": run(3)}, []), "list of names"),
    (lambda: figures.envelope([1.0], [1.0, 2.0]), "shape"), (lambda: figures.envelope([1.0], [1.0], 3), "points = 3"),
])  # fmt: skip
def test_unusable_data_are_refused(build: object, word: str) -> None:
    with pytest.raises(ReportError, match=word):
        build()  # type: ignore[operator]
