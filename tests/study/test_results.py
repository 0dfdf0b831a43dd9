from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from moc_opt.study.results import Results
from moc_opt.study.statistics import mean, relative_changes


def row(trial: str, controller: str, mu: float, **more: Any) -> dict[str, Any]:
    return {"trial": trial, "controller": controller, "whole": True, "error": None, "mu_mean": mu, **more}


ROWS = [
    row("a", "dcac", 1.0), row("b", "dcac", 2.0), row("c", "dcac", 9.0, whole=False, error="stopped: far off"),
    row("b", "exact", 3.0), row("a", "exact", 2.0), row("c", "exact", 4.0),
    row("d", "exact", 99.0, whole=False, error="ran away"), row("e", "exact", 5.0, raised="2 ticks"),
    {"trial": "f", "controller": "rnn", "whole": False, "error": "hung"},
]  # fmt: skip


def test_means_use_only_completed_runs() -> None:
    rows = Results(ROWS)
    assert (rows.names(), rows.names("raised")) == (["dcac", "exact", "rnn"], ["2 ticks"])
    assert [one["controller"] for one in rows.where(trial="a", whole=True)] == ["dcac", "exact"]
    assert rows.mean("mu_mean", "exact") == mean([3.0, 2.0, 4.0, 5.0])
    assert rows.pairs("mu_mean", "exact") == ([3.0, 2.0], [2.0, 1.0])
    change = rows.change("mu_mean", "exact")
    assert change == relative_changes([3.0, 2.0], [2.0, 1.0])
    assert (change.ratio.value, change.ratios.value) == (pytest.approx(200 / 3), pytest.approx(75.0))
    assert rows.change("mu_mean", "dcac", "exact").ratio.value == pytest.approx(-40.0)
    assert rows.mean("mu_mean", "rnn") is rows.change("mu_mean", "rnn") is rows.change("tip", "exact") is None


def test_change_of_a_settled_metric_is_weighted_by_settled_ticks() -> None:
    both = {"a": (0.9, 1000), "b": (2.0, 10)}
    rows = Results()
    for trial, (value, ticks) in both.items():
        for name, found in (("dcac", 1.0), ("exact", value)):
            rows.add(row(trial, name, 1.0, settled_mu_mean=found, settled_ticks=ticks, travelling_ticks=7))
    change = rows.change("settled_mu_mean", "exact")
    assert change.ratio.value == pytest.approx(100 * (920 / 1010 - 1))
    assert change.ratios.value == pytest.approx(45.0)
    assert change.undecided
    assert rows.figures("exact", (), ["settled_mu_mean"])["settled_mu_change_percent_undecided"] == 1.0


def test_figures_contain_counts_means_and_gains() -> None:
    found = Results(ROWS).figures("exact", ["mu_mean", "unknown"], ["mu_mean", "unknown"])
    counts = {"trials": 5, "whole": 4, "compared": 2, "reason": "ran away", "trouble": "e, 2 ticks"}
    assert found.items() >= {**counts, "mu_mean": 3.5, "mu_gain_percent_undecided": 0.0}.items()
    assert found["mu_mean_low"] < 3.5 < found["mu_mean_high"]
    assert found["mu_gain_percent"] == pytest.approx(200 / 3)
    assert not [name for name in found if name.startswith("unknown")]
    base = Results(ROWS).figures("dcac", ["mu_mean"], ["mu_mean"])
    assert (base["mu_mean"], base["reason"], "mu_gain_percent" in base) == (1.5, "stopped: far off", False)


def test_rows_with_different_columns_are_written_to_one_file(tmp_path: Path) -> None:
    rows = Results([{"x": 1, "ok": np.bool_(True)}, {"x": np.float64(2.5), "said": "ä"}, {"x": np.inf, "ok": False}])
    rows.write(tmp_path / "rows.parquet")
    assert pl.read_parquet(tmp_path / "rows.parquet").to_dicts() == [
        {"x": 1.0, "ok": True, "said": None}, {"x": 2.5, "ok": None, "said": "ä"},
        {"x": None, "ok": False, "said": None},
    ]  # fmt: skip
