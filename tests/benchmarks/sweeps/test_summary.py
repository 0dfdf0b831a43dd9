"""The summary of a sweep: right, to a stated accuracy, in constant memory."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.maintenance.sweep_memory import write_synthetic
from benchmarks.sweeps import summary
from benchmarks.sweeps.errors import StoreError, SweepError
from benchmarks.sweeps.plan import Plan
from benchmarks.sweeps.summary import ACCURACY, bucket, quantile, summarise
from moc_opt.errors import UnknownNameError
from tests.sweeps import config, do, made_up


@given(
    st.lists(
        st.floats(-1e8, 1e8, allow_subnormal=False).filter(lambda v: v == 0 or abs(v) > 1e-12), min_size=1
    ),
    st.sampled_from([0.0, 0.05, 0.5, 0.95, 1.0]),
)
def test_quantiles_are_within_their_accuracy(values: list[float], p: float) -> None:
    histogram = np.bincount(bucket(np.array(values)), minlength=summary.BUCKETS).astype(np.int32)
    exact = np.quantile(values, p, method="lower")
    assert quantile(histogram, p) == pytest.approx(exact, rel=ACCURACY * 1.001, abs=0.0)


@pytest.fixture
def finished(tmp_path: Path) -> Iterator[Path]:
    """12 runs, done."""
    do(Plan(config()), tmp_path)
    return tmp_path


def test_the_summary_is_that_of_the_rows(finished: Path) -> None:
    rows = pq.read_table(finished / "rows.parquet").to_pylist()
    found = summarise(finished, ["solver", "plant.mass_error"])
    assert list(found) == ["exact, 0.0", "exact, 0.1"]
    for mass_error in (0.0, 0.1):
        mine = [row for row in rows if row["plant.mass_error"] == mass_error]
        values = [row["mu_mean"] for row in mine if row["mu_mean"] is not None]
        group = found[f"exact, {mass_error}"]
        assert (group["runs"], group["failed"]) == (6, 6 - len(values))
        assert group["mu_mean"]["count"] == len(values)
        assert group["mu_mean"]["mean"] == pytest.approx(np.mean(values))
        assert (group["mu_mean"]["min"], group["mu_mean"]["max"]) == (min(values), max(values))
        assert group["mu_mean"]["p50"] == pytest.approx(np.quantile(values, 0.5, method="lower"), rel=0.011)
        assert "loss_max" not in group
    assert summarise(finished, ["seed"])["0"]["runs"] == 6


def test_stopped_runs_are_counted_and_enter_no_mean(tmp_path: Path) -> None:
    """Of three runs one is stopped and one oscillates: the mean is that of the two that are whole."""
    plan = Plan(config(grid={"control.regularization": [1e-6, 1e-5, 1e-4]}, seeds=1))
    endings = ["completed", "oscillated: joint_7", "stopped: the tip", None]

    def work(table: Any, limit_s: float) -> dict[str, Any]:
        place = [1e-6, 1e-5, 1e-4].index(table["control"]["regularization"])
        return {**made_up(table, limit_s), "ended": endings[place], "figures": {"mu_mean": [1.0, 2.0, 50.0][place]}}

    do(plan, tmp_path, work=work)
    assert {row["ended"] for row in pq.read_table(tmp_path / "rows.parquet").to_pylist()} == set(endings[:3])
    [group] = summarise(tmp_path).values()
    assert (group["runs"], group["failed"], group["stopped"], group["oscillated"]) == (3, 0, 1, 1)
    assert group["mu_mean"]["mean"] == 1.5
    assert group["mu_mean"]["count"] == 2
    assert group["mu_mean"]["max"] == 2.0


def test_the_summary_says_what_is_wrong(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'solver'"):
        summarise(finished, ["solvers"])
    monkeypatch.setattr(summary, "MAX_GROUPS", 5)
    with pytest.raises(SweepError, match="more than 5 groups"):
        summarise(finished, ["run"])
    with pytest.raises(StoreError, match="not finished"):
        summarise(finished / "runs")
    (finished / "rows.parquet").write_bytes(b"PAR1")
    with pytest.raises(StoreError, match="damaged"):
        summarise(finished)


def test_memory_does_not_grow_with_the_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pool, peaks, batches = pa.default_memory_pool(), [0, 0], summary._batches
    for place, rows in enumerate((100_000, 300_000)):
        write_synthetic(tmp_path, rows)
        before = pool.bytes_allocated()

        def watched(*args: Any, place: int = place, before: int = before) -> Iterator[pa.RecordBatch]:
            for batch in batches(*args):
                peaks[place] = max(peaks[place], pool.bytes_allocated() - before)
                yield batch

        monkeypatch.setattr(summary, "_batches", watched)
        assert sum(group["runs"] for group in summarise(tmp_path).values()) == rows
    assert 0 < peaks[1] < 1.5 * peaks[0]
    assert peaks[1] < 0.5 * (tmp_path / "rows.parquet").stat().st_size
