"""The test sets for qpbenchmark: what is written is what the published tool reads, and runs unchanged."""

import sys
from importlib.util import find_spec

import numpy as np
import polars as pl
import pytest

from benchmarks import export
from benchmarks.export import ExportError, figures, problems, run_qpbenchmark
from moc_opt.errors import UnknownNameError
from moc_opt.solvers import create


@pytest.mark.skipif(find_spec("qpbenchmark") is None, reason="pip install 'moc-opt[qpbenchmark]'")
def test_the_published_tool_reads_and_runs_it_unchanged(tmp_path):
    """By its own command line, in a process of its own."""
    from qpbenchmark.benchmark import load_test_set

    assert export.main(["qpbenchmark", "--out", str(tmp_path), "--sets", "circle", "random", "--every", "64"]) == 0
    module, written = tmp_path / "null_space.py", problems(["circle", "random"], 64)
    sys.modules.pop("null_space", None)
    read = {problem.name: problem for problem in load_test_set(str(module))}
    for name, qp in written.items():
        np.testing.assert_array_equal(read[name].P, qp.P)
        np.testing.assert_array_equal(read[name].A, qp.reduced().A)
        np.testing.assert_array_equal(read[name].lb, qp.lower)
        assert read[name].G is None
    rows = run_qpbenchmark(module, "daqp")
    assert len(rows) == 4 * len(written)  # each under four settings
    found = figures(rows)
    assert set(found) == {"daqp@default", "daqp@high_accuracy"}
    best = found["daqp@high_accuracy"]
    assert (best["problems"], best["success_percent"], best["rank"]) == (len(written), 100.0, 1)
    assert 1.0 < found["daqp@default"]["runtime_p50_us"] < 1e5


def row(solver, runtime, found=True, primal=1e-12):
    return {
        "solver": solver, "settings": "high_accuracy", "runtime": runtime, "found": found,
        "primal_residual": primal, "dual_residual": 0.0, "duality_gap": None if primal is None else 0.0,
    }  # fmt: skip


def test_figures_are_qpbenchmark_s():
    found = figures(pl.DataFrame([
        row("a", 1e-5), row("a", 3e-5), row("b", 1e-6), row("b", 1e-6, found=False, primal=None),
        row("c", 5e-5, primal=1e-6), row("c", 5e-5),
    ]))  # fmt: skip
    assert found["a@high_accuracy"]["success_percent"] == 100.0
    assert found["b@high_accuracy"]["success_percent"] == found["c@high_accuracy"]["success_percent"] == 50.0
    # at microseconds and a shift of 10 s, the geometric mean is the arithmetic one
    assert found["a@high_accuracy"]["shgeom_us"] == pytest.approx(20.0, rel=1e-4)
    assert [found[f"{n}@high_accuracy"]["rank"] for n in "abc"] == [1, 3, 2]
    if find_spec("qpbenchmark") is not None:
        from qpbenchmark.shgeom import shgeom

        assert found["a@high_accuracy"]["shgeom_us"] == pytest.approx(
            1e6 * shgeom(np.array([1e-5, 3e-5]), 10.0)
        )


def test_only_feasible_problems_are_handed_over():
    chosen = problems(["infeasible"], 1)
    session = create("exact").start(next(iter(chosen.values())))
    assert 0 < len(chosen) < 128
    assert all(session.solve(qp).status.label == "solved" for qp in chosen.values())
    assert all(name.isidentifier() for name in chosen)


def test_wrong_input_is_refused(tmp_path, capsys, monkeypatch):
    assert export.main(["qpbenchmark", "--out", str(tmp_path), "--sets", "circel"]) == 2
    assert "'circle'" in capsys.readouterr().err
    with pytest.raises(UnknownNameError):
        problems(["nothing"])
    monkeypatch.setattr(export, "find_spec", lambda _: None)
    with pytest.raises(ExportError, match="pip install"):
        run_qpbenchmark(tmp_path / "null_space.py", "daqp")
    assert "pip install" in export.ranking(tmp_path, every=64)["none"]["reason"]
