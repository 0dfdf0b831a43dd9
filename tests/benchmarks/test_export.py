"""The test sets for qpbenchmark: what is written is what the published tool reads, and runs unchanged."""

import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import polars as pl
import pytest

from benchmarks import export
from benchmarks.export import problems
from moc_opt.solvers import create


@pytest.mark.skipif(find_spec("qpbenchmark") is None, reason="pip install '.[qpbenchmark]'")
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
    results = tmp_path / "results.csv"
    command = [sys.executable, "-m", "qpbenchmark.benchmark", str(module), "--results-path", str(results)]
    subprocess.run([*command, "run", "--author", "me", "--solver", "daqp"], check=True, capture_output=True)
    rows = pl.read_csv(results)
    assert len(rows) == 4 * len(written)  # each under four settings
    assert rows.filter(pl.col("settings") == "high_accuracy")["found"].all()


def test_only_feasible_problems_are_handed_over():
    chosen = problems(["infeasible"], 1)
    session = create("exact").start(next(iter(chosen.values())))
    assert 0 < len(chosen) < 128
    assert all(session.solve(qp).status.label == "solved" for qp in chosen.values())
    assert all(name.isidentifier() for name in chosen)
