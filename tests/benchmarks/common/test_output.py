"""What every benchmark leaves behind: complete files or none, JSON that others can read, where it came from."""

import json
import os

import numpy as np
import pyarrow.parquet as pq
import pytest

from benchmarks.common import output


def test_files_appear_whole(tmp_path):
    path = tmp_path / "new" / "summary.json"
    output.write_atomically(path, b"one")
    output.write_atomically(path, b"two")
    assert path.read_bytes() == b"two"
    assert os.listdir(path.parent) == ["summary.json"]


def test_a_write_that_fails_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "summary.json"
    output.write_atomically(path, b"old")

    def broken(source, target):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", broken)
    with pytest.raises(OSError, match="disk full"):
        output.write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["summary.json"]


def test_json_knows_no_nan(tmp_path):
    path = tmp_path / "a.json"
    output.write_json(
        path, {"b": np.float64(1.5), "a": [np.nan, np.inf, (1, True)], "c": {2: np.int64(3)}, "d": None}
    )
    text = path.read_text()
    assert json.loads(text) == {"a": [None, None, [1, True]], "b": 1.5, "c": {"2": 3}, "d": None}
    assert text.index('"a"') < text.index('"b"')
    assert text.endswith("\n")


def test_rows_may_have_different_columns(tmp_path):
    path = tmp_path / "rows.parquet"
    output.write_rows(path, iter([{"part": "x", "us": 1.0}, {"part": "y", "count": 2, "us": np.nan}]))
    table = pq.read_table(path)
    assert table.column_names == ["part", "us", "count"]
    assert table.to_pylist() == [
        {"part": "x", "us": 1.0, "count": None}, {"part": "y", "us": None, "count": 2},
    ]  # fmt: skip


def test_a_column_takes_what_a_benchmark_finds(tmp_path):
    path = tmp_path / "rows.parquet"
    rows = [{"x": 1, "ok": np.bool_(True)}, {"x": 2.5}, {"x": np.float64(np.inf), "ok": False}, {"x": np.int64(4)}]
    output.write_rows(path, rows)
    assert pq.read_table(path).to_pylist() == [
        {"x": 1.0, "ok": True}, {"x": 2.5, "ok": None}, {"x": None, "ok": False}, {"x": 4.0, "ok": None},
    ]  # fmt: skip


def test_environment_says_where_numbers_come_from():
    found = output.environment({"x": 1}, 7, ["--quick"])
    assert found["seed"] == 7
    assert found["config"] == {"x": 1}
    assert found["arguments"] == ["--quick"]
    assert found["threads"] == os.environ["OMP_NUM_THREADS"]
    assert found["versions"]["numpy"] == np.__version__
    assert set(output.PACKAGES) == set(found["versions"])
    assert found["machine"]["cores"] == os.cpu_count()
    assert found["machine"]["processor"]
    output.plain(found)


def test_a_package_that_is_missing_has_no_version(monkeypatch):
    monkeypatch.setattr(output, "PACKAGES", ("numpy", "a-package-that-nobody-has"))
    assert output.environment({}, 0)["versions"] == {
        "numpy": np.__version__,
        "a-package-that-nobody-has": None,
    }


def test_commit_is_none_outside_a_checkout(tmp_path, monkeypatch):
    monkeypatch.setattr(output, "__file__", str(tmp_path / "output.py"))
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert output.environment({}, 0)["commit"] is None


@pytest.mark.parametrize("name", ["solvers", "speed"])
def test_default_configurations_ship(name):
    assert output.default_config(name).is_file()


def test_figures_are_saved_only_when_asked_for(tmp_path, monkeypatch):
    from moc_opt import figures
    from moc_opt.report import export
    from moc_opt.report.page import Page

    asked = []
    monkeypatch.setattr(export, "save_figures", lambda drawn, folder: asked.append((list(drawn), folder)))
    page = Page("a page")
    page.figure(figures.latency_ecdf({"a": [1.0, 2.0]}), "times", name="times")
    output.save_page(page, tmp_path / "report.html")
    assert (tmp_path / "report.html").exists()
    assert not asked
    output.save_page(page, tmp_path / "report.html", figures=True)
    assert asked == [(["times"], tmp_path / "figures")]
